"""Devices that break one demand, each on the check of that demand alone."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace as changed

import pytest

from tests.acquire.conformance.conftest import BY_NAME
from wafer_viewer.acquire.conformance.runner import run_checks
from wafer_viewer.model.errors import RigError
from wafer_viewer.model.spec import replace


class Changed:
    """A device of which some methods are replaced; each gets the device first."""

    def __init__(self, device, **methods):
        self._device, self._methods = device, methods

    def __getattr__(self, name):
        if name in self._methods:
            return lambda *args, **settings: self._methods[name](self._device, *args, **settings)
        return getattr(self._device, name)


class ChangedRig(Changed):
    """A rig of which a device is replaced."""

    def __init__(self, rig, **devices):
        super().__init__(rig)
        for name, device in devices.items():
            setattr(self, name, device)


def box(**methods):
    return lambda rig: ChangedRig(rig, box=Changed(rig.box, **methods))


def stage(**methods):
    return lambda rig: ChangedRig(rig, stage=Changed(rig.stage, **methods))


def camera(**methods):
    return lambda rig: ChangedRig(rig, camera=Changed(rig.camera, **methods))


def silently(call):
    """Carry out a command that may be refused, and do as if it was not."""
    try:
        call()
    except RigError:
        return


def reboots(numbers=itertools.count(1)):
    return lambda device: changed(device.hello(), boot=next(numbers))


def twice(device):
    device.fire()
    device._clock.sleep(0.001)
    device.fire()


def wide(rig):
    axis = replace(rig.limits.x, counts_per_um=20.2)
    return ChangedRig(rig, limits=replace(rig.limits, x=axis))


def late_stop(device, *, should_stop=None, **goal):
    device.move_to(**goal, should_stop=None if should_stop is None else lambda: should_stop() and False)


def drifting(device, timeout_s):
    image = device.next_image(timeout_s)
    return image and changed(image, device_time_us=round(image.device_time_us * 1.001))


def automatic(device, exposure_us):
    device.start(exposure_us)
    device._exposures_us = (100.0,)


def unrefused(device, *, should_stop=None, **goal):
    silently(lambda: device.move_to(**goal, should_stop=should_stop))


WRONG = {
    "box_refuses_without_reference": (
        box(arm=lambda device, *args, **settings: silently(lambda: device.arm(*args, **settings))),
        "armed for the x and y and z axis, which was not referenced",
    ),
    "box_identity": (box(hello=reboots()), "boot number changed between 1 and 5"),
    "box_counts_at_rest": (
        box(count=lambda device, axis: device.count(axis) + 7 * (axis == "y")),
        "count of the y axis moves while the stage stands, by 7 counts",
    ),
    "box_fires_once": (box(fire=lambda device: silently(lambda: twice(device))), "instead of 20|carried out after"),
    "box_refuses_while_armed": (
        box(reference=lambda device, *args: silently(lambda: device.reference(*args))),
        "armed box accepted REF",
    ),
    "box_pulses_fast": (
        box(pulses=lambda device: [changed(pulse, count=pulse.count + 1) for pulse in device.pulses()]),
        r"x axis, up, at 100000 um/s: a pulse came at count -?\d+ instead of -?\d+, 64 in all",
    ),
    "box_up_and_down": (
        box(pulses=lambda device: [changed(pulse, count=0) for pulse in device.pulses()]),
        "The count 0 gave a pulse each time that it was crossed",
    ),
    "box_least_gap": (
        box(arm=lambda device, train, min_gap_us=0.0, **settings: device.arm(train, **settings)),
        "No pulse was suppressed",
    ),
    "stage_homed": (stage(homed=lambda device: False), "does not report that it is homed"),
    "stage_soft_limits": (
        stage(move_to=unrefused, start=lambda device, *args: None),
        r"x axis accepted a goal at 155001\.0 um.*z axis accepted a speed of 50000 um/s|z axis accepted",
    ),
    "stage_stops": (stage(move_to=late_stop), "x axis went on to its goal after the request to stop"),
    "camera_exposure_range": (
        camera(start=lambda device, exposure_us: None),
        "accepted an exposure of 0 us and -1 us and 5 us and 200000 us",
    ),
    "camera_exposure_time": (camera(start=automatic), r"longer by 49000 us delayed the image by \d us"),
    "camera_brightness": (camera(start=automatic), "does not follow the exposure"),
    "clocks": (camera(next_image=drifting), r"clock of the camera runs \+1020 ppm off"),
    "scales": (wide, r"counts_per_um of the x axis is 20\.2 in the rig's file and 20\.0000 by this motion"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_device_that_breaks_a_demand_fails_its_check(name, switched_on):
    make, words = WRONG[name]
    rig = switched_on()
    (result,) = run_checks(make(rig), move=True, checks=[BY_NAME[name]])
    assert result.verdict == "failed"
    assert re.search(words, result.why), result.why
    assert not rig.stage.moving()
    (result,) = run_checks(rig, move=True, checks=[BY_NAME[name]])
    assert result.why == "" or "referenced since the box started" in result.why


def test_every_check_is_known_to_fail():
    from tests.acquire.conformance.test_planted_faults import PLANTED

    assert {*WRONG, *(planted.check for planted in PLANTED.values())} == set(BY_NAME)
