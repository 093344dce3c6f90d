"""The operator's way: a released job from its wafer's id to its verdict, and what stands in the way of one."""

from __future__ import annotations

import dataclasses
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.browser.sessions import fake_session as fake
from tests.browser.sessions import operator_session as day
from tests.browser.steps import eventually, notes, press, put, set_numbers, text_field, title_is, type_into
from tests.test_house import ROOT
from wafer_viewer.model.spec import replace
from wafer_viewer.session.session import Session

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
JOB = ROOT / "assets" / "jobs" / "demonstration-wafer-A.toml"
WORK_S = 240
"""Long enough for a machine that does other things too."""


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    data = tmp_path / "wafers"
    (data / "jobs").mkdir(parents=True)
    shutil.copy(JOB, data / "jobs")
    opened = Session(data)
    yield opened
    opened.close()


def test_four_actions_from_the_wafers_id_to_its_verdict(page: Page, session: Session):
    session.wait_until(lambda now: now.rig.state == "ready" and now.overview is not None, WORK_S)
    page.locator("[data-pick=job]", has_text="demonstration wafer").click()
    title_is(page, re.compile("demonstration wafer"))
    expect(start_button(page)).to_be_disabled()
    expect(page.get_by_label("Columns, rows")).to_have_count(0)

    expect(text_field(page, "Wafer id")).to_be_focused()
    page.keyboard.type("W07", delay=60)
    page.keyboard.press("Enter")
    eventually(lambda: session.snapshot.draft.job.sample.wafer_id == "W07", "the id was taken over")

    mark(page, 1, across=0.5, down=0.5)
    mark(page, 2, across=0.85, down=0.5)
    expect(page.locator(".wv-note.fault")).to_contain_text("Too large")
    expect(check(page, "Alignment")).to_contain_text("too large")
    expect(start_button(page)).to_be_disabled()
    page.get_by_role("button", name="Mark again").click()
    mark(page, 1, across=0.51, down=0.5)

    page.reload()
    page.locator(".wv-title").first.wait_for()
    expect(text_field(page, "Wafer id")).to_have_value("W07")
    mark(page, 2, across=0.5, down=0.49)
    expect(page.locator(".wv-note.good")).to_contain_text("2 corners, residual")

    start_button(page).click()
    expect(page.get_by_label("Verdict")).to_contain_text("PASS", timeout=1000 * WORK_S)
    expect(page.get_by_label("Verdict")).to_contain_text("SIMULATED")
    expect(page.get_by_label("Verdict")).to_contain_text("W07")
    expect(page.locator("[data-dock-region=right]")).to_contain_text("die over street")
    kept = session.snapshot.dataset
    assert kept.job.alignment.n_marks == 2
    assert (kept.path / "results" / "default" / "verdict.json").exists()

    press(page, "Next wafer")
    title_is(page, re.compile("demonstration wafer"))
    expect(text_field(page, "Wafer id")).to_have_value("")
    expect(check(page, "Alignment")).to_contain_text("Not aligned: 0 of 2 corners marked")
    assert notes(page).count() == 0


def mark(page: Page, number: int, across: float, down: float) -> None:
    """Click where a corner is seen, at shares of its picture."""
    picture = page.get_by_label(re.compile(f"^Click corner {number}:"))
    box = picture.bounding_box()
    picture.click(position={"x": across * box["width"], "y": down * box["height"]})
    expect(picture).to_have_count(0)


def start_button(page: Page) -> Locator:
    return page.get_by_role("button", name="Start scan")


def check(page: Page, what: str) -> Locator:
    return page.get_by_role("listitem").filter(has_text=what)


def test_what_is_not_as_it_should_be_is_asked_about_first(serve: Callable[..., Page]):
    session = fake.FakeSession(dataclasses.replace(fake.planned(), rig=replace_calibration(None)))
    page = serve(session)
    press(page, "Start scan")
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("The rig has no calibration.")
    expect(dialog).not_to_contain_text("Clearance")
    assert "start_scan" not in [name for name, _, _ in session.asked]
    dialog.get_by_role("button", name="Start", exact=True).click()
    eventually(lambda: "start_scan" in [name for name, _, _ in session.asked], "the scan was started")


def replace_calibration(calibration: None) -> fake.RigStatus:
    return dataclasses.replace(fake.RIG, calibration=calibration)


@pytest.mark.campaign
def test_an_engineer_adds_corners_and_a_feature_and_releases(serve: Callable[..., Page]):
    session = fake.FakeSession(fake.planned())
    page = serve(session)
    page.get_by_text("For operators").click()
    press(page, "Corners…")
    set_numbers(page, "Limit, µm", 12)
    press(page, "Keep")
    eventually(lambda: session.snapshot.draft.job.marks is not None, "the corners are kept")
    press(page, "Feature…")
    type_into(page, "Nominal, µm", "30")
    type_into(page, "Lower limit", "31")
    type_into(page, "Upper limit", "29")
    press(page, "Keep")
    expect(page.get_by_role("dialog")).to_contain_text("over the lower limit 31 µm")
    type_into(page, "Lower limit", "29")
    type_into(page, "Upper limit", "31")
    set_numbers(page, "Upper, µm", 10, 20)
    set_numbers(page, "Lower, µm", 70, 20)
    press(page, "Keep")
    eventually(lambda: len(session.snapshot.draft.job.features) == 1, "the feature is kept")
    assert session.snapshot.draft.job.marks.limit_um == 12
    press(page, "Release…")
    press(page, "Release")
    expect(page.get_by_role("dialog")).to_contain_text("Product and revision both need a name")
    put(page, text_field(page, "Revision"), "A")
    put(page, page.get_by_role("dialog").locator("input").first, "coupon")
    press(page, "Release")
    eventually(lambda: "jobs.release" in [name for name, _, _ in session.asked], "the job is released")
    assert (session.snapshot.draft.job.product, session.snapshot.draft.job.revision) == ("coupon", "A")


def test_an_engineer_makes_a_kept_result_a_feature_and_tries_the_plan_on_stored_wafers(
    serve: Callable[..., Page], tmp_path: Path
):
    planned = dataclasses.replace(fake.measured(), draft=day.tried().draft, operating=day.tried().operating)
    session = fake.FakeSession(planned)
    page = serve(session)
    page.get_by_text("For operators").click()
    expect(page.get_by_text("1 of 4 verdicts changes")).to_be_visible()
    press(page, "Feature…")
    page.get_by_role("dialog").get_by_label("Measured as").click()
    page.get_by_role("option").nth(1).click()
    page.get_by_role("dialog").get_by_label("Quantity").click()
    expect(page.get_by_role("option", name="the main one")).to_be_visible()
    page.keyboard.press("Escape")
    expect(text_field(page, "Lower limit")).to_have_attribute("placeholder", "no limit")
    type_into(page, "Upper limit", "90")
    press(page, "Keep")
    eventually(lambda: len(session.snapshot.draft.job.features) == 3, "the feature is kept")
    assert session.snapshot.draft.job.features[-1].places
    limits = session.snapshot.draft.job.features[-1]
    assert (limits.lower_limit, limits.upper_limit) == (None, 90)
    press(page, "Try on wafers…")
    put(page, text_field(page, "Path"), str(tmp_path))
    press(page, "Try it")
    eventually(lambda: "trials.begin" in [name for name, _, _ in session.asked], "the plan is tried")


QUICK_HAND = """
([option, list]) => {
  option.dispatchEvent(new MouseEvent('click', { bubbles: true, detail: 1 }));
  list.focus();
  list.click();
}
"""
"""Chooses from one list and opens another before the first has let the keys go."""


def test_a_list_opened_right_after_another_was_chosen_from_keeps_the_keys(serve: Callable[..., Page]):
    planned = dataclasses.replace(fake.measured(), draft=day.tried().draft, operating=day.tried().operating)
    page = serve(fake.FakeSession(planned))
    page.get_by_text("For operators").click()
    press(page, "Feature…")
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Measured as").click()
    option, quantity = page.get_by_role("option").nth(1), dialog.get_by_label("Quantity").first
    page.evaluate(QUICK_HAND, [option.element_handle(), quantity.element_handle()])
    expect(page.get_by_role("option", name="the main one")).to_be_visible()
    page.wait_for_timeout(200)
    page.keyboard.press("Escape")
    page.wait_for_timeout(500)
    expect(dialog).to_be_visible()
    expect(page.get_by_role("option", name="the main one")).not_to_be_visible()


def test_everything_of_a_released_job_can_be_seen_and_nothing_changed(serve: Callable[..., Page]):
    page = serve(fake.FakeSession(day.aligned()))
    page.get_by_role("button", name="Show everything").click()
    title_is(page, re.compile("Coupon 6 mm, revision B"))
    expect(page.get_by_role("button", name="Cover the sample")).to_be_disabled()
    page.get_by_text("For operators").click()
    expect(page.get_by_role("button", name="Copy to a new plan")).to_be_visible()
    expect(page.get_by_role("button", name="Release…")).to_have_count(0)
    page.get_by_role("button", name="Show less").click()
    expect(text_field(page, "Wafer id")).to_have_value("W07")


@pytest.mark.parametrize(
    ("verdict", "word", "told"),
    [(day.FAIL, "FAIL", "Set the wafer aside"), (day.OPEN, "INCONCLUSIVE", "times more: the mean of")],
)
def test_a_verdict_is_a_word_and_says_what_to_do(serve: Callable[..., Page], verdict: object, word: str, told: str):
    session = fake.FakeSession(day.judged(verdict))
    page = serve(session)
    page.get_by_role("button", name="Surface", exact=True).first.click()
    expect(page.get_by_label("Verdict")).to_contain_text(word)
    expect(page.get_by_label("Verdict")).to_contain_text(told)
    session.change(dataset=dataclasses.replace(session.snapshot.dataset, job=replace(fake.a_job())))
    expect(page.get_by_label("Verdict")).to_have_count(0)


def test_a_plan_that_is_there_is_replaced_only_by_its_name(serve: Callable[..., Page], tmp_path: Path):
    (tmp_path / "L2231-W07.toml").write_text("an older plan")
    session = fake.FakeSession(dataclasses.replace(fake.planned(), data_folder=tmp_path))
    page = serve(session)
    press(page, "Save plan…")
    expect(text_field(page, "File name")).to_have_value("L2231-W07.toml")
    press(page, "Save")
    dialog = page.get_by_role("dialog", name="Replace L2231-W07.toml?")
    expect(dialog).to_be_visible()
    dialog.get_by_role("button", name="Cancel").click()
    assert "save_plan" not in [name for name, _, _ in session.asked]
    press(page, "Save")
    press(page, "Replace L2231-W07.toml")
    eventually(lambda: "save_plan" in [name for name, _, _ in session.asked], "the plan was saved")
