"""Motion of an axis: limits kept, and crossings exact."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wafer_viewer.model.acquisition.devices import Position
from wafer_viewer.rigs.virtual.clock import VirtualClock
from wafer_viewer.rigs.virtual.rig import virtual_limits
from wafer_viewer.rigs.virtual.stage import AXIAL_ERROR_UM, LATERAL_ERROR_UM, VirtualStage, halt, standing, trapezoid

ENDS = st.floats(-5_000, 5_000)
SPEEDS = st.floats(1, 5_000)
ACCELERATIONS = st.floats(1_000, 200_000)


@given(ENDS, ENDS, SPEEDS, ACCELERATIONS)
def test_a_trapezoid_ends_where_it_should_within_its_limits(start, end, speed, acceleration):
    profile = trapezoid(2.0, start, end, speed, acceleration)
    times = np.linspace(2.0, profile.end_s, 200)
    speeds = np.array([profile.speed_at(t) for t in times])
    assert profile.position_at(2.0) == pytest.approx(start, abs=1e-6)
    assert profile.position_at(profile.end_s + 1) == pytest.approx(end, abs=1e-6)
    assert np.abs(speeds).max() <= speed * (1 + 1e-9)
    positions = np.array([profile.position_at(t) for t in times])
    assert (np.diff(positions) * np.sign(end - start) >= -1e-6).all()


@given(ENDS, ENDS, SPEEDS, ACCELERATIONS, st.floats(0.001, 0.999))
def test_a_crossing_is_when_the_axis_is_there(start, end, speed, acceleration, share):
    profile, there = trapezoid(0.0, start, end, speed, acceleration), start + share * (end - start)
    if abs(end - start) < 1e-3:
        return
    direction = 1 if end > start else -1
    crossing_s = profile.crossing_s(there, direction, 0.0)
    assert profile.position_at(crossing_s) == pytest.approx(there, abs=1e-5)
    assert profile.crossing_s(there, -direction, 0.0) is None
    assert profile.crossing_s(there, direction, profile.end_s + 1) is None
    assert profile.crossing_s(end + direction, direction, 0.0) is None


@given(SPEEDS, ACCELERATIONS, st.sampled_from([-1, 1]))
def test_a_halt_takes_the_ramp(speed, acceleration, direction):
    profile = halt(1.0, 10.0, direction * speed, acceleration)
    assert profile.position_at(9e9) == pytest.approx(10.0 + direction * speed**2 / acceleration / 2)
    assert profile.speed_at(profile.end_s + 1e-9) == 0.0


def test_an_axis_that_stands_crosses_nothing():
    assert standing(5.0).crossing_s(5.0, 1, 0.0) is None
    assert standing(5.0).position_at(1e9) == 5.0


def test_the_scales_are_wrong_by_as_much_as_said_and_always_alike():
    limits = virtual_limits(16, 24)
    stages = [VirtualStage(VirtualClock(), limits, seed) for seed in (1, 1, 2)]
    places = [
        Position(x, y, (x + y) / 100) for x in np.arange(-30e3, 30e3, 2_111) for y in np.arange(-30e3, 30e3, 2_111)
    ]
    truths = [[s.truth_of(p) for p in places] for s in stages]
    assert truths[0] == truths[1] != truths[2]
    off_x = np.array([t.x_um - p.x_um for t, p in zip(truths[0], places, strict=True)])
    off_z = np.array([t.z_um - p.z_um for t, p in zip(truths[0], places, strict=True)])
    assert off_x.std() == pytest.approx(LATERAL_ERROR_UM, rel=0.3)
    assert off_z.std() == pytest.approx(AXIAL_ERROR_UM, rel=0.3)


def test_an_axis_rings_when_it_halts_and_is_quiet_when_settled():
    clock = VirtualClock()
    stage = VirtualStage(clock, virtual_limits(16, 24))
    stage.move_to(x_um=1_000.0)
    settled_s = clock.now_s()
    halted_s = settled_s - virtual_limits(16, 24).x.settle_s
    quiet_x_um = stage.truth_of(stage.position()).x_um
    assert abs(stage.truth_at(halted_s).x_um - quiet_x_um) > 0.1
    assert abs(stage.truth_at(settled_s).x_um - quiet_x_um) < 0.002
