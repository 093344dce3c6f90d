"""The first sight of the page: its regions before the program says a word, and no notices over its tools."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.browser.screens import REMEMBERED
from tests.browser.sessions import fake_session as fake
from tests.browser.steps import eventually, go_to, title_is
from tests.gui.shell.test_tour_guide import of_tour
from wafer_viewer.gui.app import start

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]

TOUR = '{"step": "surface", "tour": {"since_s": 1.0, "ended_s": null, "skipped": 0}}'
COVERED = """() => {
  const note = document.querySelector('.wv-tour').getBoundingClientRect(), over = [];
  for (const glass of document.querySelectorAll('.wv-glass')) {
    const box = glass.getBoundingClientRect();
    if (box.width && note.left < box.right && box.left < note.right && note.top < box.bottom && box.top < note.bottom)
      over.push(glass.className);
  }
  return over;
}"""
"""Glass over the scene that the note covers."""
COUNT_CONTEXTS = """
window.contexts = [];
const make = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
  if (kind.startsWith('webgl') && !window.contexts.includes(this)) window.contexts.push(this);
  return make.call(this, kind, ...rest);
};
"""
"""Notes each canvas that gets a context of the graphics card."""
NOTE_WIDTHS = """
window.widths = [];
const width = Object.getOwnPropertyDescriptor(HTMLCanvasElement.prototype, 'width');
Object.defineProperty(HTMLCanvasElement.prototype, 'width', {get: width.get, set(value) {
  width.set.call(this, value);
  if (this.dataset.engine && value !== 300 && window.widths.at(-1) !== value) window.widths.push(value);
}});
"""
"""Notes each new width of the scene; a canvas begins with 300."""
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


def test_the_card_of_the_first_start_is_the_first_that_tab_comes_to(serve_anew: Callable[[fake.FakeSession], Page]):
    page = serve_anew(fake.FakeSession(fake.empty()))
    plan = page.get_by_role("button", name="Plan a scan")
    expect(plan).to_be_visible()
    page.keyboard.press("Tab")
    expect(plan).to_be_focused()
    for _ in range(3):
        page.keyboard.press("Tab")
    expect(page.locator("[data-pick=tour]")).to_be_focused()


@pytest.mark.campaign
def test_slow_graphics_are_told_at_the_foot_and_not_over_the_tools(serve_anew: Callable[[fake.FakeSession], Page]):
    page = serve_anew(fake.FakeSession(fake.planned()))
    expect(page.locator(".wv-strip")).to_contain_text("Slow graphics")
    expect(page.get_by_text("Software WebGL rendering detected")).to_be_hidden()
    page.add_init_script(COUNT_CONTEXTS)
    page.reload()
    expect(page.locator(".wv-strip")).to_contain_text("Slow graphics")
    assert page.evaluate("window.contexts.length") == 2, "that of the scene, and the one by which viser tells"


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("width", [1366, 1600])
def test_the_scene_has_its_size_from_the_beginning(serve_anew: Callable[[fake.FakeSession], Page], width: int):
    """Each change takes a browser without a graphics card up to a second."""
    page = serve_anew(fake.FakeSession(fake.planned()))
    page.set_viewport_size({"width": width, "height": 768})
    page.add_init_script(NOTE_WIDTHS)
    page.reload()
    expect(page.locator("#wv-shell")).to_have_count(0)
    expect(page.locator(".wv-strip")).to_contain_text("Slow graphics")
    scene = page.locator("canvas").first.evaluate("canvas => canvas.clientWidth")
    widths = page.evaluate("window.widths")
    assert (widths[0], max(widths)) == (scene, scene), "narrower ones are of fewer pixels for slow graphics"


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("size", [(1366, 768), (1920, 1080)])
def test_the_note_of_the_tour_lies_over_no_tools(serve_anew: Callable[[fake.FakeSession], Page], size: tuple[int, int]):
    session = fake.FakeSession(of_tour(fake.measured(), findings=()))
    page = serve_anew(session)
    page.set_viewport_size({"width": size[0], "height": size[1]})
    page.evaluate(f"localStorage.setItem({REMEMBERED!r}, '{TOUR}')")
    page.reload()
    note = page.locator(".wv-tour")
    for step in ("Surface", "Measure", "Plan"):
        go_to(page, step)
        expect(note).to_be_visible()
        eventually(lambda: page.evaluate(COVERED) == [], f"the note covers nothing in {step}")


@pytest.mark.campaign
def test_the_focus_goes_to_what_the_tour_points_at_and_to_what_follows_a_button_that_goes(
    serve_anew: Callable[[fake.FakeSession], Page],
):
    page = serve_anew(fake.FakeSession(of_tour(fake.measured(), findings=())))
    page.evaluate(f"localStorage.setItem({REMEMBERED!r}, '{TOUR}')")
    page.reload()
    expect(page.locator(".wv-tour")).to_have_attribute("data-button", "Measure this surface")
    page.keyboard.press("Tab")
    aim = page.get_by_role("button", name="Measure this surface")
    aim.focus()
    page.keyboard.press("Enter")
    expect(page.locator("[data-pick=tool][data-k=step]").first).to_be_focused()
    page.keyboard.press("Enter")
    title_is(page, "Step height")
    page.keyboard.press("Escape")
    expect(page.locator(".wv-tour")).to_have_count(0)
    page.get_by_text("All tools").focus()
    page.keyboard.press("Enter")
    expect(page.locator(".wv-cards").first).to_be_visible()
    eventually(lambda: page.evaluate("document.activeElement !== document.body"), "the focus is not lost", 20.0)
