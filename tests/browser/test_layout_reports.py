"""The layout that the browser reports arrives, whatever else is reported at the same time."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from playwright.sync_api import Page, expect

from tests.browser.sessions.fake_session import FakeSession
from tests.browser.sessions.live_session import live_session

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
PANEL_AS_WIDE_AS_SCENE = """() => {
  const widths = selector => [...document.querySelectorAll(selector)].map(e => e.getBoundingClientRect().width);
  const [scene] = widths('[data-dock-root] > div:first-child');
  const [panel] = widths('[data-floating-window]:has(.wv-bottom)').filter(width => width);
  return Math.abs(panel - scene) <= 2;
}"""
CLICK_AT_EVERY_REPORT = """() => {
  const click = () => window.wvReport('live-watch', '0', true);
  const report = document.querySelector('div:has(>.wv-tells)+div input');
  report.addEventListener('input', () => { click(); setTimeout(click, 5); }, true);
}"""


def test_the_panel_below_follows_a_window_that_is_resized_while_clicks_come_in(serve: Callable[[FakeSession], Page]):
    page = serve(live_session())
    page.keyboard.press("c")
    expect(page.locator(".wv-live-focus")).to_be_visible()
    page.wait_for_function(PANEL_AS_WIDE_AS_SCENE)
    page.evaluate(CLICK_AT_EVERY_REPORT)
    page.set_viewport_size({"width": 1600, "height": 900})
    page.wait_for_timeout(2000)
    page.wait_for_function(PANEL_AS_WIDE_AS_SCENE, timeout=15_000)
