"""Heights from a wider window, for comparison with those of the recipe's window.

Where light bleeds from a bright neighbour, or texture runs out, the height depends on the window size; where both
windows agree the height is that of the surface. The wide window is cheap: it averages the levels of the coarse focus
volume, 4 x 4 pixels each, which the search computes anyway.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.array_types import Float32s, Float64s, Int32s, UInt16s, Whole, aligned
from wafer_viewer.numerics.jit import inlined_part, lean_kernel, lean_part
from wafer_viewer.reconstruct.focus.focus_measures import FOCUS_MEASURES
from wafer_viewer.reconstruct.focus.focus_volume import COARSE_PX, note
from wafer_viewer.reconstruct.focus.peak import FocusCurves, Peaks, gather, gather_blended
from wafer_viewer.reconstruct.focus.peak_interpolation import InterpolationScratch, PeakInterpolation, place_row
from wafer_viewer.reconstruct.focus.peak_search import Search


def wide_cells(window: int) -> int:
    """Return the number of coarse levels per axis to average for about twice a window.

    The result is 3 for a window of 9, equivalent to a window of 17 to 20.
    """
    return 2 * ((window - 1) // (2 * COARSE_PX)) + 1


def wide_heights(
    peaks: Peaks, z_um: NDArray[np.float64], search: Search, cells: int | None = None
) -> NDArray[np.float32]:
    """Return z in um [row, col] of a field's peaks from coarse levels averaged over `cells` x `cells`.

    All pixels of a 4 x 4 cell share a height. The window in pixels is that of the search plus 4 `cells` - 1; beyond the
    border the border levels repeat. `peaks` must have its coarse volume.
    """
    n_frames, n_rows, cols = peaks.coarse.shape
    cells = cells or wide_cells(search.window)
    curves = FocusCurves.make(n_frames, (1, cols))
    spots = InterpolationScratch.make(cols, FOCUS_MEASURES[search.measure].table(peaks.all_in_focus.dtype))
    line = aligned((cols + cells - 1,), np.int32)
    out = np.empty((n_rows, cols), np.float32)
    _search_rows(
        peaks.coarse,
        cells,
        line,
        np.asarray(z_um, np.float64),
        search.placing._replace(floored=False),
        curves,
        spots,
        out,
    )
    rows, cols = peaks.z_um.shape
    return out.repeat(COARSE_PX, axis=0)[:rows].repeat(COARSE_PX, axis=1)[:, :cols]


@lean_kernel
def _search_rows(
    coarse: UInt16s,
    cells: Whole,
    line: Int32s,
    z_um: Float64s,
    how: PeakInterpolation,
    curves: FocusCurves,
    spots: InterpolationScratch,
    out: Float32s,
) -> None:
    only = np.int64(0)  # a plain 0 would be a type of its own, and what takes it compiled once more
    for y in range(out.shape[0]):
        curves.best[:] = 0
        curves.peak[:] = 0
        for k in range(coarse.shape[0]):
            _average(coarse, k, y, cells, line, curves.levels[k, 0])
            note(curves.levels[k, 0], np.uint16(k), curves.best[0], curves.peak[0])
        if how.blend:
            gather_blended(curves, only, z_um, how, spots)
        else:
            gather(curves, only, z_um, how, spots)
        place_row(how, spots, out[y])


@inlined_part
def _average(coarse: UInt16s, k: Whole, y: Whole, cells: Whole, line: Int32s, level: UInt16s) -> None:
    """Compute a row of means over cells x cells levels: column sums with repeated borders, then along the row."""
    half, last = cells // 2, coarse.shape[1] - 1
    columns = line[half : half + level.size]
    columns[:] = 0
    for d in range(cells):
        _add(coarse[k, min(max(y + d - half, 0), last)], columns)
    for x in range(half):
        line[x] = columns[0]
        line[half + level.size + x] = columns[level.size - 1]
    _mean_along(line, cells, level)


@lean_part
def _add(level: UInt16s, columns: Int32s) -> None:
    for x in range(columns.size):
        columns[x] = np.int32(columns[x] + np.int32(level[x]))


@lean_part
def _mean_along(line: Int32s, cells: Whole, level: UInt16s) -> None:
    per_cell, half = np.float32(1 / cells**2), np.float32(0.5)
    for x in range(level.size):
        total = np.int32(0)
        for d in range(cells):
            total = np.int32(total + line[x + d])
        level[x] = np.int32(np.float32(total) * per_cell + half)
