"""Focus measures of the paper, eq. 2, 3 and 4, computed in one pass over the data.

A row's energy is added to sums over the columns of the window. A ring of rows keeps these sums exact, because the same
values enter and leave. The sums are added up along the row, and the logarithm of the total is stored as 16 bits.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.numerics.filters.sliding_filters import AHEAD, box, window_pieces
from wafer_viewer.numerics.jit import (
    Float32s,
    Greys,
    Int,
    Int64s,
    Ints,
    UInt16s,
    aligned,
    inlined_part,
    lean_kernel,
    lean_part,
)
from wafer_viewer.reconstruct.focus.focus_volume import (
    Focusing,
    FocusKernels,
    Volume,
    accumulate_row,
    count_clipped,
    empty,
    take_grey,
)
from wafer_viewer.reconstruct.frame_blocks import StackSource

SML, TENENGRAD, GLV = 0, 1, 2
"""Codes of the measures, for the kernels."""
_CODES = {"sml": SML, "tenengrad": TENENGRAD, "glv": GLV}
PAPER_MEASURES = tuple(_CODES)


class Rows(NamedTuple):
    """Work rows of the kernels, small enough for the L1 and L2 caches, one set for each thread.

    grey: four rows of the frame; half: smoothing and derivative of the Sobel column pass; ring: energies in the sums;
    sums: of the energy, or of grey and of its square, over the window's rows, then over 3 and 9 neighbours, and a spare
    row; total: over the window; value: the measure where it is not a sum; pieces: see `window_pieces`.
    """

    grey: Greys
    half: Ints
    ring: Ints
    sums: Ints
    total: Ints
    value: Float32s
    pieces: Int64s

    @classmethod
    def make(cls, cols: int, window: int, dtype: np.dtype[Any]) -> Rows:
        """Allocate rows for blocks `cols` wide.

        int32 holds all sums of 8-bit grey up to a window of 25, int64 those of 16-bit grey.
        """
        short, long = (np.int16, np.int32) if np.dtype(dtype).itemsize == 1 else (np.int32, np.int64)
        wide = -(-(cols + window - 1) // AHEAD) * AHEAD
        return cls(
            grey=aligned((4, wide + AHEAD), dtype),
            half=aligned((2, wide + AHEAD), short),
            ring=aligned((window, wide), long),
            sums=aligned((2, 4, wide + AHEAD), long),
            total=aligned((2, cols), long),
            value=aligned((cols,), np.float32),
            pieces=window_pieces(window),
        )


@lean_kernel
def focus_block(source: StackSource, measure: Int, window: Int, rows: Rows, volume: Volume) -> None:
    """Compute the focus volume of a block of frames; its margin is half the window, and a pixel for the derivatives."""
    empty(volume)
    shift = np.int32(12 if source.images.itemsize == 1 else 13)
    margin = window // 2 + 1
    n_rows = volume.best.shape[0]
    for k in range(volume.levels.shape[0]):
        _begin(rows)
        for r in range(n_rows + 2 * margin + 1):
            _take_row(source, k, r, measure, window, rows)
            centre, y = r - margin - 2, r - 2 * margin - 1
            if 0 <= centre < n_rows:
                count_clipped(rows.grey[(r + 2) % 4, margin:], source.clipped_counts, volume.clipped[centre])
            if y >= 0:
                _add_up(measure, window, rows)
                if measure == GLV:
                    _as_levels(rows.value, shift, volume.levels[k, y])
                else:
                    _as_levels(rows.total[0], shift, volume.levels[k, y])
                accumulate_row(volume, k, y)


@lean_kernel
def focus_values(source: StackSource, measure: Int, window: Int, rows: Rows, out: Float32s) -> None:
    """Compute the measure of the first frame of a source into `out` [row, col].

    Eq. 4 is multiplied by the number of pixels of the window.
    """
    margin = window // 2 + 1
    _begin(rows)
    for r in range(out.shape[0] + 2 * margin + 1):
        _take_row(source, 0, r, measure, window, rows)
        y = r - 2 * margin - 1
        if y >= 0:
            _add_up(measure, window, rows)
            for x in range(out.shape[1]):
                out[y, x] = rows.value[x] if measure == GLV else rows.total[0, x]


def focus_image(image: Image, measure: str, window: int) -> NDArray[np.float32]:
    """Return the focus measure of one image [row, col], eq. 2, 3 or 4, as float32 of the same shape.

    Beyond the border the border pixels repeat. Raises KeyError for a measure that is not one of the paper's.
    """
    source = StackSource.of(np.ascontiguousarray(image)[None], np.zeros(1, np.int64), 0, 0, 0)
    out = np.empty(image.shape, np.float32)
    focus_values(source, _CODES[measure], window, Rows.make(image.shape[1], window, image.dtype), out)
    return out / np.float32(window * window) if measure == "glv" else out


def _kernels(code: int) -> FocusKernels:
    return FocusKernels(_mantissa_table, Rows.make, partial(_fill, code))


def _fill(code: int, source: StackSource, how: Focusing, rows: Rows, volume: Volume) -> None:
    focus_block(source, code, how.window, rows, volume)


def _mantissa_table(dtype: np.dtype[Any]) -> Float32s:
    """Return log2(1 + fraction) for levels that are the bits of a float32, five or six of them before the point."""
    bits = 11 if np.dtype(dtype).itemsize == 1 else 10
    return np.log2(1 + np.arange(2**bits) / 2**bits).astype(np.float32)


SML_KERNELS, TENENGRAD_KERNELS, GLV_KERNELS = (_kernels(code) for code in (SML, TENENGRAD, GLV))


@inlined_part
def _begin(rows: Rows) -> None:
    rows.ring[:] = 0
    rows.sums[0, 0] = 0
    rows.sums[1, 0] = 0


@inlined_part
def _take_row(source: StackSource, k: Int, r: Int, measure: Int, window: Int, rows: Rows) -> None:
    """Read grey row r of a frame, and update the column sums: add row r - 2, remove the oldest row.

    The row just read is not used yet, because reading a freshly written row at other alignments is slow.
    """
    margin = window // 2 + 1
    take_grey(source, k, r - margin, margin, rows.value.size, rows.grey[r % 4])
    if r < 3:
        return
    above, centre, below = rows.grey[(r + 1) % 4], rows.grey[(r + 2) % 4], rows.grey[(r + 3) % 4]
    ring, columns = rows.ring[r % window], rows.sums[0, 0]
    if measure == GLV:
        _slide_grey(centre, ring, columns, rows.sums[1, 0])
    elif measure == SML:
        _slide_sml(above, centre, below, ring, columns)
    else:
        _halve_sobel(above, centre, below, rows.half[0], rows.half[1])
        _slide_tenengrad(rows.half[0], rows.half[1], ring, columns)


# Numba widens the sum of two int32 to int64, which halves the lanes of a vector: every operation is cast back.


@lean_part
def _slide_sml(above: Greys, centre: Greys, below: Greys, ring: Ints, columns: Ints) -> None:
    """Update the sums of |Ixx|^2 + |Iyy|^2 of eq. 2."""
    i = ring.dtype.type
    for x in range(ring.size):
        twice = i(i(centre[x + 1]) + i(centre[x + 1]))
        xx = i(i(i(centre[x]) + i(centre[x + 2])) - twice)
        yy = i(i(i(above[x + 1]) + i(below[x + 1])) - twice)
        new = i(i(xx * xx) + i(yy * yy))
        columns[x] = i(columns[x] + i(new - ring[x]))
        ring[x] = new


@lean_part
def _halve_sobel(above: Greys, centre: Greys, below: Greys, smooth: Ints, slope: Ints) -> None:
    """Apply the column pass of the Sobel operator."""
    i = smooth.dtype.type
    for x in range(smooth.size):
        smooth[x] = i(i(i(above[x]) + i(below[x])) + i(i(centre[x]) + i(centre[x])))
        slope[x] = i(i(below[x]) - i(above[x]))


@lean_part
def _slide_tenengrad(smooth: Ints, slope: Ints, ring: Ints, columns: Ints) -> None:
    """Update the sums of Gx^2 + Gy^2 of eq. 3."""
    i = ring.dtype.type
    for x in range(ring.size):
        gx = i(i(smooth[x + 2]) - i(smooth[x]))
        gy = i(i(i(slope[x]) + i(slope[x + 2])) + i(i(slope[x + 1]) + i(slope[x + 1])))
        new = i(i(gx * gx) + i(gy * gy))
        columns[x] = i(columns[x] + i(new - ring[x]))
        ring[x] = new


@lean_part
def _slide_grey(centre: Greys, ring: Ints, columns: Ints, squares: Ints) -> None:
    """Update the sums of grey and of its square from the difference d and sum s of entering and leaving values."""
    i = ring.dtype.type
    for x in range(ring.size):
        new = i(centre[x + 1])
        d = i(new - ring[x])
        s = i(new + ring[x])
        columns[x] = i(columns[x] + d)
        squares[x] = i(squares[x] + i(d * s))
        ring[x] = new


@inlined_part
def _add_up(measure: Int, window: Int, rows: Rows) -> None:
    """Sum the measure of one row of pixels into rows.total; eq. 4, times the window's pixels, into rows.value."""
    for n in range(2 if measure == GLV else 1):
        box(rows.sums[n], rows.pieces, rows.total[n])
    if measure == GLV:
        _deviations(rows.total[0], rows.total[1], window * window, rows.value)


@lean_part
def _deviations(total: Ints, square_total: Ints, n_pixels: Int, value: Float32s) -> None:
    """Compute the sum of squared deviations from the mean.

    Integer deviations from a grey value near the mean are summed first; the remainder is corrected in float.
    """
    i = total.dtype.type
    n = i(n_pixels)
    per_pixel = np.float32(1 / n_pixels)
    for x in range(value.size):
        middle = i(np.float32(total[x]) * per_pixel)
        rest = i(total[x] - i(n * middle))
        about = i(square_total[x] - i(middle * i(total[x] + rest)))
        off = np.float32(rest)
        value[x] = np.float32(about) - off * off * per_pixel


@lean_part
def _as_levels(values: Ints, shift: Int, level: UInt16s) -> None:
    """Convert a row to log2 as 16 bits.

    The bits of a float32 approximate its logarithm, with a mantissa that is linear between powers of two. Cut to 16
    bits they are monotone, and a table makes them exact.
    """
    i = np.int32
    bias = i(i(127 << 23) - i(1 << (shift - 1)))
    for x in range(level.size):
        q = i(i(np.float32(values[x]).view(i) - bias) >> shift)
        level[x] = q if q > i(0) else i(0)
