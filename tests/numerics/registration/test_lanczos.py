"""Pictures read between their pixels."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.numerics.grids.resampling import Taps, resampled


def _waves(rows: np.ndarray, cols: np.ndarray) -> np.ndarray:
    """A picture that is known between its pixels too."""
    return 120 + 60 * np.sin(rows / 5)[:, None] * np.cos(cols / 7) + 20 * np.sin(cols / 3)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("growth", [1.0, 1.01, 0.98])
def test_a_smooth_picture_is_read_right_between_its_pixels(dtype, growth):
    picture = np.rint(_waves(np.arange(60.0), np.arange(90.0))).astype(dtype)
    rows, cols = 10.3 + growth * np.arange(40.0), 12.7 + growth * np.arange(60.0)
    found = resampled(picture, Taps.at(rows), Taps.at(cols))
    assert found.dtype == dtype
    assert np.abs(found - _waves(rows, cols)).max() < 1.5


def test_whole_pixels_are_copied():
    picture = np.random.default_rng(1).integers(0, 256, (30, 40), np.uint8)
    found = resampled(picture, Taps.at(np.arange(5.0, 25.0)), Taps.at(np.arange(8.0, 30.0)))
    np.testing.assert_array_equal(found, picture[5:25, 8:30])


def test_beyond_the_picture_its_border_repeats():
    picture = np.random.default_rng(1).integers(0, 256, (30, 40), np.uint8)
    found = resampled(picture, Taps.at(np.arange(-20.0, 35.0)), Taps.at(np.arange(-9.0, 60.0)))
    np.testing.assert_array_equal(found, np.pad(picture, ((20, 5), (9, 20)), mode="edge"))


def test_black_and_white_are_not_overshot():
    picture = np.zeros((20, 40), np.uint8)
    picture[:, 20:] = 255
    found = resampled(picture, Taps.at(np.arange(3.0, 15.0)), Taps.at(np.arange(3.0, 35.0) + 0.5))
    assert found[:, :12].max() < 40
    assert found[:, 25:].min() > 215
