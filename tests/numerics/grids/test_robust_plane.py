"""A plane through differences, whatever a fifth of them is, with an uncertainty that is that of its errors."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from wafer_viewer.numerics.grids.robust_plane import Plane, differences, fit_plane

SHAPE = 160, 50
VALUE, DOWN, RIGHT = 0.4, 2e-3, -4e-3


def plane_um() -> np.ndarray:
    rows, cols = np.indices(SHAPE)
    return VALUE + DOWN * rows + RIGHT * cols


def errors(plane: Plane) -> np.ndarray:
    at_middle = VALUE + DOWN * plane.row0 + RIGHT * plane.col0
    return np.array([plane.value - at_middle, plane.slope_down - DOWN, plane.slope_right - RIGHT])


@pytest.mark.parametrize("blur", [0.0, 2.0])
def test_the_uncertainty_is_that_of_the_errors(blur):
    rng = np.random.default_rng(0)
    chi = []
    for _ in range(60):
        noise = gaussian_filter(rng.normal(size=SHAPE), blur)
        found = fit_plane((plane_um() + 0.5 * noise / noise.std()).astype(np.float32), 14)
        chi.append(errors(found) @ found.information @ errors(found) / 3)
    assert 0.5 < np.mean(chi) < 1.5


def test_false_heights_and_gaps_do_not_matter():
    rng = np.random.default_rng(0)
    z = plane_um() + rng.normal(0, 0.05, SHAPE)
    z[:, :10] += 30.0
    z[rng.random(SHAPE) < 0.1] = np.nan
    found = fit_plane(z.astype(np.float32), 14)
    assert np.abs(errors(found)[0]) < 0.01
    assert found.rms == pytest.approx(0.05, rel=0.15)
    assert found.n_pixels < 0.75 * z.size


def test_a_tilt_much_larger_than_the_noise_is_followed():
    z = 50 * plane_um() + np.random.default_rng(0).normal(0, 1e-3, SHAPE)
    found = fit_plane(z.astype(np.float32), 14)
    assert found.slope_down == pytest.approx(50 * DOWN, rel=1e-3)
    assert found.slope_right == pytest.approx(50 * RIGHT, rel=1e-3)


def test_the_slope_along_a_thin_overlap_is_less_sure():
    z = np.random.default_rng(0).normal(0, 1, (400, 24)).astype(np.float32)
    information = fit_plane(z, 12).information
    down, right = np.sqrt(np.diag(np.linalg.inv(information)))[1:]
    assert right > 8 * down


def test_too_little_to_compare_is_none():
    z = np.full(SHAPE, np.nan, np.float32)
    assert fit_plane(z, 14) is None
    z[3, 4:14] = 1.0
    assert fit_plane(z, 14) is None


def test_equal_heights_differ_by_nothing():
    found = fit_plane(np.zeros(SHAPE, np.float32), 14)
    assert (found.value, found.rms) == (0, 0)
    assert np.isfinite(found.information).all()


def test_differences_are_read_between_pixels_but_not_across_gaps_and_steps():
    rows, cols = np.indices((8, 10)).astype(np.float32)
    second = 2 * rows + 3 * cols
    second[:, 6:] += 50
    second[2, 3] = np.nan
    first = np.zeros((7, 9), np.float32)
    found = differences(first, second, 0.25, 0.5, 10.0)
    np.testing.assert_allclose(found[4:, :5], (2 * rows + 3 * cols)[4:7, :5] + 2.0, rtol=1e-6)
    assert np.isnan(found[1:3, 2:4]).all()
    assert np.isnan(found[:, 5]).all()
    assert np.isfinite(found[4:, 6:]).all()
