"""Grids and fields: numbering, centres, cover."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep, Leg, PulseTrain, Shot
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.job import Job


def test_fields_are_numbered_row_by_row_from_the_top_left():
    fields = FieldGrid(rows=2, cols=3, field_width_um=100.0, field_height_um=80.0).fields(5.0)
    assert [f.number for f in fields] == [1, 2, 3, 4, 5, 6]
    assert fields[1].x_um > fields[0].x_um
    assert fields[3].y_um < fields[0].y_um
    assert {f.z_start_um for f in fields} == {5.0}
    assert fields[4].name == "r0001c0001"


@given(st.floats(1, 5000), st.floats(1, 5000), st.floats(0, 0.5), st.floats(-1000, 1000))
def test_a_covering_grid_covers_and_is_centred(width, height, overlap, x):
    grid = FieldGrid.covering(
        width, height, field_width_um=336.0, field_height_um=252.0, overlap_x_fraction=overlap, center_x_um=x
    )
    assert grid.width_um >= width - 1e-6
    assert grid.height_um >= height - 1e-6
    assert grid.center_um == pytest.approx((x, 0), abs=1e-6)
    if grid.cols > 1:
        assert grid.resized(rows=grid.rows, cols=grid.cols - 1).width_um < width


def test_a_leg_needs_a_shot_for_each_pulse():
    train = PulseTrain(axis="z", first_count=0, counts_per_frame=10, n_frames=3, direction=1)
    with pytest.raises(PlanError, match="3 shots"):
        Leg(train=train, shots=(Shot(1, 0), Shot(1, 1)), x_um=0.0, y_um=0.0, z_um=0.0, speed_um_s=100.0)


def test_a_job_lists_its_fields_from_the_grid_or_as_given():
    grid = FieldGrid(rows=2, cols=2, field_width_um=100.0, field_height_um=80.0)
    sweep = FocusSweep(z_step_um=2.0, n_frames=10)
    by_grid = Job(grid=grid, sweep=sweep, z_start_um=-4.0)
    by_list = Job(fields=by_grid.all_fields(), sweep=sweep)
    assert by_list.all_fields() == by_grid.all_fields()
    assert sweep.z_um(by_grid.all_fields()[0], 3) == 2.0
