"""Comparison of a pixel with its neighbours: medians, agreeing pairs, and distances.

A square median rounds corners and cuts thin ridges, whose pixels are a minority in any square. A pixel of a corner or
ridge has similar pixels along at least one of the four lines through it; a spike or a small blob along none.

The mean of two pixels on opposite sides equals the height of a plane between them, whatever its slope, so slopes,
borders and edges of gaps cause no bias. A pair across a step disagrees and does not count.
"""

from __future__ import annotations

import numpy as np

from wafer_viewer.numerics.jit import (
    Bools,
    Float32s,
    Float64s,
    Int,
    Int32s,
    Int64s,
    Real,
    kernel,
    lean_kernel,
    lean_part,
)

LINE_REACH_PX = 5
"""Half length of a line: on its 11 pixels, a feature of up to 5 pixels is a minority."""


CLOUD_REACH_PX = 8
"""Distance along rows and columns up to which neighbours in a point cloud are looked for on its lattice."""
_BATCH_PX = 64
"""Pixels of a row that are tested together, so that a test that decides about all of them is the last one."""


def line_outliers(padded: Float32s, limit: Real, near: Bools | None = None) -> Bools:
    """Return a mask of pixels further than `limit` from the median of each of their four lines; bool [row, col].

    padded: a map with a border of `LINE_REACH_PX` NaN, which is removed. near: from `beside_lines`, the batches that
    are tested; all if omitted. For an even number of measured pixels, any value between the two middle ones counts as
    the median of a line.
    """
    shape = padded.shape[0] - 2 * LINE_REACH_PX, padded.shape[1] - 2 * LINE_REACH_PX
    far = np.zeros(shape, np.bool_)
    tested = np.ones((shape[0], _batches(shape[1])), np.bool_) if near is None else near
    _mark_far(padded, np.float32(limit), tested, np.zeros((4, _BATCH_PX), np.int32), far)
    return far


def beside_lines(rows: Int64s, cols: Int64s, shape: tuple[int, ...]) -> Bools:
    """Return the batches of a map of `shape` that hold a pixel on a line through any (row, col); bool [row, batch]."""
    n_rows, n_batches = shape[0], _batches(shape[1])
    beside = np.zeros((n_rows + 2 * LINE_REACH_PX, n_batches), np.bool_)
    for reach in (-LINE_REACH_PX, LINE_REACH_PX):
        beside[rows + LINE_REACH_PX, (cols + reach).clip(0, shape[1] - 1) // _BATCH_PX] = True
    near = np.zeros((n_rows, n_batches), np.bool_)
    for down in range(2 * LINE_REACH_PX + 1):
        near |= beside[down : down + n_rows]
    return near


def _batches(cols: int) -> int:
    return -(-cols // _BATCH_PX)


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
def _mark_far(padded: Float32s, limit: Real, tested: Bools, counts: Int32s, far: Bools) -> None:
    """Mark pixels by counting, without sorting: most of each line is out of reach on one side.

    Comparisons with NaN are false, so unmeasured pixels do not count. A batch without a pixel that is far along all
    lines so far is done. The nearest pixels of a line are counted first: where most of it is within reach, the rest
    changes nothing.
    """
    above, below, lines, within = counts[0], counts[1], counts[2], counts[3]
    most_of_line = np.int32(LINE_REACH_PX + 1)
    for r in range(far.shape[0]):
        for batch in range(tested.shape[1]):
            if not tested[r, batch]:
                continue
            first = batch * _BATCH_PX
            n = min(_BATCH_PX, far.shape[1] - first)
            centre_line = padded[r + LINE_REACH_PX, LINE_REACH_PX + first :]
            lines[:] = 0
            for line in range(4):
                down, right = (0, 1) if line == 0 else (1, line - 2)
                above[:] = 0
                below[:] = 0
                within[:] = 0
                least = np.int32(0)
                for turn in range(2 * LINE_REACH_PX + 1):
                    s = (turn + 1) // 2 * (1 - 2 * (turn % 2))
                    other = padded[r + LINE_REACH_PX + s * down, LINE_REACH_PX + first + s * right :]
                    for x in range(n):
                        v, low, high = other[x], centre_line[x] - limit, centre_line[x] + limit
                        above[x] += np.int32(v > high) - np.int32(v <= high)
                        below[x] += np.int32(v < low) - np.int32(v >= low)
                        within[x] += np.int32((v >= low) & (v <= high))
                    if turn >= LINE_REACH_PX:
                        least = most_of_line
                        for x in range(n):
                            least = min(least, within[x] if centre_line[x] == centre_line[x] else most_of_line)
                        if least >= most_of_line:
                            break
                if least >= most_of_line:
                    break
                most = np.int32(0)
                for x in range(n):
                    lines[x] += np.int32((above[x] > 0) | (below[x] > 0))
                    most = max(most, lines[x])
                if most <= line:
                    break
            for x in range(n):
                far[r, first + x] = lines[x] == 4


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


@lean_part
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
    z = np.ascontiguousarray(z)
    out = np.empty_like(z)
    lines = np.full((2 * PAIR_REACH_PX + 1, z.shape[1] + 2 * PAIR_REACH_PX), np.nan, np.float32)
    _average(z, np.float32(limit), lines, out)
    return out


@lean_kernel
def _average(z_um: Float32s, limit: Real, lines: Float32s, out: Float32s) -> None:
    """Average with the pixel itself at half weight, because the mean of a pair has half the variance of a pixel.

    All pairs of a pixel are taken together, so that their sums stay in registers. lines: the rows around one, with a
    border of NaN.
    """
    reach, half, zero = PAIR_REACH_PX, np.float32(0.5), np.float32(0)
    n_lines, n_rows = lines.shape[0], out.shape[0]
    for r in range(-reach, n_rows):
        line = lines[(r + 2 * reach) % n_lines, reach : reach + out.shape[1]]
        for x in range(out.shape[1]):
            line[x] = z_um[r + reach, x] if r + reach < n_rows else np.float32(np.nan)
        if r < 0:
            continue
        above_2, above, middle, below, below_2 = (
            lines[r % n_lines],
            lines[(r + reach // 2) % n_lines],
            lines[(r + reach) % n_lines],
            lines[(r + 3 * reach // 2) % n_lines],
            lines[(r + 2 * reach) % n_lines],
        )
        for x in range(out.shape[1]):
            z, total, count = middle[x + reach], zero, half
            for right in range(_STRIDE_PX, PAIR_REACH_PX + 1, _STRIDE_PX):
                off = half * (middle[x + reach + right] + middle[x + reach - right]) - z
                agrees = abs(off) <= limit
                total += off if agrees else zero
                count += np.float32(agrees)
            for right in range(-PAIR_REACH_PX, PAIR_REACH_PX + 1, _STRIDE_PX):
                off = half * (below[x + reach + right] + above[x + reach - right]) - z
                agrees = abs(off) <= limit
                total += off if agrees else zero
                count += np.float32(agrees)
            for right in range(-PAIR_REACH_PX, PAIR_REACH_PX + 1, _STRIDE_PX):
                off = half * (below_2[x + reach + right] + above_2[x + reach - right]) - z
                agrees = abs(off) <= limit
                total += off if agrees else zero
                count += np.float32(agrees)
            out[r, x] = z + total / count


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


def few_near(padded: Float32s, limit: Real, enough: Int) -> Bools:
    """Return a mask of pixels with fewer than `enough` others within `limit` in their 7 x 7 window; bool [row, col].

    padded: a map with a border of 3 NaN, which is removed. Pixels that are NaN may be marked or not.
    """
    shape = padded.shape[0] - 2 * NEIGHBOUR_REACH_PX, padded.shape[1] - 2 * NEIGHBOUR_REACH_PX
    few = np.zeros(shape, np.bool_)
    _mark_lonely(padded, np.float32(limit), np.int32(enough), np.empty(_BATCH_PX, np.int32), few)
    return few


@lean_kernel
def _mark_lonely(padded: Float32s, limit: Real, enough: Int, near: Int32s, few: Bools) -> None:
    """Count row by row of the window, the nearest first, until all pixels of a batch have enough neighbours."""
    reach = NEIGHBOUR_REACH_PX
    for r in range(few.shape[0]):
        for first in range(0, few.shape[1], _BATCH_PX):
            n = min(_BATCH_PX, few.shape[1] - first)
            centre_line = padded[r + reach, reach + first :]
            near[:] = -1
            for turn in range(2 * reach + 1):
                down = reach + (turn + 1) // 2 * (1 - 2 * (turn % 2))
                for right in range(2 * reach + 1):
                    other = padded[r + down, first + right :]
                    for x in range(n):
                        near[x] += np.int32(abs(other[x] - centre_line[x]) <= limit)
                least = np.int32(enough)
                for x in range(n):
                    least = min(least, near[x] if centre_line[x] == centre_line[x] else np.int32(enough))
                if least >= enough:
                    break
            for x in range(n):
                few[r, first + x] = near[x] < enough


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


def distances_in_cloud(z_um: Float32s, pixel_um: Real, neighbours: Int) -> Float64s:
    """Return the mean distance in space from each pixel to its nearest measured others, um, float64 [row, col].

    NaN where it is not measured, and where one of the nearest may lie further than `CLOUD_REACH_PX` pixels away.
    """
    out = np.full(z_um.shape, np.nan)
    _cloud_distances(np.ascontiguousarray(z_um), np.float64(pixel_um) ** 2, np.empty(neighbours, np.float64), out)
    return out


@lean_kernel
def _cloud_distances(z_um: Float32s, pixel_um2: Real, nearest: Float64s, out: Float64s) -> None:
    """Go outwards ring by ring until the next one is further away than all that were found: those are the nearest."""
    rows, cols = z_um.shape
    for row in range(rows):
        for col in range(cols):
            z, count = np.float64(z_um[row, col]), 0
            if z != z:
                continue
            for reach in range(1, CLOUD_REACH_PX + 1):
                for down in range(max(-reach, -row), min(reach, rows - 1 - row) + 1):
                    stride = 1 if abs(down) == reach else 2 * reach
                    for right in range(-reach, reach + 1, stride):
                        if col + right < 0 or col + right >= cols:
                            continue
                        rise = np.float64(z_um[row + down, col + right]) - z
                        away = rise * rise + pixel_um2 * (down * down + right * right)
                        if away == away and (count < nearest.size or away < nearest[count - 1]):
                            count = min(count + 1, nearest.size)
                            position = count - 1
                            while position > 0 and nearest[position - 1] > away:
                                nearest[position] = nearest[position - 1]
                                position -= 1
                            nearest[position] = away
                if count == nearest.size and nearest[count - 1] <= pixel_um2 * (reach + 1) ** 2:
                    total = 0.0
                    for k in range(count):
                        total += np.sqrt(nearest[k])
                    out[row, col] = total / count
                    break
