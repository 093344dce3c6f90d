"""Natural cubic splines along the rows of a map, through what is measured, into the gaps between."""

from __future__ import annotations

import numpy as np

from wafer_viewer.numerics.arrays import Float32s, Float64s, Int64s, Real, Whole
from wafer_viewer.numerics.jit import kernel


@kernel
def fill_rows(z: Float32s, max_gap: Whole, max_step: Real) -> None:
    """Fill gaps of NaN up to `max_gap` pixels along each row of z, in place.

    A gap whose two sides differ by more than `max_step` is a step: it stays, and no spline runs across it, nor across
    a longer gap. Each run between those is a natural cubic spline of its own, solved by the Thomas algorithm.
    """
    knots = np.empty(z.shape[1], np.int64)
    bend = np.empty(z.shape[1], np.float64)
    factor = np.empty(z.shape[1], np.float64)
    for r in range(z.shape[0]):
        row = z[r]
        count = _knots(row, knots)
        first = 0
        for n in range(1, count + 1):
            if n == count or _parted(row, knots[n - 1], knots[n], max_gap, max_step):
                if _has_gap(knots, first, n):
                    _bends(row, knots[first:n], bend, factor)
                    _fill_run(row, knots[first:n], bend)
                first = n


@kernel
def _knots(row: Float32s, knots: Int64s) -> int:
    """Write down where the row is measured."""
    count = 0
    for x in range(row.size):
        knots[count] = x
        if row[x] == row[x]:
            count += 1
    return count


@kernel
def _parted(row: Float32s, a: Whole, b: Whole, max_gap: Whole, max_step: Real) -> np.bool_ | bool:
    return b - a - 1 > max_gap or abs(row[b] - row[a]) > max_step


@kernel
def _has_gap(knots: Int64s, first: Whole, stop: Whole) -> bool:
    return knots[stop - 1] - knots[first] > stop - 1 - first


@kernel
def _bends(row: Float32s, knots: Int64s, bend: Float64s, factor: Float64s) -> None:
    """Second derivatives at the knots; zero at both ends."""
    last = knots.size - 1
    bend[0], factor[0] = 0.0, 0.0
    for n in range(1, last):
        before, after = knots[n] - knots[n - 1], knots[n + 1] - knots[n]
        rise = (row[knots[n + 1]] - row[knots[n]]) / after - (row[knots[n]] - row[knots[n - 1]]) / before
        pivot = 2.0 * (before + after) - before * factor[n - 1]
        factor[n] = after / pivot
        bend[n] = (6.0 * rise - before * bend[n - 1]) / pivot
    bend[last] = 0.0
    for n in range(last - 1, 0, -1):
        bend[n] -= factor[n] * bend[n + 1]


@kernel
def _fill_run(row: Float32s, knots: Int64s, bend: Float64s) -> None:
    for n in range(knots.size - 1):
        a, b = knots[n], knots[n + 1]
        wide = float(b - a)
        for x in range(a + 1, b):
            s, t = (b - x) / wide, (x - a) / wide
            curve = (s * s * s - s) * bend[n] + (t * t * t - t) * bend[n + 1]
            row[x] = s * row[a] + t * row[b] + curve * wide * wide / 6.0
