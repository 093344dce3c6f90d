"""The form of a plan says what the job says, and back."""

from __future__ import annotations

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wafer_viewer.gui.plan.plan_panel import FIRST_FRAMES, PlanForm, form_of, job_of, with_typed_range
from wafer_viewer.model.acquisition.plan import Field, FieldGrid, FocusSweep
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.job import Job
from wafer_viewer.rigs.virtual.rig import virtual_limits

LIMITS = virtual_limits(540, 720)


def a_job(**changes) -> Job:
    grid = FieldGrid(rows=3, cols=4, field_width_um=336.4488, field_height_um=252.3366, x0_um=1 / 3, y0_um=-2 / 3)
    parts = {"sample": Sample(name="coupon"), "grid": grid, "z_start_um": -6.0}
    return Job(**{**parts, "sweep": FocusSweep(z_step_um=1.5, n_frames=60), **changes})


jobs = st.builds(
    a_job,
    grid=st.builds(
        FieldGrid,
        rows=st.integers(1, 20),
        cols=st.integers(1, 20),
        field_width_um=st.floats(10, 2000),
        field_height_um=st.floats(10, 2000),
        overlap_x_fraction=st.floats(0, 0.5),
        overlap_y_fraction=st.floats(0, 0.5),
        x0_um=st.floats(-1e5, 1e5),
        y0_um=st.floats(-1e5, 1e5),
    ),
    z_start_um=st.floats(-5000, 5000),
    sweep=st.builds(FocusSweep, z_step_um=st.floats(0.01, 50), n_frames=st.integers(3, 500)),
)


@given(jobs)
def test_a_form_nobody_touched_is_the_same_job(job):
    assert job_of(form_of(job), job, LIMITS) == job


@given(jobs, st.integers(1, 30), st.integers(1, 30))
def test_more_fields_grow_round_the_same_centre(job, cols, rows):
    grown = job_of(dataclasses.replace(form_of(job), columns_rows=(float(cols), float(rows))), job, LIMITS)
    assert (grown.grid.cols, grown.grid.rows) == (cols, rows)
    assert grown.grid.center_um == pytest.approx(job.grid.center_um, abs=1e-6)
    assert grown.sweep == job.sweep


def test_the_sweep_takes_as_many_frames_as_fit():
    form = dataclasses.replace(form_of(a_job()), range_um=(-10.0, 10.0), step_um=0.1)
    job = job_of(form, a_job(), LIMITS)
    assert (job.sweep.n_frames, job.z_start_um) == (201, -10.0)


def test_a_finer_step_gives_back_the_range_that_was_typed():
    typed = (-6.0, 53.0)
    coarse = job_of(dataclasses.replace(form_of(a_job()), range_um=typed, step_um=5.0), a_job(), LIMITS)
    assert form_of(coarse).range_um == (-6.0, 49.0)
    finer = with_typed_range(dataclasses.replace(form_of(coarse), step_um=1.0), coarse, typed)
    assert job_of(finer, coarse, LIMITS).sweep.n_frames == 60
    assert job_of(with_typed_range(form_of(coarse), coarse, typed), coarse, LIMITS) == coarse


@given(jobs, st.tuples(st.floats(-100, 100), st.floats(-100, 100)))
def test_a_range_typed_for_another_job_changes_nothing(job, typed):
    form = with_typed_range(form_of(job), job, typed)
    assert job_of(form, job, LIMITS) == job


def test_the_first_size_lays_a_grid_over_the_whole_sample():
    job = job_of(PlanForm(name="coupon", size_mm="3.6 × 2.88"), None, LIMITS)
    assert job.grid.width_um >= 3600
    assert job.grid.height_um >= 2880
    assert job.grid.center_um == pytest.approx((0, 0))
    assert job.sweep.n_frames == FIRST_FRAMES
    assert job.sweep.z_step_um <= LIMITS.depth_of_field_um / 2


def test_a_list_of_fields_stays_a_list():
    fields = tuple(Field(number=n, row=0, col=n - 1, x_um=300.0 * n, y_um=0.0, z_start_um=-5.0) for n in (1, 2))
    job = a_job(grid=None, fields=fields)
    edited = job_of(dataclasses.replace(form_of(job), name="other"), job, LIMITS)
    assert (edited.fields, edited.grid, edited.sample.name) == (fields, None, "other")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"step_um": 0.0}, "over 0"),
        ({"range_um": (5.0, 5.0)}, "higher than the first"),
        ({"range_um": (0.0, 1.5)}, "n_frames is 2"),
        ({"exposures_us": "fast"}, "times in µs"),
        ({"exposures_us": ""}, "at least one exposure"),
        ({"overlap_percent": 60.0}, "between 0 and 0.5"),
        ({"columns_rows": (0.0, 3.0)}, "cols is 0"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(changes, words):
    with pytest.raises(PlanError, match=words):
        job_of(dataclasses.replace(form_of(a_job()), **changes), a_job(), LIMITS)


def test_without_a_size_or_a_rig_there_is_no_first_job():
    with pytest.raises(PlanError, match="no size"):
        job_of(PlanForm(), None, LIMITS)
    with pytest.raises(PlanError, match="rig has not reported"):
        job_of(PlanForm(size_mm="1 × 1"), None, None)


def test_the_depth_about_the_focus_makes_a_plan_follow_it_and_empty_takes_the_whole_sweep():
    followed = job_of(dataclasses.replace(form_of(a_job()), follow_um="14, 8"), a_job(), LIMITS)
    assert (followed.follow_focus.below_um, followed.follow_focus.above_um) == (14.0, 8.0)
    assert form_of(followed).follow_um == "14, 8"
    assert job_of(dataclasses.replace(form_of(followed), follow_um=""), followed, LIMITS) == a_job()
    with pytest.raises(PlanError, match="below_um"):
        job_of(dataclasses.replace(form_of(a_job()), follow_um="-14, 8"), a_job(), LIMITS)
