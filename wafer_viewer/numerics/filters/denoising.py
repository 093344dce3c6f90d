"""Comparison of a pixel with its neighbours: medians, agreeing pairs, and distances.

A square median rounds corners and cuts thin ridges, whose pixels are a minority in any square. A pixel of a corner or
ridge has similar pixels along at least one of the four lines through it; a spike or a small blob along none.

The mean of two pixels on opposite sides equals the height of a plane between them, whatever its slope, so slopes,
borders and edges of gaps cause no bias. A pair across a step disagrees and does not count.
"""

from __future__ import annotations

import numpy as np

from wafer_viewer.numerics.jit import Bools, Float32s, Int, Int32s, Int64s, Real, kernel, lean_kernel

LINE_REACH_PX = 5
"""Half length of a line: on its 11 pixels, a feature of up to 5 pixels is a minority."""


def line_outliers(padded: Float32s, limit: Real) -> Bools:
    """Return a mask of pixels further than `limit` from the median of each of their four lines; bool [row, col].

    padded: a map with a border of `LINE_REACH_PX` NaN, which is removed. For an even number of measured pixels, any
    value between the two middle ones counts as the median of a line.
    """
    shape = padded.shape[0] - 2 * LINE_REACH_PX, padded.shape[1] - 2 * LINE_REACH_PX
    far = np.zeros(shape, np.bool_)
    _mark_far(padded, np.float32(limit), np.zeros((3, shape[1]), np.int32), far)
    return far


def line_medians_at(padded: Float32s, rows: Int64s, cols: Int64s) -> Float32s:
    """Return the mean of the two middle medians of the four lines through each (row, col) of the unpadded map.

    Only for measured pixels, such as those of `line_outliers`.
    """
    out = np.empty(rows.size, np.float32)
    places = (
        np.ascontiguousarray(rows),
        np.ascontiguousarray(cols),
    )  # a separate specialisation would be compiled for views
    _middle_medians(padded, *places, np.empty((2, 2 * LINE_REACH_PX + 1), np.float32), out)
    return out


@lean_kernel
def _mark_far(padded: Float32s, limit: Real, counts: Int32s, far: Bools) -> None:
    """Mark pixels by counting, without sorting: most of each line is out of reach on one side.

    Comparisons with NaN are false, so unmeasured pixels do not count.
    """
    above, below, lines = counts[0], counts[1], counts[2]
    for r in range(far.shape[0]):
        centre_line = padded[r + LINE_REACH_PX, LINE_REACH_PX:]
        lines[:] = 0
        for line in range(4):
            down, right = (0, 1) if line == 0 else (1, line - 2)
            above[:] = 0
            below[:] = 0
            for s in range(-LINE_REACH_PX, LINE_REACH_PX + 1):
                other = padded[r + LINE_REACH_PX + s * down, LINE_REACH_PX + s * right :]
                for x in range(above.size):
                    v, low, high = other[x], centre_line[x] - limit, centre_line[x] + limit
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
        row, col = int(rows[n]) + LINE_REACH_PX, int(cols[n]) + LINE_REACH_PX
        for line in range(4):
            down, right = (0, 1) if line == 0 else (1, line - 2)
            count = np.int64(0)
            for s in range(-LINE_REACH_PX, LINE_REACH_PX + 1):
                v = padded[row + s * down, col + s * right]
                if v == v:
                    count = insert_sorted(line_of, count, v)
            insert_sorted(medians, line, np.float32(0.5) * (line_of[(count - 1) // 2] + line_of[count // 2]))
        out[n] = np.float32(0.5) * (medians[1] + medians[2])


@lean_kernel
def insert_sorted(values: Float32s, count: Int, v: Real) -> int:
    """Insert v into the first `count` values, which ascend; return the new count."""
    position = count
    while position > 0 and values[position - 1] > v:
        values[position] = values[position - 1]
        position -= 1
    values[position] = v
    return count + 1


MEDIAN_REACH_PX = 2
"""Half width of the window of the median, in pixels."""


def pad_with_nan(values: Float32s) -> Float32s:
    """Return a copy with a border of NaN of half the window size, because the kernels do not handle borders."""
    return np.pad(values, MEDIAN_REACH_PX, constant_values=np.nan)


@kernel
def medians_at(padded: Float32s, rows: Int64s, cols: Int64s) -> Float32s:
    """Return the median of the finite pixels in the 5 x 5 window around each (row, col) of the unpadded map.

    padded: from `pad_with_nan`; NaN for a window without finite pixels.
    """
    out = np.empty(rows.size, np.float32)
    window = np.empty((2 * MEDIAN_REACH_PX + 1) ** 2, np.float32)
    for n in range(rows.size):
        count = 0
        for r in range(rows[n], rows[n] + 2 * MEDIAN_REACH_PX + 1):
            for c in range(cols[n], cols[n] + 2 * MEDIAN_REACH_PX + 1):
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
    n_rows, n_cols = padded.shape[0] - 2 * MEDIAN_REACH_PX, padded.shape[1] - 2 * MEDIAN_REACH_PX
    far = np.zeros((n_rows, n_cols), np.bool_)
    above = np.zeros(n_cols, np.int32)
    below = np.zeros(n_cols, np.int32)
    finite = np.zeros(n_cols, np.int32)
    for r in range(n_rows):
        above[:], below[:], finite[:] = 0, 0, 0
        centre_line = padded[r + MEDIAN_REACH_PX, MEDIAN_REACH_PX:]
        for d in range(2 * MEDIAN_REACH_PX + 1):
            for e in range(2 * MEDIAN_REACH_PX + 1):
                _count(centre_line, padded[r + d, e:], limit, above, below, finite)
        _judge(centre_line, above, below, finite, far[r])
    return far


@kernel
def _insert(window: Float32s, count: Int, v: Real) -> int:
    position = count
    while position > 0 and window[position - 1] > v:
        window[position] = window[position - 1]
        position -= 1
    window[position] = v
    return count + 1


@kernel
def _count(centre_line: Float32s, other: Float32s, limit: Real, above: Int32s, below: Int32s, finite: Int32s) -> None:
    for x in range(above.size):
        v, low, high = other[x], centre_line[x] - limit, centre_line[x] + limit
        above[x] += np.int32(v >= low)
        below[x] += np.int32(v <= high)
        finite[x] += np.int32(v == v)


@kernel
def _judge(centre_line: Float32s, above: Int32s, below: Int32s, finite: Int32s, far: Bools) -> None:
    for x in range(far.size):
        enough = (above[x] + above[x] >= finite[x]) & (below[x] + below[x] >= finite[x])
        far[x] = (centre_line[x] == centre_line[x]) & (not enough)


PAIR_REACH_PX = 4
"""Largest distance of a pair from its pixel along rows and columns, in pixels."""
_STRIDE_PX = 2
"""Neighbouring pixels share most of their focus window, so their errors are correlated; every second pixel suffices."""


def pair_mean(z: Float32s, limit: Real) -> Float32s:
    """Average each pixel with the pairs within 4 pixels whose mean differs by at most `limit`; NaN stays NaN."""
    out = np.empty_like(z)
    padded = np.pad(z, PAIR_REACH_PX, constant_values=np.nan)
    _average(padded, np.float32(limit), np.empty((2, z.shape[1]), np.float32), out)
    return out


@lean_kernel
def _average(padded: Float32s, limit: Real, scratch: Float32s, out: Float32s) -> None:
    """Average with the pixel itself at half weight, because the mean of a pair has half the variance of a pixel."""
    total, count = scratch[0], scratch[1]
    for r in range(out.shape[0]):
        centre_line = padded[r + PAIR_REACH_PX, PAIR_REACH_PX:]
        total[:] = 0.0
        count[:] = 0.5
        for down in range(0, PAIR_REACH_PX + 1, _STRIDE_PX):
            for right in range(-PAIR_REACH_PX, PAIR_REACH_PX + 1, _STRIDE_PX):
                if down > 0 or right > 0:
                    ahead = padded[r + PAIR_REACH_PX + down, PAIR_REACH_PX + right :]
                    behind = padded[r + PAIR_REACH_PX - down, PAIR_REACH_PX - right :]
                    for x in range(total.size):
                        off = np.float32(0.5) * (ahead[x] + behind[x]) - centre_line[x]
                        agrees = abs(off) <= limit
                        total[x] += off if agrees else np.float32(0.0)
                        count[x] += np.float32(agrees)
        for x in range(total.size):
            out[r, x] = centre_line[x] + total[x] / count[x]


NEIGHBOUR_REACH_PX = 3
"""Half width of the window of the nearest neighbours, in pixels."""


def mean_distances(padded: Float32s, rows: Int64s, cols: Int64s, neighbours: Int) -> Float32s:
    """Return the mean |dz| from each (row, col) to the `neighbours` nearest measured pixels of its 7 x 7 window.

    padded: a map with a border of 3 NaN; inf if fewer than half as many are measured.
    """
    out = np.empty(rows.size, np.float32)
    places = (
        np.ascontiguousarray(rows),
        np.ascontiguousarray(cols),
    )  # a separate specialisation would be compiled for views
    _mean_distances(padded, *places, np.empty(neighbours, np.float32), out)
    return out


def near_counts(padded: Float32s, limit: Real) -> Int32s:
    """Return the number of other pixels within `limit` of each pixel in its 7 x 7 window, unpadded; -1 for NaN."""
    out = np.full((padded.shape[0] - 2 * NEIGHBOUR_REACH_PX, padded.shape[1] - 2 * NEIGHBOUR_REACH_PX), -1, np.int32)
    _count_near(padded, np.float32(limit), out)
    return out


@lean_kernel
def _count_near(padded: Float32s, limit: Real, out: Int32s) -> None:
    for r in range(out.shape[0]):
        near, centre_line = out[r], padded[r + NEIGHBOUR_REACH_PX, NEIGHBOUR_REACH_PX:]
        for down in range(2 * NEIGHBOUR_REACH_PX + 1):
            for right in range(2 * NEIGHBOUR_REACH_PX + 1):
                other = padded[r + down, right:]
                for x in range(near.size):
                    near[x] += np.int32(abs(other[x] - centre_line[x]) <= limit)


@lean_kernel
def _mean_distances(padded: Float32s, rows: Int64s, cols: Int64s, nearest: Float32s, out: Float32s) -> None:
    """Insertion sort into `nearest`; the furthest value is dropped when it is full."""
    for n in range(rows.size):
        row, col, count = int(rows[n]), int(cols[n]), 0
        z = padded[row + NEIGHBOUR_REACH_PX, col + NEIGHBOUR_REACH_PX]
        for k in range((2 * NEIGHBOUR_REACH_PX + 1) ** 2):
            v = abs(padded[row + k // (2 * NEIGHBOUR_REACH_PX + 1), col + k % (2 * NEIGHBOUR_REACH_PX + 1)] - z)
            if (
                v == v
                and k != 2 * NEIGHBOUR_REACH_PX * (NEIGHBOUR_REACH_PX + 1)
                and (count < nearest.size or v < nearest[count - 1])
            ):
                count = min(count + 1, nearest.size)
                position = count - 1
                while position > 0 and nearest[position - 1] > v:
                    nearest[position] = nearest[position - 1]
                    position -= 1
                nearest[position] = v
        total = np.float32(0.0)
        for k in range(count):
            total += nearest[k]
        out[n] = total / np.float32(count) if 2 * count >= nearest.size else np.inf
