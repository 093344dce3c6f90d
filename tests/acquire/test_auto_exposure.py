"""Automatic exposure: the rule, its failures, brackets, and the virtual rig over the z range of some fields."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wafer_viewer.acquire.auto_exposure import (
    EXPOSURE,
    FindExposure,
    bracket_from,
    in_focus,
    levels_of,
    next_exposure_us,
    settle_exposure,
    spread_fields,
    z_positions_um,
)
from wafer_viewer.acquire.pass_runner import rig_at_rest
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep
from wafer_viewer.model.errors import MotionStopped, RigError
from wafer_viewer.model.spec import replace
from wafer_viewer.rigs.virtual.rig import VirtualRig, virtual_limits

LIMITS = virtual_limits(40, 60)
CAMERA = LIMITS.camera


def sensor(white_at_us, dark=0.0, dtype=np.uint8, shares=((1.0, 1.0),)):
    """A sample of (share of the pixels, brightness), the brightest white at an exposure; and the exposures tried."""
    tried, white = [], np.iinfo(dtype).max

    def look(exposure_us):
        tried.append(exposure_us)
        parts = [
            np.full(round(2400 * share), math.floor(white * min(1.0, dark + light * exposure_us / white_at_us)), dtype)
            for share, light in shares
        ]
        return levels_of([(1, np.concatenate(parts)[None])], exposure_us)

    return look, tried


def test_each_pixel_counts_by_its_brightest_frame():
    low, high = np.zeros((100, 100), np.uint8), np.zeros((100, 100), np.uint8)
    low[:, :50], high[:, 50:] = 51, 102
    np.testing.assert_array_equal(in_focus([low, high])[0], [51] * 50 + [102] * 50)
    assert (low.max(), high.max()) == (51, 102), "the frames are left as they are"
    with pytest.raises(RigError, match="no frame"):
        in_focus([])


def test_the_levels_are_those_of_the_brightest_field_and_of_all_pixels():
    one, other = np.full((100, 100), 51, np.uint8), np.full((100, 100), 102, np.uint8)
    one[:20], other[0, 0] = 5, 255
    levels = levels_of([(3, one), (7, other)], 80.0)
    assert (levels.exposure_us, levels.level, levels.brightest_field) == (80.0, pytest.approx(0.4), 7)
    assert (levels.dark_fraction, levels.clipped_fraction) == (0.1, 1 / 20_000)
    assert levels.dark_level == pytest.approx(5 / 255)
    other[0, :2] = 255
    assert levels_of([(7, other)], 80.0).level == 1.0, "more than one pixel of 10 000"


@given(
    white_at_us=st.floats(CAMERA.exposure_min_us * 2, CAMERA.exposure_max_us / 2),
    first_us=st.floats(CAMERA.exposure_min_us, CAMERA.exposure_max_us),
    dark=st.floats(0, 0.1),
    dtype=st.sampled_from([np.uint8, np.uint16]),
)
def test_it_settles_within_the_tolerance_from_anywhere(white_at_us, first_us, dark, dtype):
    look, tried = sensor(white_at_us, dark, dtype)
    found = settle_exposure(look, first_us, CAMERA)
    assert found.level == pytest.approx(EXPOSURE.level, abs=EXPOSURE.tolerance)
    assert found.exposure_us == tried[-1]
    assert len(tried) <= EXPOSURE.tries
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
        return levels_of([(1, np.full((4, 4), 255 * next(levels), np.uint8))], exposure_us)

    with pytest.raises(RigError, match=r"did not settle in 15 tries: .* Check that the light is steady"):
        settle_exposure(flicker, 100.0, replace(CAMERA, exposure_min_us=1e-9, exposure_max_us=1e9))


@pytest.mark.parametrize(
    ("shares", "expected_us"),
    [
        (((1.0, 1.0),), ()),
        (((0.99, 1.0), (0.01, 0.02)), ()),
        (((0.7, 1.0), (0.3, 0.04)), (800.0, 6400.0)),
        (((0.7, 1.0), (0.3, 0.0)), ()),
        (((0.5, 1.0), (0.3, 0.04), (0.2, 0.004)), (800.0, 6400.0, 51_200.0)),
    ],
    ids=["even", "few dark pixels", "dark areas", "black areas that no exposure shows", "three exposures"],
)
def test_a_bracket_is_proposed_where_longer_exposures_bring_dark_areas_to_light(shares, expected_us):
    look, _ = sensor(1000.0, shares=shares)
    single = settle_exposure(look, 100.0, CAMERA)
    bracket = bracket_from(single, look, CAMERA)
    assert [levels.exposure_us for levels in bracket] == pytest.approx(list(expected_us), rel=0.05)
    assert all(b.dark_fraction < a.dark_fraction for a, b in pairwise(bracket))


def test_the_fields_looked_at_are_spread_over_the_plan():
    grid = FieldGrid(rows=11, cols=11, field_width_um=336.0, field_height_um=252.0)
    chosen = spread_fields(grid.fields())
    assert [(field.row, field.col) for field in chosen] == [(2, 2), (2, 8), (5, 5), (8, 2), (8, 8)]
    assert len(spread_fields(grid.fields()[:2])) == 2


def test_positions_are_a_depth_of_field_apart_over_the_whole_range():
    z_um = z_positions_um(FocusSweep(z_step_um=1.0, n_frames=60), LIMITS)
    assert (z_um[0], z_um[-1]) == (0.0, 59.0)
    assert np.diff(z_um).max() <= LIMITS.depth_of_field_um
    assert len(z_positions_um(FocusSweep(z_step_um=10.0, n_frames=200), LIMITS)) == 40
    assert len(z_positions_um(FocusSweep(z_step_um=30.0, n_frames=3), LIMITS)) == 3


class Watch:
    """Control of a procedure that stops it after some frames."""

    def __init__(self, stop_after=None):
        self.steps, self.stop_after = [], stop_after

    def should_stop(self):
        return self.stop_after is not None and len(self.steps) >= self.stop_after

    def report(self, step):
        self.steps.append(step)


def search(first_us):
    grid = FieldGrid(rows=2, cols=2, field_width_um=336.0, field_height_um=252.0)
    return FindExposure(grid.fields(-20.0)[:2], FocusSweep(z_step_um=2.0, n_frames=30), first_us)


@pytest.mark.parametrize("first_us", [20.0, 3000.0])
def test_the_virtual_rig_settles_over_the_range_of_its_fields(first_us):
    # Of a picture this large, three pixels may be brighter: the noise of a single one does not decide.
    rig, watch = VirtualRig("gauge_blocks", limits=virtual_limits(150, 200)), Watch()
    with rig_at_rest(rig):
        found = search(first_us).run(rig, watch)
        again = search(found.single.exposure_us).run(rig, Watch())
    assert again.single.exposure_us == pytest.approx(found.single.exposure_us, rel=0.1)
    assert again.n_frames <= 2 * len(again.fields) * len(again.z_um), "one try, and perhaps one for a bracket"
    assert (found.fields, found.z_um[0], found.z_um[-1]) == ((1, 2), 0.0, 58.0)
    assert found.n_frames == len(watch.steps)
    fractions = [step.fraction for step in watch.steps]
    assert fractions == sorted(fractions)
    assert fractions[-1] < 1.0
    assert watch.steps[0].words == f"Field 1, z -20.0 um, {first_us:g} us"
    rig.close()


def test_a_stop_ends_the_search_at_rest():
    rig = VirtualRig("gauge_blocks", limits=virtual_limits(64, 96))
    with pytest.raises(MotionStopped), rig_at_rest(rig):
        search(100.0).run(rig, Watch(stop_after=2))
    assert not rig.stage.moving()
    rig.close()
