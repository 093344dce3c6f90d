"""The contract of the role Stage, on the virtual stage and on every driver."""

from __future__ import annotations

import pytest

from tests.rigs.stages.conftest import BENCHES
from wafer_viewer.acquire.conformance import stage_checks
from wafer_viewer.acquire.conformance.bench import ConformanceBench
from wafer_viewer.model.errors import MotionStopped, RigError

LATE_S = 0.1
"""A busy machine may look that late at a rig that lives in real time."""


@pytest.mark.slow
@pytest.mark.parametrize("check", stage_checks.CHECKS, ids=lambda check: check.name)
@pytest.mark.parametrize("kind", [kind for kind in BENCHES if "real time" not in kind])
def test_it_meets_the_demands_of_the_conformance_checks(kind, check):
    outcome = check.run(ConformanceBench(BENCHES[kind]()))
    assert (outcome.fault, outcome.skipped) == ("", "")


def test_it_is_off_at_once_and_keeps_its_speed(rig):
    begun_s = rig.clock.now_s()
    rig.stage.start("z", 50.0, 500.0)
    assert rig.stage.moving()
    assert rig.clock.now_s() - begun_s < 0.05
    rig.stage.wait()
    assert not rig.stage.moving()
    assert 0.1 < rig.clock.now_s() - begun_s < 0.4
    assert rig.stage.position().z_um == pytest.approx(50.0, abs=0.1)


def test_a_stop_ends_a_motion_on_its_way(rig):
    rig.stage.start("z", 9_000.0, 1_000.0)
    rig.clock.sleep(0.1)
    rig.stage.stop()
    rig.stage.wait()
    assert not rig.stage.moving()
    stood = rig.stage.position().z_um
    assert 80.0 < stood < 400.0
    rig.clock.sleep(0.05)
    assert rig.stage.position().z_um == stood
    rig.stage.move_to(z_um=stood - 10.0)
    assert rig.stage.position().z_um == pytest.approx(stood - 10.0, abs=0.1)


def test_out_of_range_nothing_starts(rig):
    with pytest.raises(RigError, match="z axis"):
        rig.stage.start("z", rig.limits.z.low_um - 1, 100.0)
    with pytest.raises(RigError, match=rf"x axis.*{rig.limits.x.high_um + 1:.2f}.*{rig.limits.x.high_um:g}"):
        rig.stage.move_to(z_um=5.0, x_um=rig.limits.x.high_um + 1)
    assert rig.stage.position().z_um == 0.0


@pytest.mark.parametrize("speed_um_s", [0.0, -5.0, 1e9])
def test_a_speed_that_cannot_be_is_refused(rig, speed_um_s):
    with pytest.raises(RigError, match="um/s"):
        rig.stage.start("z", 5.0, speed_um_s)
    assert not rig.stage.moving()


def test_a_second_motion_of_the_same_axis_is_refused(rig):
    rig.stage.start("z", 100.0, 500.0)
    with pytest.raises(RigError, match="still moving"):
        rig.stage.start("z", 0.0, 500.0)
    rig.stage.stop()


def test_a_move_is_broken_off_where_it_is_told_to(rig):
    speed_um_s, ramp_um = rig.limits.z.speed_um_s, rig.limits.z.ramp_um(rig.limits.z.speed_um_s)
    asked_at = []

    def should_stop():
        asked_at.append(rig.stage.position().z_um)
        return asked_at[-1] > 500.0

    with pytest.raises(MotionStopped) as told:
        rig.stage.move_to(z_um=2_000.0, should_stop=should_stop)
    at = rig.stage.position()
    assert not rig.stage.moving()
    assert ramp_um == pytest.approx(speed_um_s**2 / rig.limits.z.acceleration_um_s2 / 2)
    assert ramp_um * 0.999 <= at.z_um - asked_at[-1] <= ramp_um + speed_um_s * LATE_S
    assert str(told.value) == f"The move was stopped at X +0.0000, Y +0.0000, Z {at.z_um / 1000:+.4f} mm."
    rig.stage.move_to(z_um=at.z_um - 100.0)
    assert rig.stage.position().z_um == pytest.approx(at.z_um - 100.0, abs=0.1)


def test_all_axes_of_a_move_are_broken_off_together(rig):
    with pytest.raises(MotionStopped):
        rig.stage.move_to(x_um=3e4, y_um=-3e4, z_um=900.0, should_stop=lambda: rig.stage.position().x_um > 1_000.0)
    at = rig.stage.position()
    assert 1_000.0 < at.x_um < 3e4
    assert at.y_um == pytest.approx(-at.x_um, abs=rig.limits.x.speed_um_s * LATE_S)
    assert 0.0 < at.z_um < 900.0


def test_a_move_that_is_called_off_before_it_begins_moves_nothing(rig):
    with pytest.raises(MotionStopped, match=r"X \+0\.0000, Y \+0\.0000, Z \+0\.0000 mm"):
        rig.stage.move_to(x_um=1e4, should_stop=lambda: True)
    assert rig.stage.position().x_um == 0.0


def test_what_has_arrived_and_only_settles_is_not_broken_off(rig):
    rig.stage.move_to(z_um=20.0, should_stop=lambda: rig.stage.position().z_um >= 20.0)
    assert rig.stage.position().z_um == pytest.approx(20.0, abs=0.1)


@pytest.mark.slow
def test_what_arrives_while_it_is_asked_for_a_stop_is_not_broken_off(rig):
    def should_stop():
        if rig.stage.position().z_um == 0.0:
            return False
        rig.clock.sleep(0.5)
        return True

    rig.stage.move_to(z_um=20.0, should_stop=should_stop)
    assert rig.stage.position().z_um == pytest.approx(20.0, abs=0.1)
