"""The main job in the browser, with the true session: a scan on the virtual rig, and images taken elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import tifffile
from playwright.sync_api import Page, expect
from scipy import ndimage

from tests.browser.steps import (
    eventually,
    go_to,
    notes,
    numbers,
    press,
    put,
    set_numbers,
    text_field,
    title_is,
    type_into,
)
from wafer_viewer.session.session import Session
from wafer_viewer.store.dataset.dataset import Dataset

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
Z_STEP_UM, STEP_UM = 4.0, 16.0
SCAN_S, WORK_S = 180, 240
"""Long enough for a machine that does other things too; a free one needs a tenth of it."""


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    opened = Session(tmp_path / "wafers", browse=(tmp_path,))
    yield opened
    opened.close()


def test_plan_scan_surface_profile_and_step_height(page: Page, session: Session):
    session.wait_until(lambda now: now.rig.state == "ready" and now.overview is not None, WORK_S)
    plan_two_fields(page, session)
    press(page, "Start scan")
    session.wait_until(lambda now: now.scan is not None and now.scan.finished, SCAN_S)
    session.wait_until(lambda now: now.surface_is_whole, WORK_S)
    title_is(page, "The scan is done")
    press(page, "Look at the surface")
    title_is(page, "Surface")
    expect(page.locator(".wv-hd")).to_contain_text("SIMULATED")
    expect(page.locator("[data-floating-window]", has_text="Height").last).to_be_visible()
    press(page, "Measure this surface")
    title_is(page, "Profile")
    expect(page.locator(".wv-dock")).to_contain_text("Pt")
    expect(page.locator(".wv-below svg").first).to_be_visible()
    keep_a_step(page, session)
    assert notes(page).count() == 0


def plan_two_fields(page: Page, session: Session) -> None:
    press(page, "Plan a scan")
    eventually(lambda: session.snapshot.draft.job is not None, "there is a plan")
    rows = session.snapshot.draft.job.grid.rows
    expect(numbers(page, "Columns, rows").nth(1)).to_have_value(f"{rows}")  # as a person waits for it
    set_numbers(page, "Columns, rows", 2, 1)
    set_numbers(page, "Centre, µm", 800, 560)
    set_numbers(page, "From, to, µm", -6, 53)
    set_numbers(page, "Step, µm", 1)
    type_into(page, "Lot", "L2231")
    eventually(lambda: session.snapshot.draft.job.sample.lot == "L2231", "the form was taken over")
    job = session.snapshot.draft.job
    assert (job.grid.cols, job.grid.rows, job.sweep.n_frames) == (2, 1, 60)
    expect(page.locator("[data-dock-region=right]")).to_contain_text("Predicted time")


def keep_a_step(page: Page, session: Session) -> None:
    page.locator("[data-pick=tool][data-k=step]").click()
    title_is(page, "Step height")
    expect(page.locator(".wv-answer")).to_contain_text("µm")
    type_into(page, "Name", "Die to street")
    press(page, "Keep result")
    expect(page.locator("tr[data-pick=finding]")).to_contain_text("Die to street")
    finding = session.snapshot.findings[0]
    assert finding.name == "Die to street"
    assert finding.simulated
    press(page, "CSV…")
    press(page, "Save")
    eventually(lambda: list(session.snapshot.data_folder.glob("*.csv")) != [], "the results are in a file")
    press(page, "Delete")
    expect(page.locator("tr[data-pick=finding]")).to_have_count(0)
    press(page, "Undo")
    expect(page.locator("tr[data-pick=finding]")).to_have_count(1)


def test_images_taken_elsewhere_become_a_surface_and_a_kept_step(page: Page, session: Session, tmp_path: Path):
    folder = tmp_path / "stack"
    write_stack(folder)
    fill_in_import(page, str(folder))
    session.wait_until(lambda now: now.surface_is_whole, WORK_S)
    title_is(page, "Surface")
    expect(page.locator("[data-dock-region=right]")).to_contain_text("uncalibrated")
    expect(page.locator(".wv-mark")).not_to_contain_text("SIMULATED")
    assert session.snapshot.dataset.fields[0].number == 1
    press(page, "Measure this surface")
    page.locator("[data-pick=tool][data-k=step]").click()
    expect(page.locator(".wv-answer")).to_contain_text("µm")
    press(page, "Keep result")
    expect(page.locator("tr[data-pick=finding]")).to_have_count(1)
    (kept,) = Dataset.open(session.snapshot.dataset.path).result().findings().items
    assert not kept.simulated
    assert abs(kept.main.value) == pytest.approx(STEP_UM, abs=1.0)
    assert notes(page).count() == 0


def test_a_bad_import_is_told_and_writes_nothing(page: Page, session: Session, tmp_path: Path):
    folder = tmp_path / "stack"
    write_stack(folder)
    (folder / "z05.tif").write_text("this is no picture")
    fill_in_import(page, str(folder))
    expect(notes(page)).to_contain_text("z05.tif")
    eventually(lambda: session.snapshot.works == (), "nothing is at work any more")
    assert list(session.snapshot.data_folder.glob("*.wafer")) == []
    session.wait_until(lambda now: now.overview is not None, WORK_S)
    go_to(page, "Plan")
    press(page, "Plan a scan")
    eventually(lambda: session.snapshot.draft.job is not None, "the session goes on")


def fill_in_import(page: Page, path: str) -> None:
    press(page, "Import…")
    type_into(page, "Path", path)
    set_numbers(page, "z step, µm", Z_STEP_UM)
    set_numbers(page, "Pixel, µm", 0.5)
    put(page, text_field(page, "Name"), "elsewhere")
    page.get_by_role("dialog").get_by_role("button", name="Import", exact=True).click()


def write_stack(folder: Path) -> None:
    """Eleven pictures of two textured faces, a step of `STEP_UM` apart, sharp where each crosses their z."""
    folder.mkdir()
    texture = np.random.default_rng(1).integers(40, 215, (192, 256)).astype(float)
    levels = [ndimage.gaussian_filter(texture, 0.1 + 0.7 * k) for k in range(12)]
    crossing = np.where(np.arange(256) < 128, 3, 3 + STEP_UM / Z_STEP_UM)[None, :] * np.ones((192, 1))
    for k in range(11):
        blur = np.abs(crossing - k).round().astype(int)
        image = np.choose(blur, levels).round().astype(np.uint8)
        tifffile.imwrite(folder / f"z{k:02d}.tif", image)
