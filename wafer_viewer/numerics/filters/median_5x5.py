"""Exact medians of 5 x 5 pixels without NaN; the outlier test needs no sorting."""

from __future__ import annotations

import numpy as np

from wafer_viewer.numerics.array_types import Bools, Float32s, Int32s, Int64s, Real, Whole
from wafer_viewer.numerics.jit import kernel

REACH_PX = 2


def pad_with_nan(values: Float32s) -> Float32s:
    """Return a copy with a border of NaN of half the window size, because the kernels do not handle borders."""
    return np.pad(values, REACH_PX, constant_values=np.nan)


@kernel
def medians_at(padded: Float32s, rows: Int64s, cols: Int64s) -> Float32s:
    """Return the median of the finite pixels in the 5 x 5 window around each (row, col) of the unpadded map.

    padded: from `pad_with_nan`; NaN for a window without finite pixels.
    """
    out = np.empty(rows.size, np.float32)
    window = np.empty(25, np.float32)
    for n in range(rows.size):
        count = 0
        for r in range(rows[n], rows[n] + 5):
            for c in range(cols[n], cols[n] + 5):
                v = padded[r, c]
                if v == v:
                    count = _insert(window, count, v)
        out[n] = np.float32(0.5) * (window[(count - 1) // 2] + window[count // 2]) if count else np.nan
    return out


@kernel
def median_outliers(padded: Float32s, limit: Real) -> Bools:
    """Return a mask of measured pixels further than `limit` from the median of their 5 x 5 window, without the padding.

    A value is within `limit` of the median if and only if at least half of the window is above value - limit and at
    least half is below value + limit. Counting can be vectorised, sorting cannot. For an even number of values, any
    value between the two middle ones counts as the median.
    """
    n_rows, n_cols = padded.shape[0] - 4, padded.shape[1] - 4
    far = np.zeros((n_rows, n_cols), np.bool_)
    above = np.zeros(n_cols, np.int32)
    below = np.zeros(n_cols, np.int32)
    finite = np.zeros(n_cols, np.int32)
    for r in range(n_rows):
        above[:], below[:], finite[:] = 0, 0, 0
        here = padded[r + 2, 2:]
        for d in range(5):
            for e in range(5):
                _count(here, padded[r + d, e:], limit, above, below, finite)
        _judge(here, above, below, finite, far[r])
    return far


@kernel
def _insert(window: Float32s, count: Whole, v: Real) -> int:
    at = count
    while at > 0 and window[at - 1] > v:
        window[at] = window[at - 1]
        at -= 1
    window[at] = v
    return count + 1


@kernel
def _count(here: Float32s, other: Float32s, limit: Real, above: Int32s, below: Int32s, finite: Int32s) -> None:
    for x in range(above.size):
        v, low, high = other[x], here[x] - limit, here[x] + limit
        above[x] += np.int32(v >= low)
        below[x] += np.int32(v <= high)
        finite[x] += np.int32(v == v)


@kernel
def _judge(here: Float32s, above: Int32s, below: Int32s, finite: Int32s, far: Bools) -> None:
    for x in range(far.size):
        enough = (above[x] + above[x] >= finite[x]) & (below[x] + below[x] >= finite[x])
        far[x] = (here[x] == here[x]) & (not enough)
