"""Connected regions above a threshold in a picture, found by flood fill because they are sparse.

8-connectivity; NaN is above no threshold.
"""

from __future__ import annotations

import numpy as np

from wafer_viewer.numerics.array_types import Bools, Float32s, Int32s, Real, Whole
from wafer_viewer.numerics.jit import kernel


def region_maxima(plane: Float32s, least: Real, least_px: Whole = 1) -> Float32s:
    """Return the maximum of each region of at least `least_px` pixels at or above `least`, in row-major order."""
    over = plane >= np.float32(least)
    n = int(np.count_nonzero(over))
    tops = np.empty(n, np.float32)
    return tops[: _tops(plane, over, np.empty(n, np.int32), int(least_px), tops)] if n else tops


def regions_with_peaks(low: Bools, peaks: Bools) -> Bools:
    """Return a mask of the regions of `low` that contain a pixel of `peaks` (hysteresis threshold); bool [row, col]."""
    found = np.zeros(low.shape, np.bool_)
    n = int(np.count_nonzero(low))
    if n:
        _mark_regions_with_peaks(np.ascontiguousarray(peaks & low), low.copy(), np.empty(n, np.int32), found)
    return found


def dilated(mask: Bools, reach_px: Whole) -> Bools:
    """Dilate the mask by a square of `reach_px` rows and columns to each side; bool [row, col]."""
    out = np.zeros(mask.shape, np.bool_)
    _widen(np.ascontiguousarray(mask), int(reach_px), out)
    return out


@kernel
def _tops(plane: Float32s, over: Bools, waiting: Int32s, least_px: Whole, tops: Float32s) -> int:
    """Write the maxima and return their number; `over` is cleared."""
    n_cols, n = plane.shape[1], 0
    for r in range(plane.shape[0]):
        for c in range(n_cols):
            if over[r, c]:
                size = _flood_fill(r, c, over, waiting)
                if size >= least_px:
                    top = plane[r, c]
                    for k in range(size):
                        top = max(top, plane[waiting[k] // n_cols, waiting[k] % n_cols])
                    tops[n] = top
                    n += 1
    return n


@kernel
def _mark_regions_with_peaks(peaks: Bools, low: Bools, waiting: Int32s, found: Bools) -> None:
    """Write the mask of the regions that contain a peak; `low` is cleared there."""
    n_cols = low.shape[1]
    for r in range(low.shape[0]):
        for c in range(n_cols):
            if peaks[r, c] and low[r, c]:
                for k in range(_flood_fill(r, c, low, waiting)):
                    found[waiting[k] // n_cols, waiting[k] % n_cols] = True


@kernel
def _flood_fill(row: Whole, col: Whole, open_ones: Bools, waiting: Int32s) -> int:
    """Flood fill from one pixel; return the region's size. Its pixels are written to `waiting` and closed."""
    n_rows, n_cols = open_ones.shape
    open_ones[row, col] = False
    waiting[0] = row * n_cols + col
    n_met, n_done = 1, 0
    while n_done < n_met:
        r, c = waiting[n_done] // n_cols, waiting[n_done] % n_cols
        n_done += 1
        for r2 in range(max(0, r - 1), min(n_rows, r + 2)):
            for c2 in range(max(0, c - 1), min(n_cols, c + 2)):
                if open_ones[r2, c2]:
                    open_ones[r2, c2] = False
                    waiting[n_met] = r2 * n_cols + c2
                    n_met += 1
    return n_met


@kernel
def _widen(mask: Bools, reach: Whole, out: Bools) -> None:
    n_rows, n_cols = mask.shape
    for r in range(n_rows):
        until = 0
        for c in range(n_cols):
            if mask[r, c]:
                for c2 in range(max(until, c - reach), min(n_cols, c + reach + 1)):
                    for r2 in range(max(0, r - reach), min(n_rows, r + reach + 1)):
                        out[r2, c2] = True
                until = c + reach + 1
