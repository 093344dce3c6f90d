"""The alignment of a wafer: found again from its marks, with what is left over, and refused when it cannot be."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wafer_viewer.calibrate.wafer_alignment import fit_alignment
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep
from wafer_viewer.model.acquisition.sample import Alignment, AlignmentMark, Marks
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.job import Job
from wafer_viewer.model.spec import replace

PLACES = ((-2500.0, -400.0), (2400.0, 300.0), (100.0, 2300.0))
MARKS = Marks(places=tuple(AlignmentMark(name=f"corner {n}", x_um=x, y_um=y) for n, (x, y) in enumerate(PLACES, 1)))


def seen_through(alignment, marks=MARKS):
    return [alignment.to_stage(m.x_um, m.y_um) for m in marks.places]


@given(
    st.sampled_from([("down", 0.0), ("right", -90.0), ("left", 90.0), ("up", 180.0)]),
    st.floats(-4.9, 4.9),
    st.floats(-5000, 5000),
    st.floats(-5000, 5000),
)
def test_turn_and_shift_are_found_again(notch, more_deg, x_um, y_um):
    name, turn_deg = notch
    true = Alignment(rotation_rad=math.radians(turn_deg + more_deg), shift_x_um=x_um, shift_y_um=y_um)
    found = fit_alignment(MARKS, seen_through(true), name)
    assert found.to_wafer(812.0, -77.0) == pytest.approx(true.to_wafer(812.0, -77.0), abs=1e-6)
    assert found.residual_um == pytest.approx(0, abs=1e-6)
    assert found.n_marks == 3


def test_the_residual_is_the_distance_of_the_worst_mark_and_no_other_fit_is_better():
    observed = np.array(seen_through(Alignment(rotation_rad=0.01, shift_x_um=50.0)))
    observed[1] += (6.0, -2.0)
    found = fit_alignment(MARKS, [tuple(place) for place in observed], "down")
    off = np.array([found.to_wafer(*place) for place in observed]) - PLACES
    assert found.residual_um == pytest.approx(np.hypot(*off.T).max())
    assert 1.5 < found.residual_um < 6.4

    def squares(alignment):
        return sum(math.dist(alignment.to_wafer(*p), w) ** 2 for p, w in zip(observed, PLACES, strict=True))

    for change in (1e-5, -1e-5):
        assert squares(found) < squares(replace(found, rotation_rad=found.rotation_rad + change))
        assert squares(found) < squares(replace(found, shift_x_um=found.shift_x_um + 1e3 * change))


def test_two_marks_show_in_the_residual_that_their_distance_is_wrong():
    two = replace(MARKS, places=MARKS.places[:2])
    stretched = [(-2500.0 * 1.01, -400.0 * 1.01), (2400.0 * 1.01, 300.0 * 1.01)]
    assert fit_alignment(two, stretched, "down").residual_um == pytest.approx(0.005 * math.hypot(4900, 700), rel=1e-6)


@pytest.mark.parametrize(
    ("observed", "notch", "words"),
    [
        ([(0.0, 0.0)], "down", "1 of 3 corners are marked"),
        ([(5.0, 5.0)] * 3, "down", "in one place"),
        (list(PLACES), "right", "turned by 90.0 degrees"),
        ([(-2500.0, -400.0), (2400.0, 900.0), (100.0, 2900.0)], "down", "mark the corners named"),
    ],
)
def test_what_is_no_alignment_is_refused_in_a_sentence(observed, notch, words):
    with pytest.raises(PlanError, match=words):
        fit_alignment(MARKS, observed, notch)


def test_the_fields_of_an_aligned_job_lie_where_the_wafer_is():
    grid = FieldGrid(rows=1, cols=2, field_width_um=300.0, field_height_um=200.0).centred_on(1000.0, 0.0)
    job = Job(grid=grid, marks=MARKS, sweep=FocusSweep(z_step_um=1.0, n_frames=10))
    turned = Alignment(rotation_rad=math.pi / 2, shift_x_um=10.0)
    on_stage = replace(job, alignment=turned).all_fields()
    assert [(f.number, f.row, f.col) for f in on_stage] == [(1, 0, 0), (2, 0, 1)]
    for planned, moved in zip(job.all_fields(), on_stage, strict=True):
        assert turned.to_wafer(moved.x_um, moved.y_um) == pytest.approx((planned.x_um, planned.y_um))
    with pytest.raises(PlanError, match="no marks"):
        replace(job, marks=None, alignment=turned)
