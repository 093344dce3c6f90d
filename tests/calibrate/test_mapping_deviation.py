"""x-y mapping deviation from patches at a grid of places in the image."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.wave_renderer import PIXEL_UM, WaveRenderer
from wafer_viewer.calibrate.image_geometry import grid_px, mapping_deviation, patch_position_px
from wafer_viewer.model.errors import RigError
from wafer_viewer.rigs.virtual.stage import LATERAL_ERROR_UM, LATERAL_WAVES_UM, ScaleError

SHAPE = (540, 720)
GRID = grid_px(SHAPE, 5, 7)
SAMPLE_UM = GRID * PIXEL_UM


def imaged_px(sample_um, distortion):
    """Positions in the image of points of the sample, through a lens with a radial distortion."""
    ideal = sample_um / PIXEL_UM
    corner, out = np.hypot(*SHAPE) / 2, ideal.copy()
    for _ in range(30):
        out = ideal / (1 - distortion * np.abs(out) ** 2 / corner**2)
    return out


def patches(seed, distortion, n=5):
    """Positions of patches by a stage whose scales have errors, with the noise of a registration."""
    rng = np.random.default_rng(seed)
    errors = [ScaleError((seed, axis), LATERAL_ERROR_UM, LATERAL_WAVES_UM) for axis in (1, 2)]

    def true_um(at):
        return at + np.array([complex(*(one.at(p.real, p.imag) for one in errors)) for p in np.atleast_1d(at)])

    for k in range(n):
        centre = (k / (n - 1) - 0.5) * 10_000 * np.exp(0.25j * np.pi)
        moved_um = true_um(np.array([centre])) - true_um(centre - SAMPLE_UM)
        noise = rng.normal(0, 0.01, (2, len(GRID)))
        yield imaged_px(moved_um, distortion) + noise[0] + 1j * noise[1]


@pytest.mark.parametrize("distortion", [0.0, 5e-3])
def test_a_distortion_is_found_within_u_in_spite_of_the_stage(distortion):
    truth = mapping_deviation(SAMPLE_UM, [imaged_px(SAMPLE_UM, distortion)] * 3).largest_um.value
    assert truth == pytest.approx(0.193 if distortion else 0.0, abs=1e-3)
    found = [mapping_deviation(SAMPLE_UM, list(patches(seed, distortion))).largest_um for seed in range(40)]
    assert np.mean([abs(one.value - truth) <= 2 * one.u for one in found]) >= 0.9
    assert np.median([one.u for one in found]) < 0.05, "an uncertainty that is far too large is no help either"


def test_pixel_size_and_rotation_are_no_deviation():
    turned = SAMPLE_UM / PIXEL_UM * 1.01 * np.exp(0.02j)
    assert mapping_deviation(SAMPLE_UM, [turned] * 3).largest_um.value < 1e-9


@pytest.mark.parametrize("place", [0j, 12 + 7j, -30.4 + 19.7j])
def test_a_patch_is_found_where_the_stage_moved_it(place):
    renderer = WaveRenderer(shape=(140, 180))
    at = place * PIXEL_UM
    reference, image = renderer.frame(0, 0, 0, 125.0, 1), renderer.frame(-at.real, -at.imag, 0, 125.0, 2)
    assert patch_position_px(reference, image, place) == pytest.approx(place, abs=0.02)


def test_a_patch_that_is_not_there_or_beyond_the_image_is_not_found():
    renderer = WaveRenderer(shape=(140, 180))
    reference, other = renderer.frame(0, 0, 0, 125.0, 1), renderer.frame(9_000, 7_000, 0, 125.0, 2)
    assert patch_position_px(reference, other, 0j) is None
    assert patch_position_px(reference, reference, 80 + 0j) is None


def test_places_without_a_patch_are_left_out_and_too_few_are_refused():
    found = [one.copy() for one in patches(1, 5e-3)]
    for one in found:
        one[:3] = np.nan
    deviation = mapping_deviation(SAMPLE_UM, found)
    assert np.isnan(deviation.deviation_um[:3]).all()
    assert np.isfinite(deviation.deviation_um[3:]).all()
    with pytest.raises(RigError, match="at too few places"):
        mapping_deviation(SAMPLE_UM, [np.full(len(GRID), np.nan, complex)] * 3)
    with pytest.raises(RigError, match="takes 3 patches; there are 2"):
        mapping_deviation(SAMPLE_UM, found[:2])
    with pytest.raises(RigError, match="has no room"):
        grid_px((70, 200), 5, 7)
