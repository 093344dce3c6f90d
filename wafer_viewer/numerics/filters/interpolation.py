"""Polynomials and cubic splines over grids with unmeasured points."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from wafer_viewer.numerics.jit import Float32s, Float64s, Int, Real, inlined_part, lean_kernel, lean_part

# --------------------------------------------------------------------------------------------------------- local planes


Plane = NDArray[np.float64]


class LocalPlanes(NamedTuple):
    """Planes fitted to the finite pixels of the window around each pixel, all float64 [row, col].

    gradient: steepest slope, height per pixel; residual: root mean square distance from the plane; height: of the plane
    at the pixel, NaN where no pixel is finite.
    """

    gradient: Plane
    residual: Plane
    height: Plane


def local_planes(z: NDArray[np.floating], size: int) -> LocalPlanes:
    """Fit a plane to the finite heights of size x size pixels around each pixel of z [row, col].

    At the border of the map the window is cut off. Where the finite pixels do not determine a plane its gradient is 0.
    """
    valid = np.isfinite(z)
    base = np.mean(z[valid], dtype=np.float64) if valid.any() else 0.0
    heights = np.subtract(z, base, dtype=np.float64)
    found = LocalPlanes(*(np.empty(z.shape) for _ in LocalPlanes._fields))
    _fit_planes(heights, size // 2, base, np.zeros((6, z.shape[1])), found)
    return found


@lean_kernel
def _fit_planes(z: Float64s, reach: Int, base: Real, sums: Float64s, out: tuple[Float64s, ...]) -> None:
    """Fit planes by moments; sums: work space, of the weights, heights and squares of columns, partly times y.

    Coordinates are those from the middle of the map. Moments of a window follow from those of its neighbour.
    """
    n_rows, n_cols = z.shape
    gradient, residual, height = out
    middle_y, middle_x = (n_rows - 1) / 2, (n_cols - 1) / 2
    for row in range(min(reach, n_rows)):
        _add_row(z[row], row - middle_y, 1.0, sums)
    for i in range(n_rows):
        if i + reach < n_rows:
            _add_row(z[i + reach], i + reach - middle_y, 1.0, sums)
        if i > reach:
            _add_row(z[i - reach - 1], i - reach - 1 - middle_y, -1.0, sums)
        w, wy, wyy, s, sy, ss, wx, wxx, wxy, sx = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(-reach, n_cols):
            for col, sign in ((k + reach, 1.0), (k - reach - 1, -1.0)):
                if 0 <= col < n_cols:
                    x, one, by_y, of_z = col - middle_x, sign * sums[0, col], sign * sums[1, col], sign * sums[3, col]
                    w, wy, wyy = w + one, wy + by_y, wyy + sign * sums[2, col]
                    s, sy, ss = s + of_z, sy + sign * sums[4, col], ss + sign * sums[5, col]
                    wx, wxx, wxy, sx = wx + one * x, wxx + one * x * x, wxy + by_y * x, sx + of_z * x
            if k < 0:
                continue
            n = max(w, 0.5)
            mean_y, mean_x, mean_z = wy / n, wx / n, s / n
            yy, xx, xy = wyy / n - mean_y**2, wxx / n - mean_x**2, wxy / n - mean_x * mean_y
            zy, zx, zz = sy / n - mean_z * mean_y, sx / n - mean_z * mean_x, max(ss / n - mean_z**2, 0.0)
            determinant = xx * yy - xy**2
            inverse = 1 / determinant if determinant > _LEAST_DETERMINANT else 0.0
            down, right = inverse * (xx * zy - xy * zx), inverse * (yy * zx - xy * zy)
            gradient[i, k] = math.sqrt(down**2 + right**2)
            residual[i, k] = math.sqrt(max(zz - down * zy - right * zx, 0.0))
            there = base + mean_z + down * (i - middle_y - mean_y) + right * (k - middle_x - mean_x)
            height[i, k] = there if w > 0.5 else np.nan


@lean_part
def _add_row(z: Float64s, y: Real, sign: Real, sums: Float64s) -> None:
    for x in range(z.size):
        is_finite = abs(z[x]) < np.inf
        one, of_z = (sign, sign * z[x]) if is_finite else (0.0, 0.0)
        sums[0, x] += one
        sums[1, x] += one * y
        sums[2, x] += one * y * y
        sums[3, x] += of_z
        sums[4, x] += of_z * y
        sums[5, x] += of_z * z[x] if is_finite else 0.0


_LEAST_DETERMINANT = 1e-3
"""Smallest determinant of the scatter of the finite pixels that determines a plane, px^4; a full 3 x 3 has 4 / 9."""


# -------------------------------------------------------------------------------------------------------- interpolation


Floats = NDArray[np.float64]
TOO_FEW = 1e-10
"""Smallest ratio of the extreme eigenvalues at which the normal equations are considered solvable."""


def polynomial(z: Floats, order: int) -> Floats | None:
    """Return the least-squares polynomial of total degree `order` through z [row, col], at every grid point.

    Unmeasured points (NaN) have no weight. None if the measured points do not determine it.
    """
    valid = np.isfinite(z)
    down, across = (_basis(n, order) for n in z.shape)
    i, j = (np.array(power) for power in zip(*_powers(order), strict=True))
    # Sums over the lattice of products of Legendre polynomials, first along rows, then along columns.
    pairs_down, pairs_across = (_pairs(basis) for basis in (down, across))
    sums = (pairs_down.T @ (valid.astype(np.float64) @ pairs_across)).reshape((order + 1,) * 4)
    normal = sums[i[:, None], i[None, :], j[:, None], j[None, :]]
    wanted = (down.T @ np.where(valid, z, 0.0) @ across)[i, j]
    values, vectors = np.linalg.eigh(normal)
    if values[0] <= TOO_FEW * values[-1]:
        return None
    coefficients = np.zeros((order + 1, order + 1))
    coefficients[i, j] = vectors @ ((vectors.T @ wanted) / values)
    return down @ coefficients @ across.T


def _basis(n: int, order: int) -> Floats:
    """Return the Legendre polynomials up to an order at n points over -1 ... 1, [n, order + 1]."""
    return np.asarray(legvander(np.linspace(-1, 1, n) if n > 1 else np.zeros(1), order), np.float64)


def _powers(order: int) -> list[tuple[int, int]]:
    return [(i, total - i) for total in range(order + 1) for i in range(total + 1)]


def _pairs(basis: Floats) -> Floats:
    """Return the products of all pairs of columns of a basis [n, p], as [n, p * p]."""
    return (basis[:, :, None] * basis[:, None, :]).reshape(len(basis), -1)


def fill_rows(z: Float32s, max_gap: Int, max_step: Real) -> Float32s:
    """Return a copy of z with gaps of NaN up to `max_gap` pixels along each row filled, without extrapolation.

    A gap whose two sides differ by more than `max_step` is a step: it is not filled, and no spline crosses it or a
    longer gap. Each run between these is a separate natural cubic spline, solved by the Thomas algorithm.
    """
    out = np.array(z, np.float32, order="C")
    _fill(out, max_gap, float(max_step), np.empty((3, z.shape[1])))
    return out


def fill_gaps(z: Float32s, max_gap: Int, max_step: Real) -> Float32s:
    """Return a copy of z with its gaps filled along rows and along columns, by the mean where both are available.

    Both start from the measured pixels, so neither direction leaves streaks and no gap is longer than allowed.
    """
    by_row, by_col = fill_rows(z, max_gap, max_step), fill_rows(z.T, max_gap, max_step)
    _average(by_col, by_row)
    return by_row


_TILE_PX = 32
"""Side of the squares in which a map is combined with a transposed one, so that both stay in cache."""


@lean_kernel
def _average(by_col: Float32s, by_row: Float32s) -> None:
    """Average `by_row` with the transposed map `by_col`; where one is NaN, take the other."""
    n_rows, n_cols = by_row.shape
    for top in range(0, n_rows, _TILE_PX):
        for left in range(0, n_cols, _TILE_PX):
            for r in range(top, min(top + _TILE_PX, n_rows)):
                for c in range(left, min(left + _TILE_PX, n_cols)):
                    a, b = by_row[r, c], by_col[c, r]
                    a = a if a == a else b
                    b = b if b == b else a
                    by_row[r, c] = np.float32(0.5) * (a + b)


@lean_kernel
def _fill(z: Float32s, max_gap: Int, max_step: Real, scratch: Float64s) -> None:
    """Fill run by run: from its first measured pixel to the last one before a step or a long gap."""
    knots, bend, factor = scratch[0], scratch[1], scratch[2]
    for r in range(z.shape[0]):
        row, count, last, before = z[r], np.int64(0), np.int64(0), np.float32(0)
        for x in range(row.size):
            here = row[x]
            if here == here:
                if count > 0 and (x - last - 1 > max_gap or abs(here - before) > max_step):
                    _fill_run(row, knots, count, bend, factor)
                    count = np.int64(0)
                knots[count], last, before = x, x, here
                count += 1
        _fill_run(row, knots, count, bend, factor)


@inlined_part
def _fill_run(row: Float32s, knots: Float64s, count: Int, bend: Float64s, factor: Float64s) -> None:
    """Fill a run of which `count` pixels are measured, if it has gaps."""
    if count > 1 and knots[count - 1] - knots[0] > count - 1:
        _spline(row, knots, count, bend, factor)


@lean_part
def _spline(row: Float32s, knots: Float64s, count: Int, bend: Float64s, factor: Float64s) -> None:
    """Solve for the second derivatives at the measured pixels, zero at both ends, then interpolate."""
    last = count - 1
    bend[0], factor[0], bend[last] = 0.0, 0.0, 0.0
    for n in range(1, last):
        x0, x1, x2 = int(knots[n - 1]), int(knots[n]), int(knots[n + 1])
        before, after = knots[n] - knots[n - 1], knots[n + 1] - knots[n]
        rise = (row[x2] - row[x1]) / after - (row[x1] - row[x0]) / before
        pivot = 2.0 * (before + after) - before * factor[n - 1]
        factor[n] = after / pivot
        bend[n] = (6.0 * rise - before * bend[n - 1]) / pivot
    for n in range(last - 1, 0, -1):
        bend[n] -= factor[n] * bend[n + 1]
    for n in range(last):
        a, b = int(knots[n]), int(knots[n + 1])
        wide = float(b - a)
        for x in range(a + 1, b):
            s, t = (b - x) / wide, (x - a) / wide
            curve = (s * s * s - s) * bend[n] + (t * t * t - t) * bend[n + 1]
            row[x] = s * row[a] + t * row[b] + curve * wide * wide / 6.0
