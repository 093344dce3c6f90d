"""Surface files of other programs, on a true session: in through the page, measured, and out in another format."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from tests.browser.steps import eventually, press, text_field, type_into
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.session.session import Session
from wafer_viewer.store.formats.conversion import export, read_surface

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    opened = Session(tmp_path)
    yield opened
    opened.close()


def a_part() -> HeightMap:
    """A step of 12 um on a slope, with a hole."""
    z = np.repeat(0.02 * np.arange(200, dtype=np.float32)[None], 160, axis=0)
    z[:80] += 12
    z[20:30, 40:60] = np.nan
    gaps = np.isnan(z)
    return HeightMap(
        z_um=z,
        z_raw_um=z,
        confidence=np.ones_like(z),
        all_in_focus=np.zeros(z.shape, np.uint8),
        origin=np.where(gaps, np.uint8(12), np.uint8(0)),
        pixel_um=0.5,
        x0_um=2000.25,
        y0_um=-300.5,
    )


def test_a_file_of_another_program_is_opened_measured_and_exported(session: Session, page: Page):
    folder = session.snapshot.data_folder
    part = folder / "part.x3p"
    export(a_part(), part)
    press(page, "Open a dataset…")
    type_into(page, "Path", str(part))
    page.get_by_role("dialog").get_by_role("button", name="Open", exact=True).click()
    expect(page.locator("body")).to_contain_text("200 × 160 points")
    expect(page.locator("body")).to_contain_text("uncalibrated")
    eventually(lambda: session.snapshot.surface is not None, "the surface is known")
    page.keyboard.press("Shift+E")
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Format").click()
    page.get_by_role("option", name="GSF, Gwyddion's simple field").click()
    expect(dialog).to_contain_text("It holds heights only")
    expect(text_field(page, "File name")).to_have_value("part.gsf")
    dialog.get_by_role("button", name="Export", exact=True).click()
    eventually(lambda: (folder / "part.gsf").exists(), "the file is written")
    np.testing.assert_allclose(read_surface(folder / "part.gsf").z_um, a_part().z_um, atol=1e-5)
