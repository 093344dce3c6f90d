"""Every screen looked over at sizes of the window, light and dark: see audit.py, audit.js, audit_states.py."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page

from tests.browser.audit import Group, State, Themes, both_themes, look_over, opened, page_to_audit
from tests.browser.audit_states import GROUPS
from tests.browser.kept_page import KeptPage
from tests.browser.sessions import fake_session as fake
from tests.browser.sessions import operator_session as operator
from tests.support.campaigns import drawn_cases

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
REPORT = Group(lambda: fake.FakeSession(fake.measured()), "report", (State("report"),))
FAULTS = {
    'hit: the middle of button[button] "Report" is b "Stop"': """
        const [stop, report] = ['Stop', 'Report'].map(name =>
          [...document.querySelectorAll('button')].find(b => b.textContent.trim() === name));
        const { left, top } = stop.getBoundingClientRect();
        report.style.cssText =
          `position: fixed !important; z-index: 9; left: ${left}px; top: ${top}px; width: 96px`;""",
    'cut: "Report"': """
        const title = document.querySelector('.wv-title');
        title.style.cssText = 'display: block; width: 20px; overflow: hidden; white-space: nowrap';""",
    'pale: "mm"': "document.querySelector('.wv-where').style.color = '#8FA0AF';",
    'name: input[text] "': """
        const inputs = [...document.querySelectorAll("[data-dock-region=right] .mantine-Input-input")];
        const inRows = inputs.filter(e => e.getBoundingClientRect().width).map(e => e.closest('.mantine-Flex-root'));
        const row = inRows.find(row => row);  // viser's own, folded away, are in none
        row.insertAdjacentHTML('afterend', '<input type="text" style="width: 90px; height: 20px">');""",
    "overlap: input[checkbox]": """
        const boxes = [...document.querySelectorAll("input[type=checkbox]")];
        const folded = '[style*="; height: 0px; overflow: hidden"]';  // viser's own
        const [a, b] = boxes.filter(e => e.checkVisibility() && !e.disabled && !e.closest(folded));
        const [p, q] = [a, b].map(e => e.getBoundingClientRect());
        b.style.transform = `translate(${p.left - q.left + 10}px, ${p.top - q.top}px)`;""",
    'markup shown as text: "<b>12</b> ': """
        document.querySelector('.wv-title span').append('<b>12</b> fields');""",
    "layout: the panel below the scene": """
        document.body.insertAdjacentHTML('beforeend',
          '<div data-floating-window style="position: fixed; width: 90px; height: 9px; bottom: 0">' +
          '<i class="wv-bottom"></i></div>');""",
}
"""What a look has to say, of each fault that is put into the page."""


@pytest.fixture(scope="module")
def kept(browser: Browser) -> Iterator[KeptPage]:
    with page_to_audit(browser) as kept:
        yield kept


@pytest.fixture(scope="module")
def report(browser: Browser) -> Iterator[tuple[Page, Themes]]:
    """A page that is not used again: faults are put into it."""
    with page_to_audit(browser) as kept, opened(kept, REPORT) as visit:
        themes, _ = both_themes(visit.page)
        yield visit.page, themes


def test_a_contrast_that_is_too_low_in_the_dark_alone_is_found(report: tuple[Page, Themes]):
    page, themes = report
    page.add_style_tag(content="[data-mantine-color-scheme=dark] .wv-title { color: #44505C !important; }")
    light, dark = page.evaluate("dark => wvAudit.look(dark)", themes[1])
    page.evaluate("light => wvAudit.turn(light)", themes[0])
    assert light == []
    assert any(what.startswith('pale: "Report"') for what in dark), dark


@pytest.mark.campaign
def test_a_look_finds_nothing_then_each_fault_that_is_put_into_the_page(report: tuple[Page, Themes]):
    page, _ = report
    assert page.evaluate("wvAudit.look()") == [[], []]
    for fault in FAULTS.values():
        page.evaluate(f"() => {{ {fault} }}")
    found = page.evaluate("wvAudit.look()")[0]
    assert [told for told in FAULTS if not any(what.startswith(told) for what in found)] == [], found


@pytest.mark.campaign(within=True)
@pytest.mark.parametrize("name", drawn_cases(GROUPS))
def test_nothing_is_covered_cut_nameless_or_pale(kept: KeptPage, name: str):
    found = look_over(kept, GROUPS[name])
    assert not found, "\n".join(
        f"{what}   [{', '.join(dict.fromkeys(where))}]" for what, where in sorted(found.items())
    )


def test_a_row_that_is_scrolled_half_out_of_its_panel_covers_nothing(kept: KeptPage):
    with opened(kept, Group(lambda: fake.FakeSession(operator.tried()), "plan", ())) as visit:
        cut = visit.page.get_by_label("Size, mm").evaluate(
            """input => {
              const view = input.closest('.mantine-ScrollArea-viewport');
              const middle = () => { const r = input.getBoundingClientRect(); return r.top + r.height / 2; };
              const top = view.getBoundingClientRect().top;
              view.scrollTop += middle() - top - 2;
              return middle() - top;
            }"""
        )
        assert 0 < cut < 4
        assert visit.page.evaluate("wvAudit.look()") == [[], []]
