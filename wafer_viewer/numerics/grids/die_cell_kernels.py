"""Kernels for many similar cells of a surface: affine resampling, median and spread, shifts.

NaN is unmeasured throughout.
"""

from __future__ import annotations

import numpy as np

from wafer_viewer.numerics.jit import Float32s, Float64s, Real, kernel
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA

_LEAST_KNOWN_WEIGHT = np.float32(0.75)
"""Smallest bilinear weight of the known pixels around a position, for a value there."""


@kernel
def fill_single_pixels(plane: Float32s) -> Float32s:
    """Return a copy with single unknown pixels replaced by the mean of the two most similar opposite neighbours.

    This interpolates along an edge, never across it.
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
def subtract_products(plane: Float32s, by_row: Float64s, by_col: Float64s, out: Float32s) -> None:
    """Set out[r, c] = plane[r, c] - sum over k of by_row[k, r] * by_col[k, c]."""
    line = np.empty(plane.shape[1])
    for r in range(plane.shape[0]):
        line[:] = 0
        for k in range(by_row.shape[0]):
            weight, terms = by_row[k, r], by_col[k]
            for c in range(line.size):
                line[c] += weight * terms[c]
        for c in range(line.size):
            out[r, c] = plane[r, c] - line[c]


@kernel
def read_affine(plane: Float32s, complete: Float32s, affine: Float64s, out: Float32s) -> None:
    """Set out[i, j] to plane at row a[0] + a[1] i + a[2] j, column a[3] + a[4] i + a[5] j, with a = affine.

    NaN if the nearest pixel is unknown. complete: the plane of `fill_single_pixels`, in which single unknown pixels do
    not spread. Bicubic (Catmull-Rom) if all 16 pixels around a position are known, else bilinear of the known ones of
    the nearest four, NaN if the unknown ones have more than a quarter of the weight.
    """
    n_rows, n_cols = plane.shape
    steps = np.arange(out.shape[1]).astype(np.float32)
    for i in range(out.shape[0]):
        j = 0
        while j < out.shape[1]:
            r, c = affine[0] + affine[1] * i + affine[2] * j, affine[3] + affine[4] * i + affine[5] * j
            row, col = int(np.floor(r)), int(np.floor(c))
            n = 1
            if 0 < row < n_rows - 2 and 0 < col < n_cols - 2:
                n = min(out.shape[1] - j, n_cols - 2 - col, _steps_within(r - row, affine[2]))
                n = min(n, _steps_within(c - col, affine[5] - 1))
                offsets = np.float32(r - row), np.float32(affine[2]), np.float32(c - col), np.float32(affine[5] - 1)
                _bicubic_run(plane, complete, row, col, offsets, steps[:n], out[i, j:])
            else:
                out[i, j] = np.nan
            for k in range(j, j + n):
                if out[i, k] != out[i, k]:
                    out[i, k] = _bilinear(plane, complete, affine, i, k)
            j += n


@kernel
def _steps_within(offset: Real, step: Real) -> int:
    """Return the number of steps from a position in 0 ... 1 that start before its end; at least one."""
    if step == 0:
        return 2**30
    return max(1, int(min(2.0**30, np.ceil((1 - offset) / step) if step > 0 else np.floor(offset / -step) + 1)))


@kernel
def _bicubic_run(
    plane: Float32s,
    complete: Float32s,
    row: int,
    col: int,
    offsets: tuple[Real, Real, Real, Real],
    steps: Float32s,
    out: Float32s,
) -> None:
    """Interpolate successive positions along a row of pixels in a loop without branches, which can be vectorised.

    row, col: pixel above and left of the first position; offsets: vertical offset of the first position and its
    increment, then the same horizontally.
    """
    half, one, two = np.float32(0.5), np.float32(1), np.float32(2)
    three, four, five = np.float32(3), np.float32(4), np.float32(5)
    upper, lower = plane[row, col:], plane[row + 1, col:]
    p, q, s, t = (
        complete[row - 1, col - 1 :],
        complete[row, col - 1 :],
        complete[row + 1, col - 1 :],
        complete[row + 2, col - 1 :],
    )
    for k in range(steps.size):
        y, x = offsets[0] + offsets[1] * steps[k], offsets[2] + offsets[3] * steps[k]
        a, d = half * x * (x * (two - x) - one), half * x * x * (x - one)
        b, c = one + half * x * x * (three * x - five), half * x * (one + x * (four - three * x))
        e, h = half * y * (y * (two - y) - one), half * y * y * (y - one)
        f, g = one + half * y * y * (three * y - five), half * y * (one + y * (four - three * y))
        value = e * (a * p[k] + b * p[k + 1] + c * p[k + 2] + d * p[k + 3])
        value += f * (a * q[k] + b * q[k + 1] + c * q[k + 2] + d * q[k + 3])
        value += g * (a * s[k] + b * s[k + 1] + c * s[k + 2] + d * s[k + 3])
        value += h * (a * t[k] + b * t[k + 1] + c * t[k + 2] + d * t[k + 3])
        left, right = (lower[k], lower[k + 1]) if y >= half else (upper[k], upper[k + 1])
        nearest = right if x >= half else left
        out[k] = value if nearest == nearest else nearest


@kernel
def _bilinear(plane: Float32s, complete: Float32s, affine: Float64s, i: int, j: int) -> Real:
    n_rows, n_cols = plane.shape
    r, c = affine[0] + affine[1] * i + affine[2] * j, affine[3] + affine[4] * i + affine[5] * j
    row, col = int(np.floor(r)), int(np.floor(c))
    if row < 0 or col < 0 or row >= n_rows or col >= n_cols:
        return np.float32(np.nan)
    nearest = plane[min(n_rows - 1, int(r + 0.5)), min(n_cols - 1, int(c + 0.5))]
    y, x = np.float32(r - row), np.float32(c - col)
    total, weight = np.float32(0), np.float32(0)
    for down in range(2):
        for right in range(2):
            part = (y if down else 1 - y) * (x if right else 1 - x)
            if part > 0 and row + down < n_rows and col + right < n_cols:
                value = complete[row + down, col + right]
                if value == value:
                    total += part * value
                    weight += part
    return total / weight if nearest == nearest and weight >= _LEAST_KNOWN_WEIGHT else np.float32(np.nan)


@kernel
def median_and_spread(stack: Float32s, least: int, middle: Float32s, spread: Float32s) -> None:
    """Compute median and robust standard deviation (1.4826 MAD) over the first axis of stack [n, row, col].

    NaN if fewer than `least` are known.
    """
    n = stack.shape[0]
    values = np.empty(n, np.float32)
    for r in range(stack.shape[1]):
        for c in range(stack.shape[2]):
            n_valid = 0
            for k in range(n):
                v = stack[k, r, c]
                if v == v:
                    _insert(values, n_valid, v)
                    n_valid += 1
            middle[r, c] = spread[r, c] = np.nan
            if n_valid >= least and n_valid > 0:
                m = np.float32(0.5) * (values[(n_valid - 1) // 2] + values[n_valid // 2])
                _replace_by_deviations(values, n_valid, m)
                middle[r, c] = m
                spread[r, c] = np.float32(MAD_TO_SIGMA * 0.5) * (values[(n_valid - 1) // 2] + values[n_valid // 2])


@kernel
def _insert(values: Float32s, n_valid: int, v: Real) -> None:
    position = n_valid
    while position > 0 and values[position - 1] > v:
        values[position] = values[position - 1]
        position -= 1
    values[position] = v


@kernel
def _replace_by_deviations(values: Float32s, n_valid: int, middle: Real) -> None:
    """Replace the first values by their sorted distances from the middle."""
    for k in range(n_valid):
        _insert(values, k, abs(values[k] - middle))


@kernel
def shift_sums(shifted: Float32s, typical_one: Float32s, offset: Real, limit: Real) -> Float64s:
    """Return the normal equations of here - typical = offset + down * shift[0] + right * shift[1] as [3, 4].

    The right side is the last column. down, right: slopes of `typical_one`; differences further than `limit` from the
    offset are ignored.
    """
    n, d, r, z, dd, dr, rr, dz, rz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(1, shifted.shape[0] - 1):
        for j in range(1, shifted.shape[1] - 1):
            left = shifted[i, j] - typical_one[i, j]
            if abs(left - offset) <= limit:
                down = np.float32(0.5) * (typical_one[i + 1, j] - typical_one[i - 1, j])
                right = np.float32(0.5) * (typical_one[i, j + 1] - typical_one[i, j - 1])
                if down == down and right == right:
                    n, d, r, z = n + 1, d + down, r + right, z + left
                    dd, dr, rr = dd + down * down, dr + down * right, rr + right * right
                    dz, rz = dz + down * left, rz + right * left
    return np.array([[n, d, r, z], [d, dd, dr, dz], [r, dr, rr, rz]])
