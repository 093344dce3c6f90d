"""The first sight of the page: its regions before the program says a word, and no notices over its tools."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.browser.sessions import fake_session as fake
from wafer_viewer.gui.app import start

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]

SILENT = "window.Worker = class { postMessage() {} terminate() {} addEventListener() {} };"
"""viser's client speaks with the program in a worker."""


@pytest.fixture
def address() -> Iterator[str]:
    running = start(fake.FakeSession(fake.planned()))  # type: ignore[arg-type]
    yield running.address
    running.stop()


def test_the_page_has_its_regions_before_the_program_answers(browser: Browser, address: str):
    with browser.new_context(viewport={"width": 1366, "height": 768}) as context:
        page = context.new_page()
        page.add_init_script(SILENT)
        page.goto(address)
        shell = page.locator("#wv-shell")
        expect(shell.locator("nav")).to_contain_text("Gauge check")
        expect(shell.locator("main")).to_be_in_viewport()
        expect(shell).to_have_css("background-color", "rgb(255, 255, 255)")
        page.emulate_media(color_scheme="dark")
        expect(shell).to_have_css("background-color", "rgb(22, 27, 33)")


def test_the_page_takes_the_place_of_its_first_sight(serve_anew: Callable[[fake.FakeSession], Page]):
    page = serve_anew(fake.FakeSession(fake.planned()))
    expect(page.locator(".wv-nav")).to_be_visible()
    expect(page.locator("#wv-shell")).to_have_count(0)


def test_slow_graphics_are_told_at_the_foot_and_not_over_the_tools(serve_anew: Callable[[fake.FakeSession], Page]):
    page = serve_anew(fake.FakeSession(fake.planned()))
    expect(page.locator(".wv-strip")).to_contain_text("Slow graphics")
    expect(page.get_by_text("Software WebGL rendering detected")).to_be_hidden()
