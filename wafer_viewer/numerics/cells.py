"""Kernels for many alike pieces of a surface: read on a lattice of their own, their typical values, their shifts.

NaN is unmeasured throughout.
"""

from __future__ import annotations

import numpy as np

from wafer_viewer.numerics.arrays import Float32s, Float64s, Real
from wafer_viewer.numerics.jit import kernel

MAD_TO_SIGMA = 1.4826


@kernel
def bridged(plane: Float32s) -> Float32s:
    """A copy in which single unknown pixels are the mean of the two opposite neighbours that differ least.

    That is along an edge, never across it.
    """
    out = plane.copy()
    for r in range(1, plane.shape[0] - 1):
        for c in range(1, plane.shape[1] - 1):
            if plane[r, c] == plane[r, c]:
                continue
            least = np.float32(np.inf)
            for k in range(4):
                down, right = (0, 1) if k == 0 else (1, k - 2)
                one, other = plane[r - down, c - right], plane[r + down, c + right]
                if abs(one - other) < least:
                    least = abs(one - other)
                    out[r, c] = np.float32(0.5) * (one + other)
    return out


@kernel
def read_affine(plane: Float32s, whole: Float32s, way: Float64s, out: Float32s) -> None:
    """out[i, j] = plane at row way[0] + way[1] i + way[2] j, column way[3] + way[4] i + way[5] j.

    NaN where the nearest pixel is unknown. whole: the plane `bridged`, so that a lost pixel takes no others with it.
    Bicubic (Catmull and Rom) where all 16 pixels round a place are known, else bilinear of those of the four next to it
    that are, NaN where unknown ones would weigh more than a quarter.
    """
    n_rows, n_cols = plane.shape
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            r, c = way[0] + way[1] * i + way[2] * j, way[3] + way[4] * i + way[5] * j
            out[i, j] = np.nan
            row, col = int(np.floor(r)), int(np.floor(c))
            if row < 0 or col < 0 or row >= n_rows or col >= n_cols:
                continue
            y, x = np.float32(r - row), np.float32(c - col)
            nearest = plane[min(n_rows - 1, int(r + 0.5)), min(n_cols - 1, int(c + 0.5))]
            if nearest != nearest:
                continue
            if 0 < row < n_rows - 2 and 0 < col < n_cols - 2:
                value = _bicubic(whole, row, col, y, x)
                if value == value:
                    out[i, j] = value
                    continue
            out[i, j] = _bilinear(whole, row, col, y, x)


@kernel
def _bicubic(plane: Float32s, row: int, col: int, y: Real, x: Real) -> Real:
    half = np.float32(0.5)
    a, d = half * x * (-1 + x * (2 - x)), half * x * x * (x - 1)
    b, c = 1 + half * x * x * (3 * x - 5), half * x * (1 + x * (4 - 3 * x))
    e, h = half * y * (-1 + y * (2 - y)), half * y * y * (y - 1)
    f, g = 1 + half * y * y * (3 * y - 5), half * y * (1 + y * (4 - 3 * y))
    p, q = plane[row - 1], plane[row]
    s, t = plane[row + 1], plane[row + 2]
    k = col
    above = e * (a * p[k - 1] + b * p[k] + c * p[k + 1] + d * p[k + 2])
    upper = f * (a * q[k - 1] + b * q[k] + c * q[k + 1] + d * q[k + 2])
    lower = g * (a * s[k - 1] + b * s[k] + c * s[k + 1] + d * s[k + 2])
    below = h * (a * t[k - 1] + b * t[k] + c * t[k + 1] + d * t[k + 2])
    return above + upper + lower + below


@kernel
def _bilinear(plane: Float32s, row: int, col: int, y: Real, x: Real) -> Real:
    total, weight = np.float32(0), np.float32(0)
    for down in range(2):
        for right in range(2):
            part = (y if down else 1 - y) * (x if right else 1 - x)
            if part > 0 and row + down < plane.shape[0] and col + right < plane.shape[1]:
                value = plane[row + down, col + right]
                if value == value:
                    total += part * value
                    weight += part
    return total / weight if weight >= np.float32(0.75) else np.float32(np.nan)


@kernel
def typical(stack: Float32s, least: int, middle: Float32s, spread: Float32s) -> None:
    """Median and robust standard deviation (1.4826 MAD) over the first axis of stack [n, row, col].

    NaN where fewer than `least` are known.
    """
    n = stack.shape[0]
    values = np.empty(n, np.float32)
    for r in range(stack.shape[1]):
        for c in range(stack.shape[2]):
            known = 0
            for k in range(n):
                v = stack[k, r, c]
                if v == v:
                    _insert(values, known, v)
                    known += 1
            middle[r, c] = spread[r, c] = np.nan
            if known >= least and known > 0:
                m = np.float32(0.5) * (values[(known - 1) // 2] + values[known // 2])
                _far_from(values, known, m)
                middle[r, c] = m
                spread[r, c] = np.float32(MAD_TO_SIGMA * 0.5) * (values[(known - 1) // 2] + values[known // 2])


@kernel
def _insert(values: Float32s, known: int, v: Real) -> None:
    at = known
    while at > 0 and values[at - 1] > v:
        values[at] = values[at - 1]
        at -= 1
    values[at] = v


@kernel
def _far_from(values: Float32s, known: int, middle: Real) -> None:
    """The first values become their distances from the middle, in order."""
    for k in range(known):
        _insert(values, k, abs(values[k] - middle))


@kernel
def shift_sums(here: Float32s, typical_one: Float32s, offset: Real, limit: Real) -> Float64s:
    """Normal equations of here - typical = offset + down * shift[0] + right * shift[1], [3, 4]: the right side is last.

    down, right: slopes of the typical one; differences beyond `limit` of the offset count nothing.
    """
    sums = np.zeros((3, 4))
    line = np.empty(4)
    for r in range(1, here.shape[0] - 1):
        for c in range(1, here.shape[1] - 1):
            left = here[r, c] - typical_one[r, c]
            if abs(left - offset) <= limit:
                line[0], line[3] = 1.0, left
                line[1] = 0.5 * (typical_one[r + 1, c] - typical_one[r - 1, c])
                line[2] = 0.5 * (typical_one[r, c + 1] - typical_one[r, c - 1])
                if line[1] == line[1] and line[2] == line[2]:
                    for i in range(3):
                        for j in range(4):
                            sums[i, j] += line[i] * line[j]
    return sums
