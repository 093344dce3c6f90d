"""Outliers against the medians along lines through a pixel, and replacement values from these lines.

A square median rounds corners and cuts thin ridges, whose pixels are a minority in any square. A pixel of a corner or
ridge has similar pixels along at least one of the four lines through it; a spike or a small blob along none.
"""

from __future__ import annotations

import numpy as np

from wafer_viewer.numerics.array_types import Bools, Float32s, Int32s, Int64s, Real, Whole
from wafer_viewer.numerics.jit import lean_kernel

REACH_PX = 5
"""Half length of a line: on its 11 pixels, a feature of up to 5 pixels is a minority."""


def line_outliers(padded: Float32s, limit: Real) -> Bools:
    """Return a mask of pixels further than `limit` from the median of each of their four lines; bool [row, col].

    padded: a map with a border of `REACH_PX` NaN, which is removed. For an even number of measured pixels, any value
    between the two middle ones counts as the median of a line.
    """
    shape = padded.shape[0] - 2 * REACH_PX, padded.shape[1] - 2 * REACH_PX
    far = np.zeros(shape, np.bool_)
    _mark_far(padded, np.float32(limit), np.zeros((3, shape[1]), np.int32), far)
    return far


def line_medians_at(padded: Float32s, rows: Int64s, cols: Int64s) -> Float32s:
    """Return the mean of the two middle medians of the four lines through each (row, col) of the unpadded map.

    Only for measured pixels, such as those of `line_outliers`.
    """
    out = np.empty(rows.size, np.float32)
    places = np.ascontiguousarray(rows), np.ascontiguousarray(cols)  # views would be compiled for once more
    _middle_medians(padded, *places, np.empty((2, 2 * REACH_PX + 1), np.float32), out)
    return out


@lean_kernel
def _mark_far(padded: Float32s, limit: Real, counts: Int32s, far: Bools) -> None:
    """Mark pixels by counting, without sorting: most of each line is out of reach on one side.

    Comparisons with NaN are false, so unmeasured pixels do not count.
    """
    above, below, lines = counts[0], counts[1], counts[2]
    for r in range(far.shape[0]):
        here = padded[r + REACH_PX, REACH_PX:]
        lines[:] = 0
        for line in range(4):
            down, right = (0, 1) if line == 0 else (1, line - 2)
            above[:] = 0
            below[:] = 0
            for s in range(-REACH_PX, REACH_PX + 1):
                other = padded[r + REACH_PX + s * down, REACH_PX + s * right :]
                for x in range(above.size):
                    v, low, high = other[x], here[x] - limit, here[x] + limit
                    above[x] += np.int32(v > high) - np.int32(v <= high)
                    below[x] += np.int32(v < low) - np.int32(v >= low)
            for x in range(above.size):
                lines[x] += np.int32((above[x] > 0) | (below[x] > 0))
        for x in range(above.size):
            far[r, x] = lines[x] == 4


@lean_kernel
def _middle_medians(padded: Float32s, rows: Int64s, cols: Int64s, scratch: Float32s, out: Float32s) -> None:
    line_of, medians = scratch[0], scratch[1]
    for n in range(rows.size):
        row, col = int(rows[n]) + REACH_PX, int(cols[n]) + REACH_PX
        for line in range(4):
            down, right = (0, 1) if line == 0 else (1, line - 2)
            count = np.int64(0)
            for s in range(-REACH_PX, REACH_PX + 1):
                v = padded[row + s * down, col + s * right]
                if v == v:
                    count = insert_sorted(line_of, count, v)
            insert_sorted(medians, line, np.float32(0.5) * (line_of[(count - 1) // 2] + line_of[count // 2]))
        out[n] = np.float32(0.5) * (medians[1] + medians[2])


@lean_kernel
def insert_sorted(values: Float32s, count: Whole, v: Real) -> int:
    """Insert v into the first `count` values, which ascend; return the new count."""
    at = count
    while at > 0 and values[at - 1] > v:
        values[at] = values[at - 1]
        at -= 1
    values[at] = v
    return count + 1
