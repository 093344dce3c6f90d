"""Sliding filters of maps, and sliding sums along a row."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.jit import Int64s, Ints, inlined_part, lean_part

Plane = TypeVar("Plane", bound=NDArray[Any])
Floats = NDArray[np.float32]


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
    """Sliding mean of size x size pixels."""
    from scipy.ndimage import uniform_filter

    return np.asarray(uniform_filter(plane.astype(np.float32), size, mode="nearest"), np.float32)


def mean_of_valid(plane: NDArray[Any], valid: NDArray[np.bool_], size: int) -> Floats:
    """Sliding mean of the known ones of size x size pixels; 0 if there are none."""
    share = mean(valid, size)
    total = mean(np.where(valid, plane, np.zeros_like(plane)), size)
    return total / np.where(share > 0.5 / size**2, share, np.float32(np.inf)).astype(np.float32)


def blurred(plane: NDArray[Any], sigma: float) -> Floats:
    """Gaussian blur."""
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(plane.astype(np.float32), sigma, mode="nearest"), np.float32)


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
