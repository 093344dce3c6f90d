"""Whose word counts on where dies lie: the operator's, a job's file, the scan's own job, or none but the surface."""

from __future__ import annotations

import math

import pytest

from tests.support.patterned_surface import Wafer, made
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep
from wafer_viewer.model.acquisition.sample import Alignment, AlignmentMark, Marks
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.job import Job
from wafer_viewer.model.measurement.feature import Die, Dies
from wafer_viewer.model.spec import encode, replace
from wafer_viewer.session.inspection.inspection_job import GivenDies, dies_of_job

WAFER = Wafer(angle_deg=1.0)
MARKS = Marks(places=(AlignmentMark(name="a", x_um=0, y_um=0), AlignmentMark(name="b", x_um=900, y_um=900)))
TURNED = Alignment(rotation_rad=-math.radians(1.0))
ALIGNED = replace(TURNED, shift_x_um=-TURNED.to_wafer(30, 25)[0], shift_y_um=-TURNED.to_wafer(30, 25)[1])
DIES = Dies(width_um=173, height_um=121, rows=4, cols=4, pitch_x_um=201.3, pitch_y_um=147.7)
JOB = Job(
    grid=FieldGrid(rows=1, cols=1, field_width_um=600, field_height_um=500),
    sweep=FocusSweep(z_step_um=1, n_frames=3),
    marks=MARKS,
    dies=DIES,
)
OWN = replace(JOB, alignment=ALIGNED)


@pytest.fixture(scope="module")
def surface():
    return made(WAFER)


@pytest.mark.slow
def test_the_scans_own_job_is_overlaid_on_what_is_seen(surface):
    dies = GivenDies().on(surface, OWN)
    assert dies.off is not None
    assert dies.grid.corner(0, 0) == pytest.approx((WAFER.x0_um, WAFER.y0_um), abs=0.5)
    assert len(dies.grid.places) == 16


def test_the_operators_input_overrides_the_job(surface):
    dies = GivenDies((201.3, 147.7), (WAFER.x0_um, WAFER.y0_um), (173, 121), 1.0, as_given=True).on(surface, OWN)
    assert dies.off is None
    assert dies.grid.angle_rad == pytest.approx(math.radians(1.0))


@pytest.mark.slow
def test_a_wafer_that_was_not_aligned_has_its_dies_found(surface):
    assert GivenDies().on(surface, JOB).grid.by == "found"


@pytest.mark.parametrize("job", [None, JOB, replace(OWN, dies=None)])
def test_no_lattice_is_taken_from_a_job_that_says_none(job):
    assert dies_of_job(job) is None


@pytest.mark.slow
def test_a_jobs_file_lies_as_the_scan_was_aligned(surface, tmp_path):
    path = tmp_path / "lx7.toml"
    path.write_text(encode(JOB))
    assert GivenDies(job=path).on(surface, OWN).grid.corner(0, 0) == pytest.approx((WAFER.x0_um, WAFER.y0_um), abs=0.5)
    with pytest.raises(MeasureError, match=r"lx7\.toml has its dies in wafer um and nothing says how the wafer lies"):
        GivenDies(job=path).on(surface)


def test_dies_listed_one_by_one_are_no_lattice():
    listed = Dies(width_um=173, height_um=121, listed=(Die(name="A", x_um=0, y_um=0),))
    assert dies_of_job(replace(OWN, dies=listed)) is None
