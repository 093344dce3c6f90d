"""Height differences between a pixel and its nearest neighbours; laterally the pixels form a grid."""

from __future__ import annotations

import numpy as np

from wafer_viewer.numerics.array_types import Float32s, Int32s, Int64s, Real, Whole
from wafer_viewer.numerics.jit import lean_kernel

REACH_PX = 3


def mean_distances(padded: Float32s, rows: Int64s, cols: Int64s, neighbours: Whole) -> Float32s:
    """Return the mean |dz| from each (row, col) to the `neighbours` nearest measured pixels of its 7 x 7 window.

    padded: a map with a border of 3 NaN; inf if fewer than half as many are measured.
    """
    out = np.empty(rows.size, np.float32)
    places = np.ascontiguousarray(rows), np.ascontiguousarray(cols)  # views would be compiled for once more
    _mean_distances(padded, *places, np.empty(neighbours, np.float32), out)
    return out


def near_counts(padded: Float32s, limit: Real) -> Int32s:
    """Return the number of other pixels within `limit` of each pixel in its 7 x 7 window, unpadded; -1 for NaN."""
    out = np.full((padded.shape[0] - 2 * REACH_PX, padded.shape[1] - 2 * REACH_PX), -1, np.int32)
    _count_near(padded, np.float32(limit), out)
    return out


@lean_kernel
def _count_near(padded: Float32s, limit: Real, out: Int32s) -> None:
    for r in range(out.shape[0]):
        near, here = out[r], padded[r + REACH_PX, REACH_PX:]
        for down in range(2 * REACH_PX + 1):
            for right in range(2 * REACH_PX + 1):
                other = padded[r + down, right:]
                for x in range(near.size):
                    near[x] += np.int32(abs(other[x] - here[x]) <= limit)


@lean_kernel
def _mean_distances(padded: Float32s, rows: Int64s, cols: Int64s, nearest: Float32s, out: Float32s) -> None:
    """Insertion sort into `nearest`; the furthest value is dropped when it is full."""
    for n in range(rows.size):
        row, col, count = int(rows[n]), int(cols[n]), 0
        z = padded[row + REACH_PX, col + REACH_PX]
        for k in range((2 * REACH_PX + 1) ** 2):
            v = abs(padded[row + k // (2 * REACH_PX + 1), col + k % (2 * REACH_PX + 1)] - z)
            if v == v and k != 2 * REACH_PX * (REACH_PX + 1) and (count < nearest.size or v < nearest[count - 1]):
                count = min(count + 1, nearest.size)
                at = count - 1
                while at > 0 and nearest[at - 1] > v:
                    nearest[at] = nearest[at - 1]
                    at -= 1
                nearest[at] = v
        total = np.float32(0.0)
        for k in range(count):
            total += nearest[k]
        out[n] = total / np.float32(count) if 2 * count >= nearest.size else np.inf
