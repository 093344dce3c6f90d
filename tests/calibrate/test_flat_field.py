"""Flat field and dark level from block means of several places."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.calibrate.flat_field import FlatFrames, block_means, flat_field
from wafer_viewer.model.errors import RigError

EXPOSURES = FlatFrames(100.0, 10.0)
SHAPE = (54, 72)


def sensitivity():
    y, x = np.mgrid[-1 : 1 : SHAPE[0] * 1j, -1 : 1 : SHAPE[1] * 1j]
    return 1 - 0.09 * (x**2 + y**2) + 0.03 * x


def places(seed=0, n=9, dark=4.0, strobe=False):
    """Block means at both exposures: each place has its own brightness and a texture that is left out of focus."""
    rng = np.random.default_rng(seed)
    bright, short = [], []
    for _ in range(n):
        texture = block_means(rng.normal(0, 0.03, SHAPE)) * rng.uniform(0.9, 1.1)
        light = rng.uniform(90, 110) * (block_means(sensitivity()) + texture)
        for exposure_us, out in ((100.0, bright), (10.0, short)):
            share = 1.0 if strobe else exposure_us / 100.0
            out.append(dark + light * share + rng.normal(0, 0.02, light.shape))
    return bright, short


def test_shading_and_dark_level_are_found_within_their_u():
    truth = block_means(sensitivity())
    truth /= truth.mean()
    covered, inside = [], []
    for seed in range(20):
        found = flat_field(SHAPE, *places(seed), EXPOSURES)
        maps = found.flat_field
        error = np.abs(np.array(maps.sensitivity) - truth)
        covered.append(np.mean(error <= 2 * np.array(maps.u_sensitivity)))
        inside.append(abs(found.dark_counts.value - 4.0) <= 2 * found.dark_counts.u)
        assert np.median(error) < 0.1 * np.ptp(truth)
    assert np.mean(covered) >= 0.9
    assert np.mean(inside) >= 0.9


def test_a_given_dark_level_takes_the_place_of_the_short_exposure():
    bright, _ = places(dark=20.0)
    found = flat_field(SHAPE, bright, bright, EXPOSURES, dark_counts=20.0)
    assert found.dark_counts.value == 20.0
    exact = flat_field(SHAPE, *places(dark=20.0), EXPOSURES)
    assert found.shading.value == pytest.approx(exact.shading.value, abs=2e-3)


def test_light_that_does_not_follow_the_exposure_is_refused():
    with pytest.raises(RigError, match="as with a strobe"):
        flat_field(SHAPE, *places(strobe=True), EXPOSURES)


def test_a_flat_field_takes_four_places():
    with pytest.raises(RigError, match="takes 4 places; there are 3"):
        flat_field(SHAPE, *places(n=3), EXPOSURES)


@pytest.mark.parametrize("shape", [(54, 72), (540, 720), (37, 101), (20, 20)])
def test_block_means_keep_the_mean_of_an_image(shape):
    image = np.random.default_rng(0).uniform(0, 1, shape)
    blocks = block_means(image)
    assert max(blocks.shape) <= 32
    assert blocks.mean() == pytest.approx(image.mean(), abs=0.02)
    assert block_means(np.full(shape, 7.0)) == pytest.approx(7.0)
