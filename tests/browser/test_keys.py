"""Keys: whatever has the focus, in dialogs, in the palette, and the sheet that lists them."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from playwright.sync_api import Page, expect

from tests.browser.sessions import fake_session as fake
from tests.browser.steps import camera_at_rest, eventually, go_to, press, stored, text_field, title_is, type_into
from wafer_viewer.model.job import SavedView

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
Serve = Callable[[fake.FakeSession], Page]


def verbs(session: fake.FakeSession) -> list[str]:
    return [name for name, _, _ in session.asked]


def test_a_key_works_while_a_ticked_checkbox_has_the_focus(serve: Serve):
    page = serve(fake.FakeSession(fake.measured()))
    go_to(page, "Surface")
    page.get_by_label("One z").click()
    expect(page.get_by_label("One z")).to_be_focused()
    page.keyboard.press("k")
    title_is(page, "Step height")


@pytest.mark.campaign
def test_an_arrow_moves_the_slider_that_has_the_focus_and_not_the_camera(serve: Serve):
    page = serve(fake.FakeSession(fake.measured()))
    go_to(page, "Surface")
    title_is(page, "Surface")  # before, the first slider is that of the step that is left
    slider = page.get_by_role("slider").first
    slider.focus()
    eventually(lambda: camera_at_rest(page), "the camera at rest")
    before, value = stored(page, "camera"), float(slider.get_attribute("aria-valuenow") or "nan")
    page.keyboard.down("ArrowRight")
    page.wait_for_timeout(1500)
    page.keyboard.up("ArrowRight")
    expect(slider).not_to_have_attribute("aria-valuenow", f"{value:g}")
    eventually(lambda: camera_at_rest(page), "the camera at rest again")
    assert stored(page, "camera") == before


def test_the_main_button_of_a_step_is_two_presses_away(serve: Serve):
    page = serve(fake.FakeSession(fake.measured()))
    go_to(page, "Plan")
    skip = page.get_by_role("button", name="Skip to the main button")
    assert skip.evaluate("at => at === document.querySelector('a[href], button, input, [tabindex]')"), "the first stop"
    skip.focus()
    expect(skip).to_have_css("clip-path", "none")
    page.keyboard.press("Enter")
    expect(page.get_by_role("button", name="Start scan", exact=True)).to_be_focused()
    expect(skip).not_to_have_css("clip-path", "none")
    go_to(page, "Surface")
    title_is(page, "Surface")
    page.get_by_label("One z").focus()
    page.keyboard.press(".")
    expect(page.get_by_role("button", name="Measure this surface")).to_be_focused()


def test_letters_go_into_a_field_until_it_is_left(serve: Serve):
    session = fake.FakeSession(fake.planned())
    page = serve(session)
    lot = text_field(page, "Lot")
    lot.fill("")
    lot.press_sequentially("Gm", delay=120)
    expect(lot).to_have_value("Gm")
    assert "start_scan" not in verbs(session)
    page.keyboard.press("Escape")
    expect(lot).not_to_be_focused()
    page.keyboard.press("g")
    eventually(lambda: "start_scan" in verbs(session), "the scan was started")


def test_enter_answers_a_dialog_escape_leaves_it_and_no_key_reaches_behind_it(serve: Serve, tmp_path):
    session = fake.FakeSession(fake.planned())
    page = serve(session)
    press(page, "Open…")
    page.get_by_role("button", name="Cancel").focus()
    page.keyboard.press("g")
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_have_count(0)
    assert verbs(session) == []
    page.keyboard.press("Control+o")
    (tmp_path / "kept.wafer").mkdir()
    type_into(page, "Path", str(tmp_path / "kept.wafer"))
    text_field(page, "Path").press("Enter")
    expect(page.get_by_role("dialog")).to_have_count(0)
    eventually(lambda: "open_dataset" in verbs(session), "the dataset was opened")


@pytest.mark.campaign
def test_the_palette_lists_the_views_there_are_and_says_why_a_verb_is_not_possible(serve: Serve):
    session = fake.FakeSession(fake.measured())
    session.notebook.save_view(SavedView(name="The edge", position_mm=(0.1, -0.9, 0.8), look_at_mm=(0, 0, 0)))
    page = serve(session)
    page.keyboard.press("Control+k")
    asked = page.get_by_placeholder("Search commands...")
    asked.fill("view:")
    expect(page.get_by_role("button", name="Go to view: The edge")).to_be_visible()
    asked.fill("hillshade")
    page.keyboard.press("Enter")
    told = page.locator(".mantine-Notification-root", has_text="Hillshade")
    expect(told).to_contain_text("Not now: the surface is not shown: go to Surface first.")
    expect(asked).to_be_hidden()
    page.keyboard.press("Control+k")
    asked.fill("the edge")
    page.keyboard.press("Enter")
    title_is(page, "Surface")


def test_the_palette_has_a_verb_without_a_key_and_the_sheet_lists_the_keys(serve: Serve):
    page = serve(fake.FakeSession(fake.measured()))
    page.keyboard.press("Shift+S")
    title_is(page, "Surface")
    page.keyboard.press("Control+k")
    page.get_by_placeholder("Search commands...").fill("colour by slope")
    page.keyboard.press("Enter")
    expect(text_field(page, "Colour by")).to_have_value("Slope")
    expect(page.get_by_role("dialog")).to_have_count(0)
    page.keyboard.press("F1")
    expect(page.get_by_role("dialog")).to_contain_text("Step height")
    expect(page.get_by_role("dialog")).to_contain_text("Ctrl + Shift + Z")
    sheet, rows = page.get_by_role("region", name="Keys"), page.locator(".wv-sheet section > div")
    for row, key in ((rows.first, "Home"), (rows.last, "End")):
        sheet.press(key)
        expect(row).to_be_in_viewport(ratio=1)
    page.set_viewport_size({"width": 1024, "height": 600})
    sheet.press("End")
    expect(rows.last).to_be_in_viewport(ratio=1)
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_have_count(0)
