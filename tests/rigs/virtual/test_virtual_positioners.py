"""Lamp and tilts of the virtual rig, and what its camera sees of them."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.acquire.commanded_frames import CommandedFrames
from wafer_viewer.acquire.motion import move_positioner
from wafer_viewer.model.errors import MotionStopped, RigTimeout
from wafer_viewer.rigs.virtual.faults import Faults
from wafer_viewer.rigs.virtual.rig import VirtualRig, virtual_limits


@pytest.fixture
def switch_on():
    rigs = []

    def opened(**changes):
        rigs.append(VirtualRig("wafer", seed=3, limits=virtual_limits(64, 96), **changes))
        return rigs[-1]

    yield opened
    for rig in rigs:
        rig.close()


def seen(rig, exposure_us=60.0):
    frames = CommandedFrames(rig, exposure_us)
    frames.open()
    frame = frames.take()
    frames.close()
    return frame.image


def test_at_full_light_and_without_tilt_the_pictures_are_those_of_a_rig_without_positioners(switch_on):
    plain, rig = seen(switch_on(positioners={})), switch_on()
    assert {name: one.position() for name, one in rig.positioners.items()} == {"lamp": 100.0, "tilt_a": 0, "tilt_b": 0}
    assert np.array_equal(seen(rig), plain)


def test_the_lamp_scales_the_light_as_a_shorter_exposure_does(switch_on):
    dim, short = switch_on(), switch_on()
    dim.positioners["lamp"].move_to(50.0)
    assert np.array_equal(seen(dim, 60.0), seen(short, 30.0))


@pytest.mark.parametrize(("name", "rise_um"), [("tilt_a", 5_000 * 0.017455), ("tilt_b", -3_000 * 0.017455)])
def test_a_tilt_by_a_degree_moves_the_focus_with_the_sample(name, rise_um, switch_on):
    level, rig = switch_on(), switch_on()
    place = {"x_um": 3_000.0, "y_um": 5_000.0}
    flat_um = float(level.truth_for_tests(*place.values()))
    level.stage.move_to(**place, z_um=flat_um)
    move_positioner(rig, name, 1.0, lambda: False)
    assert float(rig.truth_for_tests(*place.values())) == pytest.approx(flat_um + rise_um, abs=0.01)
    rig.stage.move_to(**place, z_um=flat_um + rise_um)
    upright, tilted = seen(level).astype(float), seen(rig).astype(float)
    middle = np.s_[22:42, 30:66]
    assert np.abs(tilted[middle] - upright[middle]).mean() < 8.0
    rig.stage.move_to(**place, z_um=flat_um)
    assert seen(rig)[middle].astype(float).std() < 0.8 * tilted[middle].std()


def test_a_virtual_positioner_is_stopped_and_is_given_up_when_it_does_not_arrive(switch_on):
    rig = switch_on()
    looks = iter(range(9))
    with pytest.raises(MotionStopped, match=r"'lamp' was stopped at"):
        rig.positioners["lamp"].move_to(0.0, lambda: next(looks) > 3)
    assert not rig.stage.moving()
    late = switch_on(faults=Faults(endless_motions=(0,)))
    with pytest.raises(RigTimeout, match=r"'lamp' still reports motion"):
        late.positioners["lamp"].move_to(0.0)
