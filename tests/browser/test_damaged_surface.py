"""A dataset with a flipped byte or a deleted file on the page: one note with file and mend, and no number of it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.browser.steps import go_to, notes, press, text_field
from tests.browser.test_exchange import a_part
from wafer_viewer.session.session import Session
from wafer_viewer.store.formats.conversion import export

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
WORK_S = 400.0
MOSAIC = "results/default/mosaic.zarr/zarr.json"
SHARD = "results/default/mosaic.zarr/z_um/0/c/0/0"


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    opened = Session(tmp_path)
    export(a_part(), tmp_path / "part.x3p")
    opened.exchange.import_surface(tmp_path / "part.x3p").result(WORK_S)
    opened.wait_until(lambda now: now.surface is not None, WORK_S)
    opened.close_dataset().result(WORK_S)
    yield opened
    opened.close()


def flip(path: Path) -> None:
    harmed = bytearray(path.read_bytes())
    harmed[len(harmed) // 3] ^= 16
    path.write_bytes(harmed)


def open_part(page: Page, folder: Path) -> None:
    press(page, "Open a dataset…")
    text_field(page, "Path").fill(str(folder / "part.wafer"))
    text_field(page, "Path").press("Enter")
    expect(page.locator(".wv-mark small")).to_have_text("part")
    go_to(page, "Surface")


def is_named_once_with_its_mend(page: Page) -> None:
    note = notes(page).filter(has_text=SHARD)
    expect(note).to_have_count(1)
    expect(note).to_contain_text("import its surface file again")


def test_a_damaged_surface_is_named_with_its_mend_and_nothing_is_measured_on_it(
    page: Page, session: Session, tmp_path: Path
):
    flip(tmp_path / "part.wafer" / SHARD)
    open_part(page, tmp_path)
    is_named_once_with_its_mend(page)
    expect(page.locator(".wv-glass", has_text="not measured")).to_have_count(0)
    press(page, "Measure this surface")
    page.locator("[data-pick=tool][data-k=step]").click()
    expect(page.locator("[data-dock-region=right]")).to_contain_text(SHARD)
    expect(page.locator(".wv-answer")).to_have_count(0)
    assert session.snapshot.findings == ()


@pytest.mark.campaign
def test_a_surface_with_a_deleted_file_is_named_with_its_mend_and_has_no_numbers(
    page: Page, session: Session, tmp_path: Path
):
    (tmp_path / "part.wafer" / SHARD).unlink()
    os.utime(tmp_path / "part.wafer" / MOSAIC)  # a mosaic that does not change is looked at once by a process
    open_part(page, tmp_path)
    session.wait_until(lambda now: any(SHARD in fault.text for fault in now.faults), WORK_S)
    is_named_once_with_its_mend(page)
    expect(page.locator("body")).not_to_contain_text("Highest")
    assert session.snapshot.surface is None
