"""The contract of the role Stage."""

from __future__ import annotations

import pytest

from wafer_viewer.model.errors import RigError


def test_it_goes_where_it_is_told_and_leaves_the_other_axes(rig):
    rig.stage.move_to(x_um=40.0, z_um=12.0)
    rig.stage.move_to(y_um=-20.0)
    at = rig.stage.position()
    assert (at.x_um, at.y_um, at.z_um) == pytest.approx((40.0, -20.0, 12.0), abs=0.1)
    assert not rig.stage.moving()


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


def test_out_of_range_nothing_moves(rig):
    far_um = rig.limits.x.high_um + 1
    with pytest.raises(RigError, match=rf"x axis.*{far_um:.2f}.*{rig.limits.x.high_um:g}"):
        rig.stage.move_to(z_um=5.0, x_um=far_um)
    assert rig.stage.position().z_um == 0.0
    with pytest.raises(RigError, match="z axis"):
        rig.stage.start("z", rig.limits.z.low_um - 1, 100.0)


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
