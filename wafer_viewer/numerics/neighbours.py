"""How far a pixel of a height map is from its nearest neighbours, along z: across they are a lattice."""

from __future__ import annotations

import numpy as np

from wafer_viewer.numerics.arrays import Bools, Float32s, Int32s, Int64s, Real, Whole
from wafer_viewer.numerics.jit import kernel

REACH_PX = 3


@kernel
def mean_distances(padded: Float32s, rows: Int64s, cols: Int64s, neighbours: Whole) -> Float32s:
    """The mean distance from each (row, col) to the `neighbours` nearest measured pixels of the 7 x 7 round it.

    padded: a map with a border of 3 NaN; inf where fewer than half as many are measured.
    """
    out = np.empty(rows.size, np.float32)
    nearest = np.empty(neighbours, np.float32)
    for n in range(rows.size):
        out[n] = _mean_distance(padded, rows[n], cols[n], nearest)
    return out


@kernel
def beyond(padded: Float32s, neighbours: Whole, threshold_um: Real) -> Bools:
    """Which measured pixels have a mean distance over the threshold, of the map before padding.

    A pixel with enough neighbours within the threshold is not looked at any further: that leaves a few.
    """
    n_rows, n_cols = padded.shape[0] - 2 * REACH_PX, padded.shape[1] - 2 * REACH_PX
    found = np.zeros((n_rows, n_cols), np.bool_)
    nearest = np.empty(neighbours, np.float32)
    near = np.empty(n_cols, np.int32)
    limit = np.float32(threshold_um)
    for r in range(n_rows):
        _count_near(padded, r, limit, near)
        for c in range(n_cols):
            z = padded[r + REACH_PX, c + REACH_PX]
            if z == z and near[c] <= neighbours:
                found[r, c] = _mean_distance(padded, r, c, nearest) > limit
    return found


@kernel
def _count_near(padded: Float32s, r: Whole, limit: Real, near: Int32s) -> None:
    """Pixels of the window within the limit, the middle one included."""
    near[:] = 0
    here = padded[r + REACH_PX, REACH_PX:]
    for d in range(2 * REACH_PX + 1):
        for e in range(2 * REACH_PX + 1):
            other = padded[r + d, e:]
            for x in range(near.size):
                near[x] += np.int32(abs(other[x] - here[x]) <= limit)


@kernel
def _mean_distance(padded: Float32s, row: Whole, col: Whole, nearest: Float32s) -> Real:
    z = padded[row + REACH_PX, col + REACH_PX]
    count = 0
    for d in range(2 * REACH_PX + 1):
        for e in range(2 * REACH_PX + 1):
            v = padded[row + d, col + e]
            if v == v and (d != REACH_PX or e != REACH_PX):
                count = _keep_nearest(nearest, count, abs(v - z))
    if 2 * count < nearest.size:
        return np.float32(np.inf)
    return np.float32(nearest[:count].mean())


@kernel
def _keep_nearest(nearest: Float32s, count: Whole, distance: Real) -> Whole:
    """Insert a distance into the sorted list of the nearest ones; the furthest drops out when it is full."""
    if count == nearest.size and distance >= nearest[count - 1]:
        return count
    at = min(count, nearest.size - 1)
    while at > 0 and nearest[at - 1] > distance:
        nearest[at] = nearest[at - 1]
        at -= 1
    nearest[at] = distance
    return min(count + 1, nearest.size)
