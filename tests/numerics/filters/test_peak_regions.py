"""Places over a limit: the same that labelling every pixel finds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from wafer_viewer.numerics.filters.regions import dilated, region_maxima, regions_with_peaks

ALL_ROUND = np.ones((3, 3), int)


@pytest.fixture(params=[0.5, 1.5, 2.5, 9.0])
def least(request):
    return request.param


@pytest.fixture
def plane():
    rng = np.random.default_rng(4)
    noisy = ndimage.gaussian_filter(rng.normal(size=(90, 130)), 1.0) * 5
    noisy[rng.random(noisy.shape) < 0.05] = np.nan
    return noisy.astype(np.float32)


@pytest.mark.parametrize("least_px", [1, 4])
def test_the_top_of_each_place_is_found_once(plane, least, least_px):
    labels, n = ndimage.label(plane >= least, ALL_ROUND)
    numbers = [k for k in range(1, n + 1) if (labels == k).sum() >= least_px]
    expected = [plane[labels == k].max() for k in numbers]
    np.testing.assert_array_equal(region_maxima(plane, least, least_px), expected)


def test_what_hangs_together_with_a_peak_belongs_to_it(plane, least):
    low, peaks = plane >= least, plane >= 2.2 * least
    labels, _ = ndimage.label(low, ALL_ROUND)
    np.testing.assert_array_equal(regions_with_peaks(low, peaks), low & np.isin(labels, labels[peaks]))


def test_nothing_is_widened_beyond_its_reach(plane, least):
    mask = plane >= least
    np.testing.assert_array_equal(dilated(mask, 4), ndimage.binary_dilation(mask, np.ones((9, 9), bool)))
