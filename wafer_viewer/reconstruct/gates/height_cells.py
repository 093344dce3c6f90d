"""Means and median heights of cells of 4 x 4 pixels, as in the coarse focus volume."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.numerics.jit import Bools, Float32s, Greys, Int64s, lean_kernel
from wafer_viewer.reconstruct.focus.focus_volume import COARSE_PX

REACH_PX = 48
"""Distance over which heights tell of a wall beside them."""

REACH_CELLS = REACH_PX // COARSE_PX
"""The same distance in cells."""

ENOUGH_PIXELS = 6
"""Smallest number of pixels of a cell that passed the gate, for a cell that has a height."""


def cell_means(image: Image, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return the means of cells of an image, whose border pixels repeat."""
    means = np.empty(shape, np.float32)
    _average_cells(np.ascontiguousarray(image), means)
    return means


@lean_kernel
def _average_cells(image: Greys, means: Float32s) -> None:
    last_row, last_col = image.shape[0] - 1, image.shape[1] - 1
    for i in range(means.shape[0]):
        for j in range(means.shape[1]):
            total = np.int64(0)
            for r in range(COARSE_PX * i, COARSE_PX * (i + 1)):
                for c in range(COARSE_PX * j, COARSE_PX * (j + 1)):
                    total += np.int64(image[min(r, last_row), min(c, last_col)])
            means[i, j] = total / COARSE_PX**2


def cell_medians(z_um: NDArray[np.float32], passed: NDArray[np.bool_], near: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the median height of the accepted pixels of each cell; NaN where they are few or the cell is far."""
    n_cells = int(np.count_nonzero(near))
    values, count = np.empty((n_cells, COARSE_PX**2), np.float32), np.empty(n_cells, np.int64)
    _take_cells(z_um, passed, near, values, count)
    values.sort(axis=1)
    middle = values[np.arange(n_cells), np.maximum(count - 1, 0) // 2]
    out = np.full(near.shape, np.nan, np.float32)
    out[near] = np.where(count >= ENOUGH_PIXELS, middle, np.float32(np.nan))
    return out


@lean_kernel
def _take_cells(z_um: Float32s, passed: Bools, near: Bools, values: Float32s, count: Int64s) -> None:
    """Take the accepted pixels of the cells that are near, one cell a row, and inf for the others; count: accepted."""
    n_rows, n_cols = z_um.shape
    n, far = 0, np.float32(np.inf)
    for i in range(near.shape[0]):
        for j in range(near.shape[1]):
            if not near[i, j]:
                continue
            m, accepted = 0, 0
            for r in range(COARSE_PX * i, COARSE_PX * (i + 1)):
                for c in range(COARSE_PX * j, COARSE_PX * (j + 1)):
                    inside = (r < n_rows) & (c < n_cols)
                    z = z_um[r, c] if inside and passed[r, c] else far
                    values[n, m] = z
                    m += 1
                    accepted += np.int64(z < far)
            count[n] = accepted
            n += 1
