"""Damaged frames on the page: one sentence names them, and a button takes them again where the rig can."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.browser.steps import eventually, go_to, notes, press, title_is
from tests.session.acquisition.test_retaking import harm
from tests.session.conftest import small_job
from wafer_viewer.model.acquisition.plan import Shot
from wafer_viewer.session.session import Session
from wafer_viewer.store.dataset.dataset import Dataset

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
WORK_S = 400.0


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    opened = Session(tmp_path)
    opened.wait_until(lambda now: now.rig.state == "ready" and now.compute_ready, WORK_S)
    opened.edit_job(small_job()).result()
    path = opened.start_scan("w1").result(WORK_S)
    opened.wait_until(lambda now: now.surface_is_whole, WORK_S)
    opened.close_dataset().result()
    harm(path, Shot(1, 4), Shot(2, 9))
    opened.open_dataset(path).result()
    yield opened
    opened.close()


@pytest.mark.campaign
def test_damaged_frames_are_named_and_a_button_takes_them_again(page: Page, session: Session):
    page.keyboard.press("Control+k")
    page.locator("input.mantine-Spotlight-search").fill("Check the frames")
    page.locator(".mantine-Spotlight-action", has_text="Check the frames").first.click()
    title_is(page, "Frames are damaged")
    sentence = "2 frames are damaged: frame 5 of field 1; frame 10 of field 2."
    expect(page.locator("[data-dock-region=right] .wv-sub").first).to_have_text(sentence)
    expect(notes(page).first).to_contain_text(sentence)
    press(page, "Take damaged frames again…")
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("Wafer W1, lot L1 must lie on the stage as it did for the scan.")
    dialog.get_by_role("button", name="Take them again", exact=True).click()
    session.wait_until(lambda now: now.surface_is_whole and not now.dataset.damaged and now.dataset.finished, WORK_S)
    title_is(page, "The scan is done")
    expect(notes(page)).to_have_count(0)
    expect(page.get_by_role("button", name="Take damaged frames again…")).to_have_count(0)
    assert Dataset.open(session.snapshot.dataset.path).check().ok
    go_to(page, "Surface")
    eventually(lambda: session.snapshot.faults == (), "nothing is left to do")
