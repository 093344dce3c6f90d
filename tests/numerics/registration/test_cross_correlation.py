"""Correlation at every shift of what two pictures both know."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from wafer_viewer.numerics.cross_correlation import contrast, normalised_cross_correlation


@pytest.mark.parametrize("known", [0.8, 1.0])
def test_it_is_the_correlation_of_the_common_known_pixels(known):
    """With gaps by transforms of the masks, without by sums of rectangles."""
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(30, 20)).astype(np.float32), rng.normal(size=(26, 23)).astype(np.float32)
    valid, other = rng.random(first.shape) < known, rng.random(second.shape) < np.sqrt(known)
    first, second = first * valid, second * other
    alike = normalised_cross_correlation(first, valid, second, other, (3, -2), 4)
    for row in (-4, 0, 3):
        for col in (-4, 1, 4):
            down, right = 3 + row, -2 + col
            a = np.s_[max(0, down) : min(30, 26 + down), max(0, right) : min(20, 23 + right)]
            b = tuple(slice(s.start - n, s.stop - n) for s, n in zip(a, (down, right), strict=True))
            both = valid[a] & other[b]
            expected = (first[a] * second[b]).sum() / np.sqrt(
                (first[a] ** 2)[both].sum() * (second[b] ** 2)[both].sum()
            )
            assert alike.pixels[row + 4, col + 4] == both.sum()
            assert alike.correlation[row + 4, col + 4] == pytest.approx(expected, abs=1e-4)


def test_shifts_without_a_common_pixel_are_not_correlated():
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(2, 12, 9)).astype(np.float32)
    valid = np.ones(first.shape, bool)
    alike = normalised_cross_correlation(first, valid, second, valid, (8, -5), 6)
    lags = 8 + np.arange(-6, 7)[:, None], -5 + np.arange(-6, 7)
    np.testing.assert_array_equal(alike.pixels, np.maximum(12 - abs(lags[0]), 0) * np.maximum(9 - abs(lags[1]), 0))
    assert not alike.correlation[alike.pixels == 0].any()


@pytest.mark.parametrize("blur", [0.0, 2.0])
def test_unlike_pictures_are_few_deviations_alike(blur):
    rng = np.random.default_rng(0)
    highest, valid = [], np.ones((80, 40), bool)
    for _ in range(20):
        a, b = (gaussian_filter(rng.normal(size=(80, 40)), blur).astype(np.float32) for _ in range(2))
        highest.append(normalised_cross_correlation(a, valid, b, valid, (0, 0), 8).sigmas.max())
    assert 1.0 < np.mean(highest) < 4.0
    assert np.max(highest) < 5.5


def test_contrast_does_not_change_with_light():
    rng = np.random.default_rng(0)
    picture = gaussian_filter(rng.normal(size=(90, 70)), 1.0).astype(np.float32)
    valid = np.ones(picture.shape, bool)
    plain = contrast(picture, valid, 11)
    lit = contrast((3 * picture + 40 + 0.01 * np.arange(70)).astype(np.float32), valid, 11)
    assert np.corrcoef(plain.ravel(), lit.ravel())[0, 1] > 0.9999
    assert not contrast(np.full((9, 9), 5, np.float32), np.ones((9, 9), bool), 5).any()
    assert not contrast(picture, np.zeros(picture.shape, bool), 11).any()
