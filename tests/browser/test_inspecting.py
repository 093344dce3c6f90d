"""Inspect on the true session where dies are too few, and where nothing can be inspected: said once, in one place."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from tests.browser.steps import go_to, press
from tests.support.datasets.compared_datasets import dataset_of
from tests.support.virtual_part import virtual_part
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.session.session import Session

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
READY_S = 240
WAIT_MS = READY_S * 1000


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    surface = virtual_part("wafer")
    dataset_of(tmp_path / "one-die.wafer", surface, "one die", "2026-01-01T08:00:00")
    nothing, dark = np.full(surface.shape, np.nan, np.float32), np.full(surface.shape, Origin.NO_TEXTURE, np.uint8)
    bare = dataclasses.replace(surface, z_um=nothing, z_raw_um=nothing, origin=dark)
    dataset_of(tmp_path / "bare.wafer", bare, "bare", "2026-01-01T09:00:00")
    opened = Session(tmp_path)
    opened.wait_until(lambda now: now.rig.state == "ready" and now.compute_ready, READY_S)
    yield opened
    opened.close()


def inspect(page: Page, session: Session, name: str) -> None:
    """Open a dataset and press Inspect in Review."""
    session.open_dataset(session.snapshot.data_folder / name).result(READY_S)
    session.wait_until(lambda now: now.surface is not None, READY_S)
    go_to(page, "Review")
    press(page, "Inspect")


@pytest.mark.campaign
def test_a_single_die_is_compared_with_the_form_and_a_bare_surface_says_why_once(page: Page, session: Session):
    inspect(page, session, "one-die.wafer")
    session.wait_until(lambda now: now.inspection.dies_missing, READY_S)
    assert session.snapshot.inspection.inspection is None
    page.get_by_text("Compare with the fitted form").click(timeout=WAIT_MS)
    found = session.wait_until(lambda now: now.inspection.inspection is not None, READY_S).inspection.inspection
    assert found.reference == "form"
    assert found.notes[0].startswith("Only what stands out of the fitted form is seen")
    expect(page.get_by_text("inspected, compared with the fitted form")).to_have_count(1, timeout=WAIT_MS)
    assert found.defects[0].kind == "residue"
    expect(page.get_by_text(found.notes[0])).to_have_count(1, timeout=WAIT_MS)
    expect(page.get_by_text("Inspection failed")).to_have_count(0)
    expect(page.locator(".wv-defects tr", has_text="Unmeasured")).to_have_count(0)

    inspect(page, session, "bare.wafer")
    why = session.wait_until(lambda now: now.inspection.problem != "", READY_S).inspection.problem
    expect(page.get_by_text(why)).to_have_count(1, timeout=WAIT_MS)
    expect(page.get_by_text("Inspection failed")).to_have_count(1)
