"""The page as an operator uses it, on a session that stands still."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.browser.sessions import fake_session as fake
from tests.browser.steps import (
    eventually,
    go_to,
    notes,
    press,
    put,
    set_numbers,
    text_field,
    title_is,
    type_into,
)
from wafer_viewer.model.errors import DatasetError

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
Serve = Callable[[fake.FakeSession], Page]


# Texts, but for the names in viser's own tree of the scene, which the page hides, and for its folded panels: those are
# display: none once the end of their transition is heard of, and one from nothing to nothing may have none.
FACTS = """() => [
  (() => {
    const folded = [...document.querySelectorAll('[style*="; height: 0px; overflow: hidden"]')];
    const before = folded.map(e => e.style.display);
    for (const e of folded) e.style.display = 'none';
    const texts = document.body.innerText.split('\\n');
    folded.forEach((e, k) => { e.style.display = before[k]; });
    return [...new Set(texts)].filter(text => !/^\\/\\w+$/.test(text)).sort();
  })(),
  document.documentElement.dataset.mantineColorScheme, document.activeElement.tagName, innerWidth,
  [...document.querySelectorAll('[data-dock-region] input')].filter(e => !/^(ws:|\\{)/.test(e.value))
    .map(e => [e.value, e.checked, e.disabled]),
  [...document.querySelectorAll('[data-dock-region], [data-floating-window], canvas')].map(e => {
    const box = e.getBoundingClientRect();
    return [box.x, box.y, box.width, box.height].map(Math.round).join();
  }).sort(),
]"""


def verbs(session: fake.FakeSession) -> list[str]:
    return [name for name, _, _ in session.asked]


def test_a_page_that_is_kept_shows_the_next_session_as_a_new_browser_does(serve: Serve, serve_anew: Serve):
    used = serve(fake.FakeSession(fake.measured()))
    go_to(used, "Surface")
    used.locator("[data-pick=theme]").click()
    used.set_viewport_size({"width": 1600, "height": 900})
    used.locator("[data-dock-region-collapse=right]").click()
    used.keyboard.press("Control+o")
    text_field(used, "Path").fill("/somewhere")
    new = serve_anew(fake.FakeSession(fake.planned()))
    kept = serve(fake.FakeSession(fake.planned()))
    for page in (new, kept):
        expect(page.get_by_text("9 fields")).to_be_visible()
        expect(page.locator(".wv-strip")).to_contain_text("You hold the controls")
    eventually(lambda: kept.evaluate(FACTS) == new.evaluate(FACTS), "both are the same")


def test_the_first_start_offers_the_ways_in(serve: Serve):
    session = fake.FakeSession(fake.empty())
    page = serve(session)
    for words in ("Start with a sample", "Open a dataset…", "Import images…", "Take the tour on the virtual rig"):
        expect(page.get_by_text(words, exact=True)).to_be_visible()
    expect(page.get_by_text("Not yet: the sample has no size.")).to_be_visible()
    expect(page.get_by_role("button", name="Start scan")).to_be_disabled()
    expect(page.locator(".wv-pill")).to_contain_text("SIMULATED")
    press(page, "Plan a scan")
    eventually(lambda: "cover_sample" in verbs(session), "the sample was covered")


def test_without_a_picture_of_the_sample_a_plan_begins_with_its_size(serve: Serve):
    session = fake.FakeSession(dataclasses.replace(fake.empty(), overview=None))
    page = serve(session)
    press(page, "Plan a scan")
    expect(page.get_by_text("Start with a sample")).to_have_count(0)
    expect(text_field(page, "Size, mm")).to_have_attribute("placeholder", re.compile("^not given"))
    type_into(page, "Size, mm", "3.6 × 2.88")
    expect(page.get_by_role("button", name="Start scan")).to_be_enabled()
    assert session.snapshot.draft.job.grid.width_um >= 3600


def test_only_steps_with_contents_can_be_gone_to(serve: Serve):
    page = serve(fake.FakeSession(fake.planned()))
    for step, possible in (("Plan", True), ("Acquire", False), ("Surface", False), ("Measure", False)):
        expect(page.get_by_role("button", name=step, exact=True)).to_be_enabled(enabled=possible)


def test_a_plan_is_edited_priced_and_started(serve: Serve):
    session = fake.FakeSession(fake.planned())
    page = serve(session)
    expect(page.get_by_text("9 fields")).to_be_visible()
    set_numbers(page, "Columns, rows", 4, 3)
    expect(page.get_by_text("12 fields")).to_be_visible()
    type_into(page, "Lot", "L2232")
    eventually(lambda: session.snapshot.draft.job.sample.lot == "L2232", "the lot was taken over")
    page.locator("[data-pick=strategy][data-k=z_up]").click()
    expect(page.locator("tr.sel")).to_contain_text("Z passes, upward")
    assert session.snapshot.draft.job.strategy == "z_up"
    press(page, "Start scan")
    eventually(lambda: "start_scan" in verbs(session), "the scan was started")


COVERED = """
() => {
  const named = name => button => button.textContent.trim() === name;
  const buttons = [...document.querySelectorAll('[data-dock-region=right] button')].filter(at => at.offsetParent);
  const foot = buttons.find(named('Start scan'));
  return buttons.filter(at => {
    at.closest('.mantine-ScrollArea-viewport').scrollTop = 0;
    at.scrollIntoView({ block: 'nearest' });
    const { left, top, width, height } = at.getBoundingClientRect();
    const seen = share => document.elementFromPoint(left + width / 2, top + share * height);
    return at !== foot && ![0.1, 0.5, 0.9].every(share => at.contains(seen(share)));
  }).map(at => at.textContent.trim());
}
"""
"""Buttons of the right panel that lie under another element when they have been scrolled into sight."""


def test_nothing_that_is_brought_into_sight_lies_under_the_foot(serve: Serve):
    now = fake.planned()
    draft = dataclasses.replace(now.draft, problem="The grid reaches 3 mm over the range of the stage: move it.")
    for snapshot in (now, dataclasses.replace(now, draft=draft)):
        page = serve(fake.FakeSession(snapshot))
        page.get_by_text("For operators").click()
        expect(page.get_by_role("button", name="Try on wafers…")).to_be_visible()
        eventually(lambda page=page: page.evaluate(COVERED) == [], "every button can be brought into sight")


@pytest.mark.campaign
def test_typing_on_and_on_loses_nothing_of_what_was_typed_first(serve: Serve):
    session = fake.FakeSession(fake.planned())
    page = serve(session)
    set_numbers(page, "Columns, rows", 2, 1)
    lot = text_field(page, "Lot")
    lot.fill("")
    for letter in "A lot with a long name":
        lot.press_sequentially(letter)
        session.change()  # the rig tells where it stands meanwhile
        page.wait_for_timeout(120)
    eventually(lambda: session.snapshot.draft.job.sample.lot == "A lot with a long name", "the lot was taken over")
    grid = session.snapshot.draft.job.grid
    assert (grid.cols, grid.rows) == (2, 1)


@pytest.mark.campaign
def test_a_pause_between_two_words_keeps_the_space(serve: Serve):
    session = fake.FakeSession(fake.planned())
    page = serve(session)
    lot = text_field(page, "Lot")
    lot.fill("A ")
    eventually(lambda: session.snapshot.draft.job.sample.lot == "A", "the lot was taken over")
    for _ in range(20):
        session.change()  # the rig tells where it stands meanwhile
        page.wait_for_timeout(120)
    lot.press_sequentially("lot")
    eventually(lambda: session.snapshot.draft.job.sample.lot == "A lot", "the rest was taken over", within_s=20)
    expect(lot).to_have_value("A lot")
    assert session.snapshot.draft.job.sample.lot == "A lot"


def test_a_plan_that_cannot_be_says_why_and_leaves_the_last_good_one(serve: Serve):
    session = fake.FakeSession(fake.planned())
    page = serve(session)
    job = session.snapshot.draft.job
    type_into(page, "Exposures, µs", "quick")
    expect(page.get_by_text("Not yet: The exposures read 'quick'")).to_be_visible()
    expect(page.get_by_role("button", name="Start scan")).to_be_disabled()
    assert session.snapshot.draft.job == job
    type_into(page, "Exposures, µs", "100, 400")
    expect(page.get_by_role("button", name="Start scan")).to_be_enabled()
    assert session.snapshot.draft.job.exposures_us == (100.0, 400.0)


def test_pause_asks_nothing_and_stop_halts_before_it_asks(serve: Serve):
    session = fake.FakeSession(fake.scanning())
    page = serve(session)
    go_to(page, "Acquire")
    title_is(page, "Scanning field 5, 5 of 9")
    expect(page.get_by_text("it is no emergency stop")).to_be_visible()
    expect(page.locator(".wv-note.attention")).to_contain_text("Nothing to do.")
    press(page, "Pause")
    eventually(lambda: "pause" in verbs(session), "the scan was paused")
    page.get_by_role("button", name="Stop scan").click()
    eventually(lambda: "stop" in verbs(session), "the scan was stopped without a question")
    question = page.get_by_role("dialog")
    expect(question).to_contain_text("3 of 9 fields are complete; all frames are kept.")
    question.get_by_role("button", name="Continue the scan").click()
    eventually(lambda: "continue_scan" in verbs(session), "the scan was continued")
    expect(question).to_have_count(0)


def test_the_question_after_stop_closes_when_it_no_longer_applies(serve: Serve):
    session = fake.FakeSession(fake.scanning())
    page = serve(session)
    for ends in (
        lambda: session.change(rig=dataclasses.replace(session.snapshot.rig, state="scanning")),
        lambda: session.change(dataset=dataclasses.replace(session.snapshot.dataset, finished=True)),
    ):
        page.keyboard.press("Shift+Escape")
        expect(page.get_by_role("dialog")).to_contain_text("The scan is stopped")
        ends()
        expect(page.get_by_role("dialog")).to_have_count(0)
    page.keyboard.press("Shift+Escape")
    expect(page.get_by_text("Nothing moves.")).to_be_visible()
    assert notes(page).count() == 0


def test_an_unfinished_dataset_is_gone_on_with(serve: Serve):
    session = fake.FakeSession(fake.unfinished())
    page = serve(session)
    go_to(page, "Acquire")
    title_is(page, "The scan is unfinished")
    press(page, "Continue the scan")
    eventually(lambda: "continue_scan" in verbs(session), "the scan was continued")
    assert "start_scan" not in verbs(session), "the fields that are there are not taken again"


def test_an_import_without_lengths_takes_those_of_the_files(serve: Serve, tmp_path):
    session = fake.FakeSession(fake.planned())
    page = serve(session)
    press(page, "Import…")
    type_into(page, "Path", str(tmp_path))
    press(page, "Import")
    eventually(lambda: "import_images" in verbs(session), "the session is asked, which reads the files")
    _, given = next(args for name, args, _ in session.asked if name == "import_images")
    assert (given.z_step_um, given.pixel_um) == (None, None)


def test_what_went_wrong_stands_until_it_is_dealt_with(serve: Serve, tmp_path):
    session = fake.FakeSession(fake.planned())
    session.fails_with = DatasetError(
        "Import stopped at b<i>.tif: It is 4 x 3 px, the first is 4 x 4 px. Nothing was written."
    )
    page = serve(session)
    press(page, "Import…")
    type_into(page, "Path", str(tmp_path))
    set_numbers(page, "z step, µm", 4)
    set_numbers(page, "Pixel, µm", 0.5)
    press(page, "Import")
    expect(notes(page)).to_contain_text("Import stopped at b<i>.tif")
    expect(page.locator(".mantine-Notification-root", has_text="Import stopped")).to_be_visible()
    page.locator("[data-pick=dismiss]").click()
    expect(notes(page)).to_have_count(0)
    expect(page.get_by_role("button", name="Start scan")).to_be_enabled()


def test_clicks_closer_together_than_viser_sends_are_all_heard(serve: Serve):
    now = fake.at_fault()
    twins = tuple(dataclasses.replace(now.faults[0], id=f"f{k}", title=f"Fault {k}") for k in range(4))
    session = fake.FakeSession(dataclasses.replace(now, faults=twins))
    page = serve(session)
    links = page.locator("[data-pick=dismiss]")
    expect(links).to_have_count(4)
    links.evaluate_all("links => links.forEach(link => link.click())")
    eventually(lambda: verbs(session).count("dismiss") == 4, "every note was dismissed")
    assert {args[0] for name, args, _ in session.asked if name == "dismiss"} == {"f0", "f1", "f2", "f3"}


def test_an_unforeseen_error_is_told_and_the_page_goes_on(serve: Serve):
    session = fake.FakeSession(fake.planned())
    session.fails_with = ZeroDivisionError("division by zero")
    page = serve(session)
    press(page, "Cover the sample")
    expect(notes(page)).to_contain_text("Unexpected error: division by zero")
    session.fails_with = None
    set_numbers(page, "Columns, rows", 2, 2)
    expect(page.get_by_text("4 fields")).to_be_visible()


def test_the_numbers_of_a_surface_and_what_names_of_people_cannot_do(serve: Serve):
    session = fake.FakeSession(fake.measured("the calibration was due on 2026-01-01"))
    page = serve(session)
    go_to(page, "Surface")
    title_is(page, "Surface")
    for words in ("+34.04", "no texture", "uncalibrated: the calibration was due on 2026-01-01"):
        expect(page.locator("[data-dock-region=right]")).to_contain_text(words)
    go_to(page, "Measure")
    expect(page.locator("[data-dock-region=left]")).to_contain_text("Across the gel drop <b>&")
    page.locator("tr[data-pick=finding][data-k='1']").click()
    expect(page.locator(".wv-answer")).to_contain_text("11.86")
    expect(page.locator(".wv-answer")).to_contain_text("expanded, k = 2")
    expect(page.locator("tr.strong")).to_contain_text("0.155")


def test_results_are_renamed_deleted_and_exported(serve: Serve, tmp_path: Path):
    session = fake.FakeSession(fake.measured())
    session.change(data_folder=tmp_path)
    page = serve(session)
    go_to(page, "Measure")
    expect(page.get_by_role("button", name="Delete")).to_be_disabled()
    page.locator("tr[data-pick=finding][data-k='1']").click()
    press(page, "Rename")
    put(page, text_field(page, "Name"), "Die 4 to trench")
    page.get_by_role("dialog").get_by_role("button", name="Rename").click()
    eventually(lambda: ("rename", (1, "Die 4 to trench"), {}) in session.asked, "the result was renamed")
    press(page, "CSV…")
    press(page, "Save")
    eventually(lambda: "export_findings" in verbs(session), "the results were exported")
    press(page, "Delete")
    eventually(lambda: ("delete", (1,), {}) in session.asked, "the result was deleted")


def test_the_dark_page_and_the_step_come_back_after_a_reload(serve: Serve):
    page = serve(fake.FakeSession(fake.measured()))
    go_to(page, "Surface")
    title_is(page, "Surface")
    page.locator("[data-pick=theme]").click()
    expect(page.locator(".wv-title").first).to_have_css("color", "rgb(233, 238, 243)")
    page.reload()
    title_is(page, "Surface")
    expect(page.locator(".wv-title").first).to_have_css("color", "rgb(233, 238, 243)")


def test_keys_do_what_the_buttons_do(serve: Serve):
    session = fake.FakeSession(fake.measured())
    page = serve(session)
    for key, tool, title in (("k", "step", "Step height"), ("l", "profile", "Profile")):
        page.keyboard.press(key)
        title_is(page, title)
        page.keyboard.press("Escape")
        title_is(page, "Measure")
        page.locator(f".wv-tools [data-pick=tool][data-k={tool}]").click()
        title_is(page, title)
        page.keyboard.press("Escape")
        title_is(page, "Measure")
    page.keyboard.press("Control+z")
    eventually(lambda: "undo_findings" in verbs(session), "the last change to the results was taken back")
    assert "redo_findings" not in verbs(session)


def test_a_second_browser_sees_the_same_and_chooses_for_itself(serve: Serve, look_at):
    session = fake.FakeSession(fake.planned())
    first = serve(session)
    second = look_at(first.url)
    second.locator("[data-pick=theme]").click()
    set_numbers(first, "Columns, rows", 5, 3)
    expect(second.get_by_text("15 fields")).to_be_visible()
    expect(second.locator(".wv-title").first).to_have_css("color", "rgb(233, 238, 243)")
    expect(first.locator(".wv-title").first).to_have_css("color", "rgb(21, 32, 43)")


def test_a_real_rig_is_never_called_simulated(serve: Serve):
    now = fake.planned()
    real = dataclasses.replace(now, rig=dataclasses.replace(now.rig, simulated=False, name="Bench 2"))
    page = serve(fake.FakeSession(real))
    expect(page.locator(".wv-pill")).to_have_text(re.compile("REAL · Bench 2 · ready"))
    expect(page.locator(".wv-hd")).not_to_contain_text("SIMULATED")
