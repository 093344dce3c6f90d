"""The form of a plan says what the job says, and back."""

from __future__ import annotations

import dataclasses

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.browser.sessions import fake_session as fake
from wafer_viewer.gui.steps.plan_form import FIELDS, FIRST_FRAMES, finer_range, job_of, no_job, typed_values, values_of
from wafer_viewer.model.acquisition.plan import Field, FieldGrid, FocusSweep
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.job import Job
from wafer_viewer.rigs.virtual.rig import virtual_limits
from wafer_viewer.session.state.snapshot import Typed

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


def values(job: Job) -> dict[str, object]:
    return {key: one.get(job) for key, one in FIELDS.items()}


@given(jobs)
def test_a_form_nobody_touched_is_the_same_job(job):
    assert job_of(values(job), job, LIMITS) == job


@given(jobs, st.integers(1, 30), st.integers(1, 30))
def test_more_fields_grow_round_the_same_centre(job, cols, rows):
    grown = job_of({"counts": (float(cols), float(rows))}, job, LIMITS)
    assert (grown.grid.cols, grown.grid.rows) == (cols, rows)
    assert grown.grid.center_um == pytest.approx(job.grid.center_um, abs=1e-6)
    assert grown.sweep == job.sweep


def test_the_sweep_takes_as_many_frames_as_fit():
    job = job_of({"sweep": (-10.0, 10.0, 0.1)}, a_job(), LIMITS)
    assert (job.sweep.n_frames, job.z_start_um) == (201, -10.0)


def test_range_and_step_are_judged_together():
    coarse = a_job(sweep=FocusSweep(z_step_um=5.0, n_frames=11))
    assert job_of({"sweep": (0.0, 1.0, 0.1)}, coarse, LIMITS).sweep.n_frames == 11


def test_a_finer_step_gives_back_the_range_that_was_typed():
    typed = (-6.0, 53.0)
    coarse = job_of({"sweep": (*typed, 5.0)}, a_job(), LIMITS)
    shown = values(coarse)["sweep"]
    assert shown == (-6.0, 49.0, 5.0)
    finer = job_of({"sweep": (*finer_range(coarse, shown, typed), 1.0)}, coarse, LIMITS)
    assert finer.sweep.n_frames == 60
    assert finer_range(coarse, (-6.0, 40.0, 5.0), typed) == (-6.0, 40.0), "another range is on its way"
    assert finer_range(None, (-6.0, 40.0, 5.0), typed) == (-6.0, 40.0)


@given(jobs, st.tuples(st.floats(-100, 100), st.floats(-100, 100)))
def test_a_range_typed_for_another_job_changes_nothing(job, typed):
    low, high, step = values(job)["sweep"]
    again = job_of({"sweep": (*finer_range(job, (low, high, step), typed), step)}, job, LIMITS)
    assert again.sweep == job.sweep


def test_the_first_size_lays_a_grid_over_the_whole_sample():
    job = job_of({"sample.name": "coupon", "size": "3.6 × 2.88"}, None, LIMITS, "K. Adler")
    assert (job.sample.name, job.sample.operator) == ("coupon", "K. Adler")
    assert job.grid.width_um >= 3600
    assert job.grid.height_um >= 2880
    assert job.grid.center_um == pytest.approx((0, 0))
    assert job.sweep.n_frames == FIRST_FRAMES
    assert job.sweep.z_step_um <= LIMITS.depth_of_field_um / 2


def test_a_list_of_fields_stays_a_list():
    fields = tuple(Field(number=n, row=0, col=n - 1, x_um=300.0 * n, y_um=0.0, z_start_um=-5.0) for n in (1, 2))
    job = a_job(grid=None, fields=fields)
    edited = job_of({"sample.name": "other"}, job, LIMITS)
    assert (edited.fields, edited.grid, edited.sample.name) == (fields, None, "other")


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("sweep", (-6.0, 82.5, 0.0), "over 0"),
        ("sweep", (5.0, 5.0, 1.5), "higher than the first"),
        ("sweep", (0.0, 1.5, 1.5), "n_frames is 2"),
        ("exposures", "fast", "times in µs"),
        ("exposures", "", "at least one exposure"),
        ("overlap", 60.0, "between 0 and 0.5"),
        ("counts", (0.0, 3.0), "cols is 0"),
        ("size", "12", "Size, mm"),
        ("follow", "-14, 8", "below_um"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(key, value, words):
    with pytest.raises(PlanError, match=words):
        job_of({key: value}, a_job(), LIMITS)


def test_without_a_size_or_a_rig_there_is_no_first_job():
    with pytest.raises(PlanError, match="no size"):
        job_of({}, None, LIMITS)
    with pytest.raises(PlanError, match="rig has not reported"):
        job_of({"size": "1 × 1"}, None, None)


def test_the_depth_about_the_focus_makes_a_plan_follow_it_and_empty_takes_the_whole_sweep():
    followed = job_of({"follow": "14, 8"}, a_job(), LIMITS)
    assert (followed.follow_focus.below_um, followed.follow_focus.above_um) == (14.0, 8.0)
    assert values(followed)["follow"] == "14, 8"
    assert job_of({"follow": ""}, followed, LIMITS) == a_job()


@given(jobs)
def test_what_is_typed_comes_back_as_it_was_stored(job):
    typed = values(job)
    stored = Typed(msgspec.json.encode(typed).decode(), "no plan yet")
    assert typed_values(stored) == typed


@pytest.mark.parametrize("form", ["", "{", '{"name": "of another version"}', '{"sweep": [1, 2]}', '{"counts": "3"}'])
def test_stored_input_of_another_version_is_left_alone(form):
    assert typed_values(Typed(form, "")) == {}


def test_form_shows_what_is_on_its_way_over_what_is_typed_over_the_job():
    now = fake.planned()
    typed = Typed('{"exposures": "quick", "sample.lot": "L1"}', "The exposures read 'quick'.")
    now = dataclasses.replace(now, draft=dataclasses.replace(now.draft, typed=typed))
    shown = values_of(now, {"sample.lot": "L2"})
    assert (shown["exposures"], shown["sample.lot"]) == ("quick", "L2")
    assert shown["sample.name"] == now.draft.job.sample.name
    empty = values_of(fake.empty(), {})
    assert empty == values(no_job())
