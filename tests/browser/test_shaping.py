"""Shapes as an operator measures them: every tool for edges and bumps at its first places, kept and chosen again."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from playwright.sync_api import Page, expect

from tests.browser.sessions.shaped_session import ShapedSession
from tests.browser.steps import go_to, press, title_is
from wafer_viewer.model.measurement.tools import TOOLS

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
TOLD = {
    "die": ("Shift+W", "112.0", "Squareness"),
    "kerf": ("Shift+U", "32.0", "Narrowest"),
    "chipping": ("Shift+X", "4.9", "Share of the edge chipped"),
    "circle": ("Shift+Y", "13.", "Roundness RONt"),
    "coplanarity": ("Shift+Q", "1.4", "Bump at x, y"),
}
"""Of each tool: its key, how its answer begins, what else the panel tells."""


@pytest.fixture
def session() -> ShapedSession:
    return ShapedSession()


@pytest.fixture
def page(session: ShapedSession, serve: Callable[[ShapedSession], Page]) -> Page:
    shown = serve(session)
    go_to(shown, "Measure")
    title_is(shown, "Measure")
    expect(shown.locator("[data-floating-window]", has_text="Height").last).to_be_visible()
    return shown


def test_every_tool_for_shapes_answers_where_it_begins_and_is_found_again(page: Page, session: ShapedSession):
    panel, results = page.locator("[data-dock-region=right]"), page.locator("tr[data-pick=finding]")
    for number, (tool, (key, value, told)) in enumerate(TOLD.items(), 1):
        page.keyboard.press(key)
        expect(page.locator(".wv-title").first).to_contain_text(TOOLS[tool].title)
        expect(page.locator(".wv-answer")).to_contain_text(value)
        expect(page.locator(".wv-answer")).to_contain_text("expanded, k = 2")
        expect(panel).to_contain_text(told)
        press(page, "Keep result")
        expect(results).to_have_count(number)
    page.keyboard.press("Escape")
    results.nth(1).click()
    expect(page.locator(".wv-title").first).to_contain_text("Kerf width")
    assert [finding.main.expanded is not None for finding in session.snapshot.findings] == [True] * len(TOLD)


@pytest.mark.campaign
def test_what_is_said_of_the_kerf_is_measured_with_at_once(page: Page):
    page.keyboard.press("Shift+U")
    expect(page.locator(".wv-answer")).to_contain_text("32.0")
    page.get_by_role("combobox", name="Kerf").click()
    page.get_by_role("option", name="Dark", exact=True).click()
    expect(page.locator("[data-dock-region=right]")).not_to_contain_text("32.0")
