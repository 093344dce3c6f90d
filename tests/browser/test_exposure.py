"""The exposure as an operator finds it: a true page on the virtual rig."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.browser.steps import eventually, notes
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.job import Job
from wafer_viewer.session.session import Session

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    # The page may still be drawing when the browser of a test goes.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
READY_S = 180
GRID = FieldGrid(rows=1, cols=2, field_width_um=336.4488, field_height_um=252.3366).centred_on(800.0, 560.0)


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    opened = Session(tmp_path / "wafers")
    yield opened
    opened.close()


@pytest.mark.campaign
def test_the_exposure_is_found_and_its_bracket_taken(page: Page, session: Session):
    session.wait_until(lambda now: now.rig.state == "ready" and now.overview is not None, READY_S)
    sweep = FocusSweep(z_step_um=3.0, n_frames=14)
    job = Job(sample=Sample(name="die"), grid=GRID, z_start_um=-6.0, sweep=sweep, exposures_us=(40.0,))
    session.edit_job(job).result(READY_S)
    find = page.get_by_role("button", name="Find the exposure")
    expect(find).to_be_enabled(timeout=READY_S * 1000)
    find.click()
    expect(page.get_by_text(re.compile(r"suits the brightest field"))).to_be_visible(timeout=READY_S * 1000)
    found = session.snapshot.exposure
    assert session.snapshot.draft.job.exposures_us == found.single_us
    expect(page.get_by_label("Exposures, µs")).to_have_value(f"{found.single.exposure_us:g}")
    page.get_by_role("button", name="Take the bracket").click()
    eventually(lambda: session.snapshot.draft.job.exposures_us == found.bracket_us, "the plan has the bracket")
    expect(page.get_by_text("Z passes, exposures in turn")).to_be_visible()
    assert notes(page).count() == 0
