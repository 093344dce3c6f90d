"""Sums of neighbours, for every window that a focus measure can have."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from wafer_viewer.numerics.filters.sliding_filters import AHEAD, box, window_pieces
from wafer_viewer.numerics.jit import lean_kernel


@lean_kernel
def _box(sums: NDArray[np.int32], pieces: NDArray[np.int64], out: NDArray[np.int32]) -> None:
    box(sums, pieces, out)


@pytest.mark.parametrize("window", range(3, 26, 2))
def test_a_box_is_the_sum_of_its_neighbours(window: int) -> None:
    row = np.random.default_rng(window).integers(-1000, 1000, 150).astype(np.int32)
    sums, out = np.zeros((4, row.size + AHEAD), np.int32), np.zeros(row.size - window + 1, np.int32)
    sums[0, : row.size] = row
    _box(sums, window_pieces(window), out)
    np.testing.assert_array_equal(out, np.convolve(row, np.ones(window, np.int32), "valid"))
