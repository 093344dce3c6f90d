"""Saved views, the picture at print size, review by keyboard, the report: on a surface that is really drawn."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image
from playwright.sync_api import Locator, Page, expect

from tests.browser.kept_page import DRAW
from tests.browser.sessions import fake_session as fake
from tests.browser.sessions.reviewed_session import reviewed_session
from tests.browser.sessions.stitched_session import StitchedSession
from tests.browser.steps import eventually, go_to, notes, numbers, press, text_field, title_is
from wafer_viewer.gui.overlays.toolbar import PRINT_WIDTH_PX
from wafer_viewer.model.acquisition.plan import FieldGrid
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]


@pytest.fixture
def session(tmp_path: Path) -> StitchedSession:
    """A stitched surface with two results."""
    made = StitchedSession(3, 3)
    step = fake.a_step(Region.rectangle(-80, 0, -20, 40), Region.rectangle(20, 0, 80, 40))
    line, _ = fake.a_profile(Region.line(-200, -100, 150, -60, 3.0))
    results = (replace(step, name="Die to trench", number=1), replace(line, name="Across the drop", number=2))
    made.change(findings=results)
    made.papers.folder = tmp_path
    return made


@pytest.fixture
def page(session: StitchedSession, serve: Callable[[StitchedSession], Page]) -> Page:
    shown = serve(session)
    go_to(shown, "Surface")
    expect(shown.locator("[data-floating-window]", has_text="not measured").last).to_be_visible()
    return shown


@pytest.mark.campaign
def test_a_view_is_saved_and_come_back_to(page: Page, session: StitchedSession, look_at):
    frame = page.locator(".wv-over-map polygon, .wv-over-map path")
    page.keyboard.press("t")
    page.keyboard.press("h")
    page.keyboard.press("Shift+Digit0")
    text_field(page, "Name").fill("From above")
    text_field(page, "Name").press("Enter")
    expect(page.locator("[data-pick=view]")).to_have_text("From above")
    kept = session.snapshot.notebook.book.views[0]
    assert kept.hillshade == 0.0
    assert kept.position_mm[2] > kept.look_at_mm[2] + 0.1
    page.keyboard.press("i")
    page.keyboard.press("h")
    expect(hillshade(page)).to_have_value("80")
    page.keyboard.press("Shift+Digit1")
    expect(hillshade(page)).to_have_value("0")
    expect(frame.first).to_be_attached()
    another = look_at(page.url)
    go_to(another, "Surface")
    expect(another.locator("[data-pick=view]")).to_have_text("From above")
    page.get_by_role("button", name="Link to From above").click()
    expect(page.get_by_text("The address of this page leads to it now")).to_be_visible()
    linked = look_at(page.url)
    expect(linked.locator("[data-pick=view]")).to_have_text("From above")
    expect(hillshade(linked)).to_have_value("0")
    assert "#" not in linked.url, "a reload stays where one is"
    linked.goto(page.url.replace("&of=", "&of=another-"))
    expect(linked.get_by_text("This link leads to another-")).to_be_visible()
    page.locator("[data-pick=view-delete]").click()
    expect(another.locator("[data-pick=view]")).to_have_count(0)
    page.locator("[data-pick=view-undo]").click()
    expect(another.locator("[data-pick=view]")).to_have_text("From above")


def hillshade(page: Page) -> Locator:
    return numbers(page, "Hillshade, %").last


@pytest.mark.campaign
def test_a_picture_at_print_size_has_that_size_and_says_simulated(page: Page, session: StitchedSession, tmp_path: Path):
    page.evaluate(DRAW)
    page.locator("[data-pick=picture]").click()
    eventually(lambda: list(tmp_path.glob("*.png")) != [], "the picture is kept", 120)
    expect(page.locator(".mantine-Notification-root", has_text="Picture saved")).to_be_visible()
    picture = Image.open(next(tmp_path.glob("*.png")))
    assert picture.width == PRINT_WIDTH_PX
    assert picture.height > 900
    colours = {rgb for _, rgb in picture.resize((300, picture.height // 10)).getcolors(100_000)}
    assert len(colours) > 200  # a surface, no blank sheet


@pytest.mark.campaign
def test_results_are_reviewed_by_keyboard_alone(page: Page, session: StitchedSession):
    page.keyboard.press("Shift+R")
    title_is(page, re.compile("S1 · Die to trench"))
    page.keyboard.press("PageDown")
    title_is(page, re.compile("P2 · Across the drop"))
    page.keyboard.press("n")
    expect(page.locator("tr[data-pick=review]").nth(1)).to_contain_text("rejected")
    title_is(page, re.compile("S1 · Die to trench"))
    page.keyboard.press("y")
    expect(page.locator("tr[data-pick=review]").nth(0)).to_contain_text("accepted")
    page.keyboard.press("PageUp")
    title_is(page, re.compile("S1 · Die to trench"))
    expect(page.locator("[data-dock-region=left]")).to_contain_text("2 of 2 judged")
    text_field(page, "Note").fill("a burr at the left")
    eventually(lambda: note(session) == "a burr at the left", "the note is noted down")
    page.keyboard.press("Escape")
    page.locator("[data-pick=review-filter][data-k=rejected]").click()
    expect(page.locator("tr[data-pick=review]")).to_have_count(1)
    press(page, "Undo")
    eventually(lambda: note(session) == "", "the note is taken back")


@pytest.mark.campaign
def test_features_of_a_verdict_are_reviewed_the_gravest_first(serve: Callable[[StitchedSession], Page]):
    page = serve(reviewed_session())
    go_to(page, "Review")
    title_is(page, re.compile("F2 · Die 2 over street"))
    expect(page.locator("tr[data-pick=review]").nth(1)).to_contain_text("INCONCLUSIVE")
    expect(page.locator(".wv-review-picture img")).to_have_attribute("src", re.compile("^data:image/jpeg"))
    page.keyboard.press("n")
    expect(page.locator("tr[data-pick=review]").nth(0)).to_contain_text("rejected")
    title_is(page, re.compile("F3 · Die 3 over street"))
    press(page, "Undo")
    title_is(page, re.compile("F2 · Die 2 over street"))
    expect(page.locator("[data-dock-region=left]")).to_contain_text("0 of 3 judged")
    expect(page.get_by_role("button", name="Undo", exact=True)).to_be_disabled()
    page.reload()
    title_is(page, re.compile("F2 · Die 2 over street"))


def note(session: StitchedSession) -> str:
    return session.snapshot.notebook.book.judgement("result 1").note


def test_a_report_is_ordered_written_and_opened(page: Page, session: StitchedSession, tmp_path: Path):
    go_to(page, "Report")
    title_is(page, "Report")
    expect(page.locator(".wv-part", has_text="2 results, 0 judged")).to_have_count(1)
    expect(page.get_by_label("Pictures")).to_be_disabled()
    expect(page.get_by_label("Pictures")).not_to_be_checked()
    text_field(page, "Title").fill("Lot <7>")
    page.get_by_label("Recipe").click()
    expect(page.locator(".wv-part.off")).to_have_count(1)
    session.papers.fails_with = DatasetError("/data/r.html cannot be written: the disk is full: free some space.")
    press(page, "Write report")
    expect(notes(page)).to_contain_text("the disk is full")
    session.papers.fails_with = None
    press(page, "Write report")
    expect(page.locator(".mantine-Notification-root", has_text="memory-report-1.html")).to_be_visible()
    order = session.asked[-1][1][0]
    assert order.title == "Lot <7>"
    assert "recipe" not in order.parts
    assert "results" in order.parts
    page.reload()
    title_is(page, "Report")


def test_the_map_says_what_is_in_view_and_flies_to_a_place(page: Page, session: StitchedSession):
    go_to(page, "Review")
    page.keyboard.press("PageDown")
    page.keyboard.press("PageDown")
    seen = page.locator(".wv-over-map polygon")
    expect(seen).to_be_attached()
    before = seen.get_attribute("points")
    page.locator("svg.wv-map").click(position={"x": 30, "y": 3})
    expect(seen).not_to_have_attribute("points", before or "")


def test_in_plan_a_place_on_the_map_is_asked_about_before_the_stage_moves(serve):
    session = fake.FakeSession(fake.planned())
    page = serve(session)
    page.locator("svg.wv-map").click(position={"x": 20, "y": 20})
    expect(page.get_by_role("dialog")).to_contain_text("Move the stage?")
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_have_count(0)
    assert session.asked == []
    page.locator("svg.wv-map").click(position={"x": 20, "y": 20})
    press(page, "Move there")
    eventually(lambda: [name for name, _, _ in session.asked] == ["move_to"], "the stage was moved")


def test_a_click_on_the_map_counts_though_the_map_is_drawn_anew_while_the_button_is_down(serve):
    width_um, height_um = fake.LIMITS.field_width_um, fake.LIMITS.field_height_um
    narrower = FieldGrid(rows=3, cols=2, field_width_um=width_um, field_height_um=height_um)
    job = replace(fake.a_job(), grid=narrower.centred_on(200, -100))
    session = fake.FakeSession(fake.planned())
    page = serve(session)
    shown = page.locator("svg.wv-map")
    expect(shown.locator("[data-k]")).to_have_count(9)
    box = shown.bounding_box()
    page.mouse.move(box["x"] + 20, box["y"] + 20)
    page.mouse.down()
    session.change(draft=fake.draft_of(job))
    expect(shown.locator("[data-k]")).to_have_count(6)
    page.mouse.up()
    expect(page.get_by_role("dialog")).to_contain_text("Move the stage?")
