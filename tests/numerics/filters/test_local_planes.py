"""Planes of a sliding window: exact on a plane, whatever is missing; a jump leaves a quarter of itself."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.numerics.filters.interpolation import local_planes


def test_a_plane_with_holes_is_found_exactly() -> None:
    rows, cols = np.indices((40, 50))
    z = (3.0 * rows - 4.0 * cols + 7.0).astype(np.float32)
    z[np.random.default_rng(1).random(z.shape) < 0.3] = np.nan
    found = local_planes(z, 9)
    np.testing.assert_allclose(found.gradient, 5.0, atol=1e-4)
    np.testing.assert_allclose(found.residual, 0.0, atol=2e-3)
    np.testing.assert_allclose(found.height, 3.0 * rows - 4.0 * cols + 7.0, atol=1e-3)


def test_the_window_is_cut_off_at_the_border_and_leaves_out_what_is_missing() -> None:
    z = np.random.default_rng(1).normal(0, 1, (20, 20))
    z[:, 10] = np.nan
    found = local_planes(z, 5)
    for row, col in ((0, 0), (0, 11), (10, 9), (19, 10)):
        rows, cols = np.mgrid[max(0, row - 2) : min(20, row + 3), max(0, col - 2) : min(20, col + 3)]
        known = np.isfinite(z[rows, cols])
        y, x, heights = rows[known] - row, cols[known] - col, z[rows, cols][known]
        design = np.stack([np.ones(y.size), y, x], axis=1)
        (height, down, right), *_ = np.linalg.lstsq(design, heights)
        rest = heights - design @ (height, down, right)
        assert found.height[row, col] == pytest.approx(height)
        assert found.gradient[row, col] == pytest.approx(np.hypot(down, right))
        assert found.residual[row, col] == pytest.approx(np.sqrt(np.mean(rest**2)))


def test_a_jump_leaves_a_quarter_of_itself() -> None:
    z = np.where(np.arange(80) < 40, 0.0, 10.0) * np.ones((60, 1))
    found = local_planes(z, 21)
    assert found.residual[30, 40] == pytest.approx(2.5, rel=0.05)


def test_no_plane_goes_through_too_few_heights() -> None:
    z = np.full((9, 9), np.nan)
    assert not local_planes(z, 5).gradient.any()
    assert np.isnan(local_planes(z, 5).height).all()
    z[4, 2:7] = np.arange(5)
    assert not local_planes(z, 5).gradient.any()
