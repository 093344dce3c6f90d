"""Automatic exposure: the rule, its failures, and the virtual rig over a z range."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wafer_viewer.acquire.auto_exposure import (
    EXPOSURE,
    exposure_over_range,
    focused_level,
    next_exposure_us,
    settle_exposure,
)
from wafer_viewer.model.errors import MotionStopped, RigError
from wafer_viewer.model.spec import replace
from wafer_viewer.rigs.virtual.rig import VirtualRig, virtual_limits

CAMERA = virtual_limits(40, 60).camera


def sensor(white_at_us, dark=0.0, dtype=np.uint8):
    """A sensor whose brightest pixels are white at an exposure, and a list of the exposures tried."""
    tried, white = [], np.iinfo(dtype).max

    def take(exposure_us):
        tried.append(exposure_us)
        level = min(1.0, dark + exposure_us / white_at_us)
        yield np.full((40, 60), 0.3 * level * white, dtype)
        yield np.full((40, 60), level * white, dtype)

    return take, tried


def test_each_pixel_counts_by_its_brightest_frame():
    low, high = np.zeros((100, 100), np.uint8), np.zeros((100, 100), np.uint8)
    low[:, :50], high[:, 50:] = 51, 102
    assert focused_level([low, high]) == pytest.approx(0.4)
    high[0, 0] = 255
    assert focused_level([low, high]) == pytest.approx(0.4)
    assert focused_level([low, high], ignored=0.0) == 1.0
    with pytest.raises(RigError, match="no frame"):
        focused_level([])


def test_the_frames_are_left_as_they_are():
    frames = [np.full((4, 4), 10, np.uint16), np.full((4, 4), 20, np.uint16)]
    focused_level(frames)
    assert [frame.max() for frame in frames] == [10, 20]


@given(
    white_at_us=st.floats(CAMERA.exposure_min_us * 2, CAMERA.exposure_max_us / 2),
    first_us=st.floats(CAMERA.exposure_min_us, CAMERA.exposure_max_us),
    dark=st.floats(0, 0.1),
    dtype=st.sampled_from([np.uint8, np.uint16]),
)
def test_it_settles_within_the_tolerance_from_anywhere(white_at_us, first_us, dark, dtype):
    take, tried = sensor(white_at_us, dark, dtype)
    found_us = settle_exposure(take, first_us, CAMERA)
    assert focused_level(take(found_us)) == pytest.approx(EXPOSURE.level, abs=EXPOSURE.tolerance)
    assert len(tried) <= EXPOSURE.tries + 1
    assert all(CAMERA.exposure_min_us <= us <= CAMERA.exposure_max_us for us in tried)


def test_the_next_exposure_stays_where_it_is_good_and_within_the_limits():
    assert next_exposure_us(100.0, 0.82, CAMERA) == 100.0
    assert next_exposure_us(100.0, 0.4, CAMERA) == pytest.approx(200.0)
    assert next_exposure_us(100.0, 0.0, CAMERA) == pytest.approx(800.0)
    assert next_exposure_us(100.0, 1.0, CAMERA) == pytest.approx(35.0)
    assert next_exposure_us(CAMERA.exposure_max_us, 0.1, CAMERA) == CAMERA.exposure_max_us


def test_failures_name_the_limit_and_the_remedy():
    with pytest.raises(RigError, match=r"too bright: at the shortest exposure, 10 us, .* 100% of white\. Lower"):
        settle_exposure(sensor(1.0)[0], 100.0, CAMERA)
    with pytest.raises(RigError, match=r"too dark: at the longest exposure, 100000 us, .* only 10% of white\. Raise"):
        settle_exposure(sensor(1e6)[0], 100.0, CAMERA)


def test_light_that_does_not_follow_the_exposure_is_reported():
    levels = iter([0.3, 1.0] * 10)

    def flicker(exposure_us):
        return [np.full((4, 4), 255 * next(levels), np.uint8)]

    with pytest.raises(RigError, match=r"did not settle in 15 tries: .* Check that the light is steady"):
        settle_exposure(flicker, 100.0, replace(CAMERA, exposure_min_us=1e-9, exposure_max_us=1e9))


@pytest.mark.parametrize("first_us", [20.0, 3000.0])
def test_the_virtual_rig_settles_over_a_range(first_us):
    rig = VirtualRig("gauge_blocks", limits=virtual_limits(64, 96))
    z_um = [float(z) for z in range(-20, 40, 10)]
    found_us = exposure_over_range(rig, z_um, first_us, lambda: False)
    again_us = exposure_over_range(rig, z_um, found_us, lambda: False)
    assert again_us == pytest.approx(found_us, rel=0.1)
    assert rig.camera.next_image(0.01) is None
    rig.close()


def test_a_stop_ends_the_search_at_rest():
    rig = VirtualRig("gauge_blocks", limits=virtual_limits(64, 96))
    with pytest.raises(MotionStopped):
        exposure_over_range(rig, [0.0, 10.0], 100.0, lambda: True)
    assert not rig.stage.moving()
    rig.close()
