"""Rays from a point of the pupil down to the sample: where each of them ends and what comes back along it.

Plain numba of its own: nothing here is shared with the program under test.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

_NEAREST_UM = 0.05
"""No step of a ray is shorter, along the sample."""
_TOUCH_UM = 0.01
_PATIENCE = 4000


@njit(cache=True, nogil=True, inline="always")
def _sample(lattice, n, row, col):
    """Bilinear in lattice n; beyond the border the border's values go on."""
    row = min(max(row, 0.0), lattice.shape[1] - 1.001)
    col = min(max(col, 0.0), lattice.shape[2] - 1.001)
    i, j = int(row), int(col)
    y, x = row - i, col - j
    upper = lattice[n, i, j] * (1 - x) + lattice[n, i, j + 1] * x
    lower = lattice[n, i + 1, j] * (1 - x) + lattice[n, i + 1, j + 1] * x
    return upper * (1 - y) + lower * y


@njit(cache=True, nogil=True)
def _ground_um(heights, row, col, t_row, t_col):
    """The height above the plane of the ray's start at which it meets the ground layer, which is gentle."""
    z = _sample(heights, 0, row, col)
    for _ in range(60):
        found = _sample(heights, 0, row + z * t_row, col + z * t_col)
        if abs(found - z) < _TOUCH_UM:
            return found
        z = found
    return z


@njit(cache=True, nogil=True)
def _between(heights, n, row, col, t_row, t_col, high, low):
    """Where a ray that is above a surface at `high` and at or below it at `low` meets it."""
    while high - low > _TOUCH_UM:
        z = (high + low) / 2
        if z > _sample(heights, n, row + z * t_row, col + z * t_col):
            high = z
        else:
            low = z
    return low


@njit(cache=True, nogil=True)
def _meet_layer(heights, outlines, n, row, col, t_row, t_col, slope, top_um, floor_um):
    """How a ray meets layer n between two heights: (2, z) on its surface, (1, z) at its wall, (0, floor) not at all.

    It goes down in steps no longer than the way to the nearest outline, so that it passes none.
    """
    z = last = top_um
    above = True
    for _ in range(_PATIENCE):
        if z <= floor_um:
            return 0, floor_um
        away = _sample(outlines, n, row + z * t_row, col + z * t_col)
        step = max(abs(away), _NEAREST_UM) / slope
        if away < 0:
            clearance = z - _sample(heights, n, row + z * t_row, col + z * t_col)
            if clearance <= _TOUCH_UM:
                if above and clearance < -_TOUCH_UM:
                    z = _between(heights, n, row, col, t_row, t_col, last, z)
                return (2 if above else 1), z
            step = min(step, clearance)
            above = True
        else:
            above = False
        last = z
        z -= step
    return 0, floor_um


@njit(cache=True, nogil=True)
def _find(heights, outlines, tops, bottoms, row, col, t_row, t_col, slope):
    """The layer whose light a ray brings, whether it is from a wall, and the height where it ended."""
    for layer in range(len(heights) - 1, 0, -1):
        top, bottom = tops[layer], bottoms[layer - 1]
        how, z = _meet_layer(heights, outlines, layer, row, col, t_row, t_col, slope, top, bottom)
        if how == 2:
            return layer, False, z
        if how == 1 and (layer > 1 or z > _ground_um(heights, row, col, t_row, t_col)):
            return layer, True, z
    return 0, False, _ground_um(heights, row, col, t_row, t_col)


@njit(cache=True, nogil=True)
def trace_view(
    heights, outlines, reflectances, glosses, leans_row, leans_col, tops, bottoms, wall, pixel_um,
    row0, col0, tan_row, tan_col, lobe, lobe_gain, planes,
):  # fmt: skip
    """What comes back towards one point of the pupil, into planes [layer, row, col], zero where another layer is seen.

    A second set of planes after these is for where each layer but the last is seen: 1 there, 0 elsewhere.
    Heights are above the plane in which the rays start, at (row0 + row, col0 + col) in pixels of the lattice; tan_row
    and tan_col say where they go as they rise. A ray's radiance is reflectance x (1 - gloss + gloss x lobe).
    """
    t_row, t_col = tan_row / pixel_um, tan_col / pixel_um
    slope = max(math.hypot(tan_row, tan_col), 1e-6)
    planes[:] = 0
    for r in range(planes.shape[1]):
        for c in range(planes.shape[2]):
            row, col = row0 + r, col0 + c
            layer, at_wall, z = _find(heights, outlines, tops, bottoms, row, col, t_row, t_col, slope)
            if layer < len(heights) - 1:
                planes[len(heights) + layer, r, c] = 1
            if at_wall:
                planes[layer, r, c] = wall
                continue
            y, x = row + z * t_row, col + z * t_col
            light = _sample(reflectances, layer, y, x)
            gloss = _sample(glosses, layer, y, x)
            if gloss > 0:
                off_row = tan_row - _sample(leans_row, layer, y, x)
                off_col = tan_col - _sample(leans_col, layer, y, x)
                glint = lobe_gain * math.exp(-(off_row * off_row + off_col * off_col) / (2 * lobe * lobe))
                light *= 1 - gloss + gloss * glint
            planes[layer, r, c] = light


@njit(cache=True, nogil=True, fastmath=True)
def add_shifted(plane, begins, ends, row, col, weight, total):
    """total += weight x plane from (row, col) on, bilinear between its pixels, which are zero outside of the spans."""
    i, j = int(row), int(col)
    y, x = np.float32(row - i), np.float32(col - j)
    w = np.float32(weight)
    w00, w01, w10, w11 = w * (1 - y) * (1 - x), w * (1 - y) * x, w * y * (1 - x), w * y * x
    n = total.shape[1]
    for r in range(total.shape[0]):
        begin = max(0, min(begins[i + r], begins[i + r + 1]) - 1 - j)
        end = min(n, max(ends[i + r], ends[i + r + 1]) - j)
        if begin >= end:
            continue
        out = total[r, begin:end]
        a, b = plane[i + r, j + begin : j + end], plane[i + r, j + begin + 1 : j + end + 1]
        c, d = plane[i + r + 1, j + begin : j + end], plane[i + r + 1, j + begin + 1 : j + end + 1]
        for k in range(end - begin):
            out[k] += w00 * a[k] + w01 * b[k] + w10 * c[k] + w11 * d[k]


@njit(cache=True, nogil=True)
def _spans(plane):
    """The columns of each row of a plane from the first to behind the last that is not zero."""
    n_rows, n_cols = plane.shape
    begins, ends = np.full(n_rows, n_cols), np.zeros(n_rows, np.int64)
    for r in range(n_rows):
        for c in range(n_cols):
            if plane[r, c] != 0:
                begins[r], ends[r] = min(begins[r], c), c + 1
    return begins, ends


@njit(cache=True, nogil=True)
def add_view(planes, rows, cols, weight, totals):
    """Add a view to every frame: frame k of totals [plane, k, row, col] sees planes from (rows[k], cols[k]) on."""
    for n in range(len(planes)):
        begins, ends = _spans(planes[n])
        if ends.max() > 0:
            for k in range(len(rows)):
                add_shifted(planes[n], begins, ends, rows[k], cols[k], weight, totals[n, k])
