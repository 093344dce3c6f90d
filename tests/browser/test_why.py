"""Why this height? Asked with a click, on a surface that can be seen."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.browser.sessions.seen_session import SeenSession, a_focus_curve
from tests.browser.steps import click_the_surface, eventually, go_to, title_is
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.surface.focus_curve import FocusCurve
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.session.measurement.dataset_queries import ReadOut

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
OPEN, WITH_CURVE = 650, 500
"""A scene is higher without a curve below it than the one number, and lower with one than the other."""
FOCUS_PLOT = ".wv-plot:not(.wv-profiles)"


@pytest.fixture
def session() -> SeenSession:
    return SeenSession()


@pytest.fixture
def page(session: SeenSession, serve: Callable[[SeenSession], Page]) -> Page:
    """The page in Surface, with the surface in sight and clicked."""
    shown = serve(session)
    go_to(shown, "Surface")
    title_is(shown, "Surface")
    expect(shown.locator("[data-floating-window]", has_text="Height").last).to_be_visible()
    click_the_surface(shown)
    return shown


def explains(page: Page) -> None:
    expect(page.locator(".wv-title").first).to_contain_text("Why this height?")


def scene(page: Page) -> Locator:
    return page.locator("canvas").first


def height_px(page: Page) -> float:
    box = scene(page).bounding_box()
    return box["height"] if box else 0.0


def test_a_click_explains_a_pixel_and_another_click_the_next(page: Page, session: SeenSession):
    page.locator("[data-pick=why]").click()
    explains(page)
    panel, dock = page.locator("[data-dock-region=right]"), page.locator("[data-floating-window]:has(.wv-plot)")
    for words in (
        "+30.31",
        "Is there texture to focus on?",
        "passed",
        "gate is off",
        "over × 1.56",
        "36 % of the peak",
    ):
        expect(panel).to_contain_text(words.replace(" %", "\u202f%"))
    for words in ("SIMULATED · Tenengrad, window 13 × 13 px, 60 frames", "peak +30.31", "rival 36"):
        expect(dock).to_contain_text(words)
    eventually(lambda: height_px(page) < WITH_CURVE, "the scene has made room")
    unmeasured: Future[FocusCurve] = Future()
    session.answers.append(unmeasured)
    click_the_surface(page, 20, 10)
    expect(dock).to_contain_text("Reading the frames …")
    unmeasured.set_result(a_focus_curve(0, 0, measured=False))
    expect(panel).to_contain_text("Ambiguous peak")
    expect(panel).to_contain_text("not passed")
    expect(dock).to_contain_text("not believed")


def test_of_a_pixel_without_a_height_the_read_out_says_only_why(page: Page, session: SeenSession):
    unmeasured = ReadOut(z_um=None, confidence=0.1, origin=Origin.STEP_EDGE)
    session.read_out = lambda x_um, y_um, show=0: unmeasured
    expect(page.locator(".wv-read")).to_contain_text("z +21.86")
    click_the_surface(page, 30, 10)
    expect(page.locator(".wv-read")).to_contain_text("at the edge of a step")
    expect(page.locator(".wv-read")).not_to_contain_text("z ")


@pytest.mark.campaign
def test_the_line_through_the_curve_leads_through_the_frames(page: Page):
    page.keyboard.press("c")
    line, caption = page.locator(".wv-scrub"), page.locator(".wv-patch figcaption")
    expect(caption).to_have_text("z +30.00\u202fµmframe 37 of 60")
    sharp = page.locator(".wv-patch img").get_attribute("src")
    line.press("ArrowRight")
    expect(caption).to_contain_text("frame 38 of 60")
    line.press("End")
    expect(caption).to_have_text("z +53.00\u202fµmframe 60 of 60")
    assert page.locator(".wv-patch img").get_attribute("src") != sharp
    box = line.bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + 9, box["y"] + box["height"] / 2)
    expect(caption).to_contain_text("frame 1 of 60")


def test_escape_gives_the_scene_its_room_back(page: Page):
    eventually(lambda: height_px(page) > OPEN, "the scene is whole")
    page.keyboard.press("c")
    expect(page.locator(FOCUS_PLOT)).to_be_visible()
    eventually(lambda: height_px(page) < WITH_CURVE, "the scene has made room")
    page.keyboard.press("Escape")
    title_is(page, "Surface")
    expect(page.locator(FOCUS_PLOT)).to_have_count(0)
    eventually(lambda: height_px(page) > OPEN, "the scene is whole again")
    page.keyboard.press("c")
    page.locator("[data-pick=why-close]").last.click()
    expect(page.locator(FOCUS_PLOT)).to_have_count(0)


@pytest.mark.campaign
def test_what_cannot_be_read_stands_where_the_curve_would(page: Page, session: SeenSession):
    waits: Future[FocusCurve] = Future()
    session.answers.append(waits)
    page.keyboard.press("c")
    expect(page.locator(".wv-empty", has_text="Reading the frames …")).to_be_visible()
    waits.set_exception(DatasetError("r0000c0000.tif is missing: restore it from a copy, or scan its field again."))
    expect(page.locator(".wv-note", has_text="is missing: restore it from a copy")).to_be_visible()


@pytest.mark.campaign
def test_another_step_or_tool_ends_the_explanation(page: Page):
    page.keyboard.press("c")
    expect(page.locator(FOCUS_PLOT)).to_be_visible()
    page.keyboard.press("l")
    title_is(page, "Profile")
    expect(page.locator(FOCUS_PLOT)).to_have_count(0)
    page.keyboard.press("c")
    explains(page)
    go_to(page, "Surface")
    title_is(page, "Surface")


def test_before_a_click_the_key_says_what_to_do(serve: Callable[[SeenSession], Page], session: SeenSession):
    page = serve(session)
    go_to(page, "Surface")
    title_is(page, "Surface")
    page.keyboard.press("c")
    expect(page.get_by_text("Click a place on the surface first.")).to_be_visible()
