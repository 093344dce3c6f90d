"""The audit of the page: its states on few pages, each looked over at every size of the window, light and dark."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Page

from tests.browser import fake_session as fake
from tests.browser import operator_session as operator
from tests.browser.compared_session import ComparedSession
from tests.browser.fake_session import FakeSession
from tests.browser.gauge_session import GaugeSession, checked
from tests.browser.inspected_session import inspected_session
from tests.browser.measuring_session import MeasuringSession
from tests.browser.screen_list import moving, noted
from tests.browser.screens import dismiss_viser_warning, remember
from wafer_viewer.gui.app import start

SIZES = (1024, 768), (1280, 720), (1366, 768), (1600, 900), (2560, 1440)
DARK_SIZES = (1024, 768), (1366, 768)
"""Dark pages differ in colour alone: two sizes see every panel."""
LOOK = (Path(__file__).parent / "audit.js").read_text()
SETTLED = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 60))))"
STEADY = "&fixedDpr=1"
"""viser's own parameter: it would draw coarser on a busy machine, and panels follow the pixels of the scene."""
PATIENCE = 4
Act = Callable[[Page, Any], None]


def shows(make: Callable[[], Any], step: str) -> Act:
    """Another snapshot, and a step of it."""

    def act(page: Page, session: Any) -> None:
        escape(page)
        now = make()
        session.change(
            **{f.name: getattr(now, f.name) for f in dataclasses.fields(now) if f.name not in ("version", "hands")}
        )
        go_to(step)(page, session)

    return act


def go_to(step: str) -> Act:
    def act(page: Page, session: Any) -> None:
        escape(page)
        button = page.get_by_role("button", name=step, exact=True).first
        page.wait_for_function(
            "button => button.getAttribute('aria-disabled') !== 'true'", arg=button.element_handle(), timeout=30_000
        )
        button.click()

    return act


def escape(page: Page) -> None:
    """Leave a dialog, a palette or a tool."""
    page.keyboard.press("Escape")
    page.locator(".mantine-Modal-content, .mantine-Spotlight-content").first.wait_for(state="detached")


def keys(*pressed: str, until: str) -> Act:
    """Press keys; done when what `until` selects is there."""

    def act(page: Page, session: Any) -> None:
        escape(page)
        for key in pressed:
            page.keyboard.press(key)
        page.locator(until).first.wait_for()

    return act


def click(selector: str, until: str) -> Act:
    def act(page: Page, session: Any) -> None:
        page.locator(selector).first.click()
        page.locator(until).first.wait_for()

    return act


@dataclass(frozen=True)
class Group:
    """States that one page of one session goes through, in order, by name."""

    session: Callable[[], Any]
    step: str
    states: dict[str, Act | None]


DIALOG = ".mantine-Modal-content:has(.wv-away)"
TOOL = {"k": "Step height", "Shift+K": "Groove", "x": "Point", "b": "Angle", "v": "Volume", "Shift+T": "Texture"}
GROUPS = {
    "still": Group(
        lambda: FakeSession(fake.empty()),
        "plan",
        {
            "start": None,
            "open": keys("Control+o", until=DIALOG),
            "import": keys("Shift+I", until=DIALOG),
            "keys": keys("F1", until=".wv-sheet"),
            "palette": keys("Control+k", until=".mantine-Spotlight-content"),
            "plan": shows(fake.planned, "Plan"),
            "moving": shows(moving, "Plan"),
            "scanning": shows(fake.scanning, "Acquire"),
            "stopped": keys("Shift+Escape", until=DIALOG),
            "unfinished": shows(fake.unfinished, "Acquire"),
            "fault": shows(fake.at_fault, "Plan"),
            "uncalibrated": shows(lambda: fake.measured("no calibration was given"), "Surface"),
            "export": keys("Shift+E", until=DIALOG),
            "measure": shows(fake.measured, "Measure"),
            "gauge": go_to("Gauge check"),
        },
    ),
    "surface": Group(
        noted,
        "surface",
        {"surface": None, "fields": keys("o", until=".wv-title"), "review": go_to("Review"), "report": go_to("Report")},
    ),
    "tools": Group(
        MeasuringSession,
        "measure",
        {
            "profile": keys("l", until=".wv-profiles"),
            **{name: keys(key, until=f".wv-title:has-text('{name}')") for key, name in TOOL.items()},
        },
    ),
    "gauge": Group(lambda: GaugeSession(checked()), "gauge", {"checked": None}),
    "defects": Group(
        inspected_session,
        "review",
        {
            "list": keys("PageDown", until=".wv-review-picture"),
            "form": click("[data-pick=defect-form]", ".wv-title"),
        },
    ),
    "operator": Group(
        lambda: FakeSession(operator.waiting()),
        "plan",
        {
            "wafer": None,
            "aligned": shows(operator.aligned, "Plan"),
            "taking": shows(operator.taking, "Acquire"),
            "judged": shows(lambda: operator.judged(operator.on_dies()), "Review"),
            "trial": shows(operator.tried, "Plan"),
        },
    ),
    "compared": Group(ComparedSession, "surface", {"compare": click("[data-pick=compare-new]", ".wv-title")}),
}


def look(page: Page, width: int) -> list[str]:
    """Return what one look finds."""
    return page.evaluate(LOOK, {"widthPx": width})


def audit(page: Page, sizes: tuple[tuple[int, int], ...]) -> Iterator[tuple[str, str]]:
    """Look over the page as it stands at every size; gives size and finding."""
    for width, height in sizes:
        page.set_viewport_size({"width": width, "height": height})
        page.evaluate(SETTLED)
        found = look(page, width)
        for _ in range(PATIENCE):  # panels follow the scene with a moment's delay
            if not found:
                break
            page.wait_for_timeout(250)
            found = look(page, width)
        for what in found:
            yield f"{width}", what


def turn(page: Page, dark: bool) -> None:
    """Have the page light or dark, also behind a dialog."""
    page.locator("[data-pick=theme]").evaluate("switcher => switcher.click()")
    colour = "rgb(233, 238, 243)" if dark else "rgb(21, 32, 43)"
    page.wait_for_function("c => getComputedStyle(document.querySelector('.wv-mark')).color === c", arg=colour)


@contextmanager
def opened(browser: Browser, group: Group) -> Iterator[tuple[Page, Any, list[str]]]:
    """The page of a group's session, with what its console complains of."""
    session = group.session()
    running = start(session)
    context = browser.new_context(viewport={"width": 1366, "height": 768}, reduced_motion="reduce")
    page = context.new_page()
    errors: list[str] = []
    page.on("console", lambda said: errors.append(said.text) if said.type == "error" else None)
    page.on("pageerror", lambda fault: errors.append(str(fault)))
    try:
        remember(page, group.step, dark=False)
        page.goto(running.address + STEADY)
        page.locator(".wv-title").first.wait_for(timeout=60_000)
        page.locator(".wv-contact").wait_for(state="attached", timeout=60_000)
        dismiss_viser_warning(page)
        yield page, session, errors
    finally:
        page.goto("about:blank")
        context.close()
        running.stop()
        if "close" in dir(session):
            session.close()


def look_over(browser: Browser, group: Group) -> dict[str, list[str]]:
    """Return all that was found in a group, with the states and sizes where; light and dark take turns to begin."""
    found: dict[str, list[str]] = {}
    dark = False
    with opened(browser, group) as (page, session, errors):
        for name, act in group.states.items():
            if act is not None:
                act(page, session)
            for again in (False, True):
                if again:
                    dark = not dark
                    turn(page, dark)
                for size, what in audit(page, DARK_SIZES if dark else SIZES):
                    found.setdefault(what, []).append(f"{name} at {size}{' dark' if dark else ''}")
        for error in errors:
            found.setdefault(f"console: {error}", []).append("console")
    return found


def main() -> None:
    """Print what the audit finds, group by group: python -m tests.browser.audit [GROUP ...]"""
    import shutil
    import sys

    from playwright.sync_api import sync_playwright

    from tests.browser.screens import FLAGS

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        for name in sys.argv[1:] or GROUPS:
            began = time.monotonic()
            for what, where in sorted(look_over(browser, GROUPS[name]).items()):
                print(f"{what}   [{', '.join(dict.fromkeys(where))}]")
            print(f"== {name}: {time.monotonic() - began:.0f} s", flush=True)
        browser.close()


if __name__ == "__main__":
    main()
