"""Sums along sampled rows of frames, exact in integers: of cells, and of squared differences."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.jit import Greys, Int, Int64s, lean_kernel


def native_copy(pixels: NDArray[Any]) -> Greys:
    """Return a contiguous copy in native byte order, the only type for which the kernels are compiled."""
    return np.array(pixels, pixels.dtype.newbyteorder("="), order="C")


def cell_sums(rows: Greys, cell: tuple[int, int], least: int) -> tuple[Int64s, Int64s]:
    """Return the sum of complete cells of rows, [row, cell], and the number of their pixels of at least `least`.

    rows: from `native_copy`; cell: rows and columns of a cell.
    """
    high, wide = cell
    sums, over = (np.zeros((rows.shape[0] // high, rows.shape[1] // wide), np.int64) for _ in range(2))
    _sum_cells(rows, high, wide, least, sums, over)
    return sums, over


def slope_energies(rows: Greys, apart: int) -> Int64s:
    """Return the sum of the squared differences of pixels `apart` columns apart, of each row; rows: as above."""
    energies = np.zeros(len(rows), np.int64)
    _sum_slopes(rows, apart, energies)
    return energies


@lean_kernel
def _sum_cells(rows: Greys, high: Int, wide: Int, least: Int, sums: Int64s, over: Int64s) -> None:
    i = np.int32
    limit = i(min(least, 65536))
    for r in range(sums.shape[0] * high):
        for j in range(sums.shape[1]):
            cell, total, count = rows[r, j * wide : (j + 1) * wide], i(0), i(0)
            for x in range(cell.size):
                grey = i(cell[x])
                total = i(total + grey)
                count = i(count + i(grey >= limit))
            sums[r // high, j] += total
            over[r // high, j] += count


@lean_kernel
def _sum_slopes(rows: Greys, apart: Int, energies: Int64s) -> None:
    i = np.int64
    for r in range(rows.shape[0]):
        row, ahead, total = rows[r], rows[r, apart:], i(0)
        for x in range(ahead.size):
            slope = i(i(ahead[x]) - i(row[x]))
            total += slope * slope
        energies[r] = total
