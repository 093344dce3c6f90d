"""Sliding filters of maps, and sliding sums along a row."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.jit import (
    Bools,
    Float32s,
    Float64s,
    Int,
    Int64s,
    Ints,
    Real,
    inlined_part,
    lean_kernel,
    lean_part,
)

Plane = TypeVar("Plane", bound=NDArray[Any])
Floats = NDArray[np.float32]
Reals = TypeVar("Reals", Float32s, Float64s)
_GAUSSIAN_REACH = 4.0
"""Reach of a Gaussian, in standard deviations."""


def highest(plane: Plane, size: int) -> Plane:
    """Sliding maximum of size x size pixels; NaN spreads to its surroundings."""
    return _extreme(plane, size, np.maximum)


def lowest(plane: Plane, size: int) -> Plane:
    """Sliding minimum of size x size pixels; NaN spreads to its surroundings."""
    return _extreme(plane, size, np.minimum)


def _extreme(plane: Plane, size: int, choose: np.ufunc) -> Plane:
    """Sliding extreme along both axes, the border repeated.

    The extremes of 1, 2, 4, ... pixels follow from each other, and two of the longest cover the window: a few passes
    over contiguous rows, which numpy vectorises. Truth values take the passes of bytes.
    """
    found: Any = plane.view(np.uint8) if plane.dtype == np.bool_ else plane
    for axis in (1, 0):
        n, before = found.shape[axis], size // 2
        width = [(0, 0), (0, 0)]
        width[axis] = before, size - 1 - before
        found, length = np.pad(found, width, mode="edge"), 1
        while 2 * length <= size:
            found = choose(_shifted(found, axis, 0, -length), _shifted(found, axis, length, None))
            length *= 2
        if length < size:
            found = choose(_shifted(found, axis, 0, n), _shifted(found, axis, size - length, size - length + n))
    return found.view(np.bool_) if plane.dtype == np.bool_ else found


def _shifted(plane: NDArray[Any], axis: int, first: int, stop: int | None) -> NDArray[Any]:
    return plane[:, first:stop] if axis else plane[first:stop]


def sliding_range(plane: Floats, size: int) -> Floats:
    """Sliding range of the finite values of size x size pixels, 0 if there are none."""
    valid = np.isfinite(plane)
    high = highest(np.where(valid, plane, np.float32(-np.inf)), size)
    low = lowest(np.where(valid, plane, np.float32(np.inf)), size)
    return np.where(high >= low, high - low, np.float32(0))


def mean(plane: NDArray[Any], size: int) -> Floats:
    """Sliding mean of size x size pixels, the border repeated."""
    return box_mean(np.ascontiguousarray(plane, np.float32), size, repeats=True)


def mean_of_valid(plane: NDArray[Any], valid: NDArray[np.bool_], size: int) -> Floats:
    """Sliding mean of the known ones of size x size pixels; 0 if there are none."""
    values, known = (np.empty(plane.shape, np.float32) for _ in range(2))
    _mask(np.ascontiguousarray(plane, np.float32), np.ascontiguousarray(valid), values, known)
    total, share = mean(values, size), mean(known, size)
    _divide(total, share, np.float32(0.5 / size**2))
    return total


@lean_kernel
def _mask(plane: Float32s, valid: Bools, values: Float32s, known: Float32s) -> None:
    """Write the known values, 0 elsewhere, and 1 where they are known."""
    for y in range(plane.shape[0]):
        for x in range(plane.shape[1]):
            values[y, x] = plane[y, x] if valid[y, x] else np.float32(0)
            known[y, x] = valid[y, x]


def box_mean(plane: Reals, size: int, repeats: bool) -> Reals:
    """Sliding mean of size x size pixels of contiguous float32 or float64; beyond the border it repeats, or is zero.

    The same sums in the same order as those of scipy's uniform filter, to the last bit.
    """
    if size <= 1 or not plane.size:
        return plane.copy()
    out, sums = np.empty_like(plane), np.empty((2, plane.shape[1]))
    line: Any = np.empty(plane.shape[1] + size, plane.dtype)
    _slide_box(plane, size, repeats, line, sums, out)
    return out


@lean_kernel
def _slide_box(plane: Reals, size: Int, repeats: bool, line: Reals, sums: Float64s, out: Reals) -> None:
    """Filter row by row: down the columns by running sums, then along the row, in which only the additions wait.

    line: a row and its surroundings; sums: two rows of work space.
    """
    n_rows, n_cols = plane.shape
    before, after = size // 2, size - 1 - size // 2
    total, step, wide = sums[0], sums[1], np.float64(size)
    total[:] = 0
    line[:] = 0
    for r in range(-before, after + 1):
        if repeats or 0 <= r < n_rows:
            _add_to(total, plane[min(max(r, 0), n_rows - 1)])
    inner, ahead = line[before : before + n_cols], line[size:]
    for y in range(n_rows):
        new, old = y + after, y - before - 1
        if y > 0 and (repeats or (new < n_rows and old >= 0)):
            _add_difference(total, plane[min(new, n_rows - 1)], plane[max(old, 0)])
        elif y > 0 and new < n_rows:
            _add_to(total, plane[new])
        elif y > 0 and old >= 0:
            _subtract_from(total, plane[old])
        for x in range(n_cols):
            inner[x] = total[x] / wide
        if repeats:
            line[:before] = inner[0]
            line[before + n_cols :] = inner[n_cols - 1]
        for x in range(n_cols):
            step[x] = np.float64(ahead[x]) - np.float64(line[x])
        along, row = 0.0, out[y]
        for x in range(size):
            along += line[x]
        for x in range(n_cols):
            here = along
            along += step[x]
            step[x] = here
        for x in range(n_cols):
            row[x] = step[x] / wide


@lean_part
def _add_to(total: Float64s, row: NDArray[Any]) -> None:
    for x in range(total.size):
        total[x] += row[x]


@lean_part
def _subtract_from(total: Float64s, row: NDArray[Any]) -> None:
    for x in range(total.size):
        total[x] -= row[x]


@lean_part
def _add_difference(total: Float64s, new: Reals, old: Reals) -> None:
    for x in range(total.size):
        total[x] += np.float64(new[x]) - np.float64(old[x])


@lean_kernel
def _divide(total: Float32s, share: Float32s, least: Real) -> None:
    """Divide by the known share, 0 where that is no more than `least`."""
    for y in range(total.shape[0]):
        for x in range(total.shape[1]):
            s = share[y, x]
            total[y, x] = total[y, x] / (s if s > least else np.float32(np.inf))


def blurred(plane: NDArray[Any], sigma: float) -> Floats:
    """Gaussian blur, the border repeated: scipy's, to the last bit."""
    plane = np.ascontiguousarray(plane, np.float32)
    reach = int(_GAUSSIAN_REACH * sigma + 0.5)
    weights = np.exp(-0.5 / sigma**2 * np.arange(-reach, reach + 1) ** 2)
    weights = (weights / weights.sum())[reach:]
    out, n_cols = np.empty_like(plane), plane.shape[1]
    _blur(plane, weights, np.empty(n_cols + 2 * reach, np.float32), np.empty(n_cols), out)
    return out


@lean_kernel
def _blur(plane: Float32s, weights: Float64s, line: Float32s, sums: Float64s, out: Float32s) -> None:
    """Filter row by row: down the columns, then along the row; weights: from the middle on."""
    last, n_cols, reach = plane.shape[0] - 1, plane.shape[1], weights.size - 1
    inner = line[reach : reach + n_cols]
    for y in range(plane.shape[0]):
        _weigh(plane[y], weights[0], sums)
        for n in range(reach, 0, -1):
            _add_pair(plane[max(y - n, 0)], plane[min(y + n, last)], weights[n], sums)
        for x in range(n_cols):
            inner[x] = sums[x]
        line[:reach] = inner[0]
        line[reach + n_cols :] = inner[n_cols - 1]
        _weigh(inner, weights[0], sums)
        for n in range(reach, 0, -1):
            _add_pair(line[reach - n :], line[reach + n :], weights[n], sums)
        for x in range(n_cols):
            out[y, x] = sums[x]


@lean_part
def _weigh(row: Float32s, weight: Real, sums: Float64s) -> None:
    for x in range(sums.size):
        sums[x] = np.float64(row[x]) * weight


@lean_part
def _add_pair(one: Float32s, other: Float32s, weight: Real, sums: Float64s) -> None:
    for x in range(sums.size):
        sums[x] += (np.float64(one[x]) + np.float64(other[x])) * weight


def nearest(wanted: NDArray[np.bool_]) -> tuple[NDArray[np.float64], tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Return the distance to the nearest True pixel and its position as (rows, cols); one must be True."""
    from scipy.ndimage import distance_transform_edt

    distance, indices = (np.asarray(a) for a in distance_transform_edt(~wanted, return_indices=True) or ())
    rows, cols = indices.astype(np.intp)
    return distance.astype(np.float64), (rows, cols)


def halved(plane: NDArray[Any]) -> Floats:
    """Return the mean of 2 x 2 pixels; at an odd border, of the available ones."""
    rows, cols = plane.shape
    odd = rows % 2 or cols % 2
    padded = (np.pad(plane, ((0, rows % 2), (0, cols % 2)), mode="edge") if odd else plane).astype(
        np.float32, copy=False
    )
    total = padded[::2, ::2] + padded[::2, 1::2]
    total += padded[1::2, ::2] + padded[1::2, 1::2]
    total *= np.float32(0.25)
    return total


def doubled(plane: Plane, shape: tuple[int, ...]) -> Plane:
    """Repeat each pixel 2 x 2, cropped to `shape`."""
    return repeated(plane, 2, shape)


def repeated(plane: Plane, times: int, shape: tuple[int, ...]) -> Plane:
    """Repeat each pixel `times` x `times`, cropped to `shape`; complete rows are copied."""
    rows: Any = plane.repeat(times, axis=1)[:, : shape[1]].repeat(times, axis=0)[: shape[0]]
    return rows


AHEAD = 64
"""Padding behind each row, for loops with even trip counts that read ahead."""


def window_pieces(window: int) -> NDArray[np.int64]:
    """Return the decomposition of a window into pieces of 9, 3 and 1: 3 or 5 rows of (power of three, offset)."""
    found: list[tuple[int, int]] = []
    done = 0
    for power in (2, 1, 0):
        while 3**power < window and done + 3**power <= window:
            found.append((power, done))
            done += 3**power
    return np.array(found, np.int64)


# Numba widens the sum of two int32 to int64, which halves the lanes of a vector: every operation is cast back.


@inlined_part
def box(sums: Ints, pieces: Int64s, out: Ints) -> None:
    """Sliding sum of the row sums[0] over the window, with the fewest additions that its pieces allow.

    sums: [4, row]; the other rows are overwritten.
    """
    if pieces[0, 0] > 0:
        _add_neighbours(sums[0], sums[1])
    if pieces[0, 0] > 1:
        _add_three(sums[1], sums[1, 3:], sums[1, 6:], sums[2])
    first = sums[pieces[0, 0]]
    last = len(pieces) - 2
    if last > 1:
        _add_three(first, sums[pieces[1, 0], pieces[1, 1] :], sums[pieces[2, 0], pieces[2, 1] :], sums[3])
        first = sums[3]
    _add_three(first, sums[pieces[last, 0], pieces[last, 1] :], sums[pieces[last + 1, 0], pieces[last + 1, 1] :], out)


@lean_part
def _add_three(a: Ints, b: Ints, c: Ints, out: Ints) -> None:
    i = a.dtype.type
    for x in range(min(out.size, c.size)):
        out[x] = i(i(a[x] + b[x]) + c[x])


@lean_part
def _add_neighbours(row: Ints, out: Ints) -> None:
    """Sums of three neighbours; two of them stay in registers."""
    i = row.dtype.type
    first, second, ahead = row[0], row[1], row[2:]
    for x in range(ahead.size):
        third = ahead[x]
        out[x] = i(i(first + second) + third)
        first, second = second, third
