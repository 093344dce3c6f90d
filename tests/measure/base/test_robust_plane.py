from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.campaigns import examples
from wafer_viewer.measure.base.correlated_errors import Tiles
from wafer_viewer.measure.base.height_samples import HeightSamples
from wafer_viewer.measure.base.robust_fit import fit_plane, least_squares, robust_fit
from wafer_viewer.model.errors import MeasureError

SLOPES = st.floats(-1, 1)


def scattered(n=2000, seed=1):
    rng = np.random.default_rng(seed)
    return rng, rng.uniform(-500, 500, n) + 90_000, rng.uniform(-300, 300, n) - 40_000


@given(a=SLOPES, b=SLOPES, c=st.floats(-1e4, 1e4))
@settings(max_examples=examples(40))
def test_a_plane_far_from_the_origin_is_found_exactly(a, b, c):
    _, x_um, y_um = scattered()
    plane, fit = fit_plane(HeightSamples(x_um, y_um, a * x_um + b * y_um + c))
    assert (plane.slope_x, plane.slope_y) == pytest.approx((a, b), abs=1e-8)
    np.testing.assert_allclose(plane.at(x_um, y_um), a * x_um + b * y_um + c, atol=1e-5)
    assert fit.inliers.mean() > 0.9


def test_outliers_are_left_out_and_good_points_are_not():
    rng, x_um, y_um = scattered()
    z_um = 1e-3 * x_um + rng.normal(size=x_um.size)
    bad = rng.random(x_um.size) < 0.2
    z_um[bad] += rng.uniform(20, 80, np.count_nonzero(bad))
    plane, fit = fit_plane(HeightSamples(x_um, y_um, z_um))
    assert plane.slope_x == pytest.approx(1e-3, abs=4e-4)
    assert plane.at(90_000.0, -40_000.0) == pytest.approx(90, abs=0.15)
    assert not fit.inliers[bad].any()
    assert fit.inliers[~bad].mean() > 0.99


def test_heights_in_whole_frames_are_not_taken_for_outliers():
    _, x_um, y_um = scattered()
    z_um = np.where(np.arange(x_um.size) % 5 < 3, 4.0, 8.0)
    plane, fit = fit_plane(HeightSamples(x_um, y_um, z_um))
    assert fit.inliers.all()
    assert plane.z_um == pytest.approx(z_um.mean())


def test_the_fit_is_that_of_least_squares_where_nothing_is_left_out():
    rng, x_um, y_um = scattered(50)
    design = np.column_stack([x_um - 9e4, y_um + 4e4, np.ones(50)])
    z_um = rng.uniform(-1, 1, 50)
    expected = np.linalg.lstsq(design, z_um, rcond=None)[0]
    np.testing.assert_allclose(least_squares(design, z_um), expected, atol=1e-12)
    np.testing.assert_allclose(robust_fit(design, z_um).coefficients, expected, atol=1e-12)


@pytest.mark.parametrize("n", [0, 2, 300])
def test_points_that_span_no_plane(n):
    line = np.arange(float(n))
    with pytest.raises(MeasureError, match=rf"The {n} measured points lie on a line or are too few"):
        least_squares(np.column_stack([line, 2 * line, np.ones(n)]), line)


def test_tiles_are_means_of_their_part():
    x_um, y_um = (a.ravel() for a in np.meshgrid(np.arange(80.0), np.arange(40.0)))
    means = Tiles.of(HeightSamples(x_um, y_um, x_um + y_um), np.column_stack([x_um, y_um, x_um + y_um]), side=4).means
    assert len(means) == 16
    np.testing.assert_allclose(means[:, 2], means[:, 0] + means[:, 1])
    np.testing.assert_allclose(np.unique(means[:, 0]), [9.5, 29.5, 49.5, 69.5], atol=0.6)


def test_nearly_empty_tiles_do_not_count():
    x_um, y_um = (a.ravel() for a in np.meshgrid(np.arange(80.0), np.arange(80.0)))
    sparse = ~((x_um < 20) & (y_um < 20)) | ((x_um == 3) & (y_um == 3))
    points = HeightSamples(x_um, y_um, x_um).select(sparse)
    assert len(Tiles.of(points, points.x_um[:, None], side=4).means) == 15
