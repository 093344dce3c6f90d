"""Names that hold a script, everywhere in the session: every step shows them as text, and none runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import markupsafe
import msgspec
import pytest
from playwright.sync_api import Page, expect

from tests.browser.sessions import fake_session as fake
from tests.browser.sessions.fake_session import FakeSession
from tests.browser.steps import go_to

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
HOSTILE = "<img src=x onerror=wvRan=1><svg onload=wvRan=1>\"'><script>wvRan=1<\u2215script>{wvRan=1}"
NAMES = {
    *("name", "lot", "wafer_id", "product", "operator", "title", "text", "note", "label", "source", "revision"),
    *("judged_by", "problem", "serial", "why", "detail", "notes", "reasons", "software_version", "recipe_name"),
}
STEPS = ("Plan", "Acquire", "Surface", "Measure", "Review", "Report")


def hostile(value: Any, called: str = "") -> Any:
    """Return a value of the session with a script in every name."""
    if isinstance(value, str):
        return HOSTILE if called in NAMES else value
    if isinstance(value, Path):
        return value.with_name(HOSTILE + value.suffix)
    if isinstance(value, tuple) and not hasattr(value, "_fields"):
        return tuple(hostile(part, called) for part in value)
    if isinstance(value, msgspec.Struct):
        return msgspec.structs.replace(value, **changed(value, value.__struct_fields__))
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return dataclasses.replace(value, **changed(value, [f.name for f in dataclasses.fields(value) if f.init]))
    return value


def changed(value: Any, fields: Any) -> dict[str, Any]:
    parts = {name: (getattr(value, name), hostile(getattr(value, name), name)) for name in fields}
    return {name: after for name, (before, after) in parts.items() if after is not before}


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("state", [fake.planned, fake.scanning, fake.at_fault, fake.measured])
def test_a_script_in_a_name_is_shown_and_does_not_run(serve: Callable[[FakeSession], Page], state) -> None:
    page = serve(FakeSession(hostile(state())))
    shown = 0
    for _ in steps_of(page):
        shown += page.evaluate("() => document.body.innerText.split('<img src=x onerror=wvRan').length - 1")
        assert page.locator("img[src=x], svg[onload]").count() == 0
    assert shown > 0
    page.keyboard.press("Control+o")
    expect(page.locator(".mantine-Modal-content").first).to_be_visible()
    page.wait_for_timeout(500)
    assert page.evaluate("() => window.wvRan") is None


def steps_of(page: Page) -> Iterator[str]:
    """Go to every step that is possible."""
    for step in STEPS:
        button = page.get_by_role("button", name=step, exact=True).first
        if button.is_enabled():
            go_to(page, step)
            page.wait_for_timeout(200)
            yield step


VIOLATIONS = """
  window.wvRefused = [];
  document.addEventListener('securitypolicyviolation', event => window.wvRefused.push(event.effectiveDirective));
"""


@pytest.mark.campaign
def test_the_same_names_without_escaping_are_elements_whose_scripts_the_policy_refuses(
    serve_anew: Callable[[FakeSession], Page], monkeypatch
) -> None:
    """The test above would see them."""
    monkeypatch.setattr(markupsafe, "_escape_inner", str)
    page = serve_anew(FakeSession(hostile(fake.measured())))
    page.evaluate(VIOLATIONS)
    go_to(page, "Measure")
    page.locator("img[src=x]").first.wait_for(state="attached")
    page.wait_for_function("() => window.wvRefused.includes('script-src-attr')")
    assert page.evaluate("() => window.wvRan") is None


@pytest.mark.campaign
def test_the_policy_refuses_nothing_of_the_page_itself(serve_anew: Callable[[FakeSession], Page]) -> None:
    told = list[str]()
    session = FakeSession(fake.planned())
    page = serve_anew(session)
    page.on("console", lambda message: told.append(message.text))
    page.reload()
    for state in (fake.planned, fake.scanning, fake.measured):
        now = state()
        session.change(**{name: getattr(now, name) for name in ("rig", "dataset", "scan", "surface", "findings")})
        for _ in steps_of(page):
            assert page.locator("[onclick], [onerror], [oninput], [onchange], [onkeydown]").count() == 0
    assert [text for text in told if "Content Security Policy" in text] == []


def test_no_html_on_the_page_brings_a_script_in(serve_anew: Callable[[FakeSession], Page]) -> None:
    page = serve_anew(FakeSession(fake.planned()))
    for html in ("<img src=x onerror=wvRan=1>", "<script>wvRan=1</script>", "<a href='javascript:wvRan=1'>x</a>"):
        page.evaluate(VIOLATIONS)
        page.evaluate(
            """html => {
              document.body.append(document.createRange().createContextualFragment(html));
              document.body.lastElementChild.click();
            }""",
            html,
        )
        page.wait_for_function("() => window.wvRefused.length > 0")
        assert page.evaluate("() => window.wvRan") is None
