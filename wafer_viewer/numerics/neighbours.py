"""Distances in space from a pixel of a height map to its nearest neighbours on the lattice."""

from __future__ import annotations

import numpy as np

from wafer_viewer.numerics.jit import kernel

REACH_PX = 3


@kernel
def mean_distances(padded, rows, cols, pixel_um, neighbours):
    """The mean distance from each (row, col) to the `neighbours` nearest measured pixels of the 7 x 7 round it.

    padded: float32 with a border of 3 NaN; inf where fewer than half as many are measured.
    """
    out = np.empty(rows.size, np.float32)
    nearest = np.empty(neighbours, np.float32)
    for n in range(rows.size):
        out[n] = _mean_distance(padded, rows[n], cols[n], pixel_um, nearest)
    return out


@kernel
def beyond(padded, pixel_um, neighbours, threshold_um):
    """Which measured pixels have a mean distance over the threshold; bool, of the map before padding.

    Most have all of their neighbours within the threshold: only the others are looked at one by one.
    """
    shape = padded.shape[0] - 2 * REACH_PX, padded.shape[1] - 2 * REACH_PX
    found = np.zeros(shape, np.bool_)
    nearest = np.empty(neighbours, np.float32)
    near = np.empty(shape[1], np.int32)
    flat = (REACH_PX * pixel_um) * (REACH_PX * pixel_um) * 2.0
    climb = np.float32(np.sqrt(max(threshold_um * threshold_um - flat, 0.0)))
    for r in range(shape[0]):
        _count_near(padded, r, climb, near)
        for c in range(shape[1]):
            z = padded[r + REACH_PX, c + REACH_PX]
            if z == z and near[c] <= neighbours:
                found[r, c] = _mean_distance(padded, r, c, pixel_um, nearest) > threshold_um
    return found


@kernel
def _count_near(padded, r, climb, near):
    """Pixels of the window, the middle one included, no further in z than `climb`."""
    near[:] = 0
    here = padded[r + REACH_PX, REACH_PX:]
    for d in range(2 * REACH_PX + 1):
        for e in range(2 * REACH_PX + 1):
            other = padded[r + d, e:]
            for x in range(near.size):
                near[x] += np.int32(abs(other[x] - here[x]) <= climb)


@kernel
def _mean_distance(padded, row, col, pixel_um, nearest):
    z = padded[row + REACH_PX, col + REACH_PX]
    count = 0
    for d in range(2 * REACH_PX + 1):
        for e in range(2 * REACH_PX + 1):
            v = padded[row + d, col + e]
            if v == v and (d != REACH_PX or e != REACH_PX):
                across = ((d - REACH_PX) * (d - REACH_PX) + (e - REACH_PX) * (e - REACH_PX)) * pixel_um * pixel_um
                count = _keep_nearest(nearest, count, np.float32(np.sqrt(across + (v - z) * (v - z))))
    if 2 * count < nearest.size:
        return np.float32(np.inf)
    total = np.float32(0)
    for n in range(count):
        total += nearest[n]
    return total / np.float32(count)


@kernel
def _keep_nearest(nearest, count, distance):
    """Insert a distance into the sorted list of the nearest ones; the furthest drops out when it is full."""
    if count == nearest.size and distance >= nearest[count - 1]:
        return count
    at = min(count, nearest.size - 1)
    while at > 0 and nearest[at - 1] > distance:
        nearest[at] = nearest[at - 1]
        at -= 1
    nearest[at] = distance
    return min(count + 1, nearest.size)
