"""Sliding filters against their definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter, uniform_filter

from wafer_viewer.numerics.filters.sliding_filters import (
    blurred,
    box_mean,
    doubled,
    halved,
    highest,
    lowest,
    mean,
    mean_of_valid,
    nearest,
)

RNG = np.random.default_rng(6)


@given(size=st.sampled_from([1, 2, 3, 4, 5, 8, 9, 17]), kind=st.sampled_from([np.float32, np.uint32, np.bool_]))
def test_highest_and_lowest_keep_the_kind_of_number(size: int, kind: type) -> None:
    plane = (RNG.random((9, 12)) * 2**31).astype(np.uint32).astype(kind)
    padded = np.pad(plane, (size // 2, size - 1 - size // 2), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (size, size))
    for found, expected in ((highest(plane, size), windows.max((2, 3))), (lowest(plane, size), windows.min((2, 3)))):
        assert found.dtype == kind
        np.testing.assert_array_equal(found, expected)


def test_the_mean_of_what_is_known_leaves_out_the_rest() -> None:
    plane = np.array([[1.0, np.nan, 3.0], [5.0, np.nan, np.nan], [np.nan] * 3], np.float32)
    found = mean_of_valid(plane, np.isfinite(plane), 3)
    assert found[0, 1] == pytest.approx((2 * 1 + 5 + 2 * 3) / 5)
    assert mean_of_valid(plane, np.zeros((3, 3), bool), 3).max() == 0


def test_the_nearest_is_found_and_how_far_it_is() -> None:
    wanted = np.zeros((5, 6), bool)
    wanted[1, 2] = wanted[4, 5] = True
    distance, (rows, cols) = nearest(wanted)
    assert (rows[0, 0], cols[0, 0]) == (1, 2)
    assert distance[0, 0] == pytest.approx(np.sqrt(5))
    assert (rows[4, 4], cols[4, 4]) == (4, 5)


def test_halved_and_doubled_fit_together_at_odd_borders() -> None:
    plane = np.arange(15, dtype=np.float32).reshape(3, 5)
    half = halved(plane)
    assert half.shape == (2, 3)
    assert half[0, 0] == np.mean([0, 1, 5, 6])
    assert half[1, 2] == 14
    assert doubled(half, plane.shape).shape == plane.shape
    assert doubled(half, plane.shape)[1, 1] == half[0, 0]


def test_the_mean_of_flags_is_a_share() -> None:
    assert mean(np.eye(9, dtype=bool), 3)[4, 4] == pytest.approx(1 / 3)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize(("repeats", "mode"), [(True, "nearest"), (False, "constant")])
@pytest.mark.parametrize("shape", [(31, 44), (1, 9), (40, 1), (5, 7)])
def test_the_mean_of_a_box_is_that_of_scipy_to_the_last_bit(
    kind: type, repeats: bool, mode: str, shape: tuple[int, int]
) -> None:
    plane = RNG.normal(0, 1, shape).astype(kind)
    for size in (1, 2, 3, 8, 9, 15, 60):
        np.testing.assert_array_equal(box_mean(plane, size, repeats), uniform_filter(plane, size, mode=mode))


@pytest.mark.parametrize("sigma", [0.7, 1.0, 3.0])
@pytest.mark.parametrize("shape", [(31, 44), (1, 9), (40, 1), (5, 7)])
def test_a_blur_is_that_of_scipy_to_the_last_bit(sigma: float, shape: tuple[int, int]) -> None:
    plane = RNG.normal(0, 1, shape).astype(np.float32)
    np.testing.assert_array_equal(blurred(plane, sigma), gaussian_filter(plane, sigma, mode="nearest"))
