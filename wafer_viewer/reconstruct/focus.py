"""How sharp each pixel of each frame is: the focus measures of the paper, written for one pass over the data.

A block of a stack is taken a frame at a time and a row at a time. A row's energy goes into sums over the columns of the
window (a ring of rows makes them exact: what entered is what leaves), those are added up along the row, and the
logarithm is kept as 16 bits in the focus volume of the block (eq. 5) while the best frame of each pixel (eq. 6) is
noted in passing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.stack import Image
from wafer_viewer.numerics.arrays import Float32s, Greys, Int32s, Real, UInt16s, Whole, Wholes
from wafer_viewer.numerics.jit import kernel

_SML, _TENENGRAD, _GLV = 0, 1, 2


@dataclass(frozen=True, slots=True)
class FocusMeasure:
    """A focus measure: the kernels' code for it, what it is, and where it is from.

    power: it falls as the blur's variance to minus this power. The energy of white texture under a Gaussian blur of
    variance v goes as 1 / v^2 for first and 1 / v^3 for second derivatives; that of the variance in a window, which
    takes the mean out, was measured.
    """

    code: int
    title: str
    source: str
    power: float


FOCUS_MEASURES: dict[str, FocusMeasure] = {
    "sml": FocusMeasure(_SML, "Sum of the squared second derivatives", "eq. 2", 3.0),
    "tenengrad": FocusMeasure(_TENENGRAD, "Sum of the squared Sobel gradients", "eq. 3", 2.0),
    "glv": FocusMeasure(_GLV, "Variance of the grey levels", "eq. 4", 1.7),
}


class Rows(NamedTuple):
    """The rows that the kernels work in: small enough for the first cache, one set for each thread."""

    smooth: Wholes
    slope: Wholes
    energy: Wholes
    ring: Wholes
    columns: Wholes
    squares: Wholes
    doubled: Wholes
    redoubled: Wholes
    sums: Wholes
    square_sums: Wholes
    value: Float32s

    @classmethod
    def make(cls, cols: int, window: int, dtype: np.dtype[Any]) -> Rows:
        """Rows for blocks `cols` wide; int32 holds all sums of 8-bit grey up to a window of 25, int64 of 16-bit."""
        whole = np.int32 if np.dtype(dtype).itemsize == 1 else np.int64
        wide = cols + window - 1
        return cls(
            smooth=np.zeros(wide + 2, whole),
            slope=np.zeros(wide + 2, whole),
            energy=np.zeros(wide, whole),
            ring=np.zeros((window, wide), whole),
            columns=np.zeros(wide, whole),
            squares=np.zeros(wide, whole),
            doubled=np.zeros(wide, whole),
            redoubled=np.zeros(wide, whole),
            sums=np.zeros(cols, whole),
            square_sums=np.zeros(cols, whole),
            value=np.zeros(cols, np.float32),
        )


def margin_px(window: int) -> int:
    """How far a block must reach beyond the pixels it is for: half the window, and one pixel for the derivatives."""
    return window // 2 + 1


def mantissa_bits(dtype: np.dtype[Any]) -> int:
    """Bits of a level of the focus volume that follow the whole part of log2: five or six bits are before them."""
    return 11 if np.dtype(dtype).itemsize == 1 else 10


def focus_image(image: Image, measure: str, window: int) -> NDArray[np.float32]:
    """The focus measure of one image [row, col], eq. 2, 3 or 4, as float32 of the same shape.

    Beyond the border the border pixels repeat.
    """
    padded = np.pad(image, margin_px(window), mode="edge")
    out = np.empty(image.shape, np.float32)
    _focus_values(padded, FOCUS_MEASURES[measure].code, window, Rows.make(image.shape[1], window, image.dtype), out)
    return out / np.float32(window * window) if measure == "glv" else out


@kernel
def focus_block(
    block: Greys,
    measure: Whole,
    window: Whole,
    clipped_counts: Whole,
    rows: Rows,
    levels: UInt16s,
    best: UInt16s,
    peak: UInt16s,
    clipped: UInt16s,
) -> None:
    """Focus volume, best level, best frame and number of clipped frames of a block.

    block: [k, row + 2 margin, col + 2 margin]; levels: [k, row, col]; best, peak, clipped: [row, col].
    """
    best[:] = 0
    peak[:] = 0
    clipped[:] = 0
    shift = np.int32(12 if block.itemsize == 1 else 13)
    bits = rows.value.view(np.int32)
    margin = window // 2 + 1
    for k in range(block.shape[0]):
        frame = block[k]
        _begin(rows)
        for r in range(best.shape[0] + window - 1):
            _take_row(frame, r, measure, window, rows)
            y = r - window + 1
            if y >= 0:
                _add_up(measure, window, rows)
                _note(bits, shift, np.uint16(k), levels[k, y], best[y], peak[y])
                _count_clipped(frame[y + margin], margin, clipped_counts, clipped[y])


@kernel
def _focus_values(frame: Greys, measure: Whole, window: Whole, rows: Rows, out: Float32s) -> None:
    _begin(rows)
    for r in range(out.shape[0] + window - 1):
        _take_row(frame, r, measure, window, rows)
        if r >= window - 1:
            _add_up(measure, window, rows)
            out[r - window + 1] = rows.value


@kernel
def _begin(rows: Rows) -> None:
    rows.ring[:] = 0
    rows.columns[:] = 0
    rows.squares[:] = 0


@kernel
def _take_row(frame: Greys, r: Whole, measure: Whole, window: Whole, rows: Rows) -> None:
    """Let row r of the frame into the column sums, and the row that leaves the window out of them."""
    ring = rows.ring[r % window]
    if measure == _GLV:
        _slide_grey(frame[r + 1], ring, rows.columns, rows.squares)
        return
    if measure == _SML:
        _sml_row(frame[r], frame[r + 1], frame[r + 2], rows.energy)
    else:
        _tenengrad_row(frame[r], frame[r + 1], frame[r + 2], rows.smooth, rows.slope, rows.energy)
    _slide(rows.energy, ring, rows.columns)


# Numba widens the sum of two int32 to int64, which halves the lanes of a vector: every operation is cast back.


@kernel
def _sml_row(above: Greys, here: Greys, below: Greys, energy: Wholes) -> None:
    """|Ixx|^2 + |Iyy|^2 of eq. 2."""
    i = energy.dtype.type
    for x in range(energy.size):
        twice = i(i(here[x + 1]) + i(here[x + 1]))
        xx = i(i(i(here[x]) + i(here[x + 2])) - twice)
        yy = i(i(i(above[x + 1]) + i(below[x + 1])) - twice)
        energy[x] = i(i(xx * xx) + i(yy * yy))


@kernel
def _tenengrad_row(above: Greys, here: Greys, below: Greys, smooth: Wholes, slope: Wholes, energy: Wholes) -> None:
    """Gx^2 + Gy^2 of eq. 3, the Sobel operator as one pass down the columns and one along the row."""
    i = energy.dtype.type
    for x in range(smooth.size):
        smooth[x] = i(i(i(above[x]) + i(below[x])) + i(i(here[x]) + i(here[x])))
        slope[x] = i(i(below[x]) - i(above[x]))
    for x in range(energy.size):
        gx = i(smooth[x + 2] - smooth[x])
        gy = i(i(slope[x] + slope[x + 2]) + i(slope[x + 1] + slope[x + 1]))
        energy[x] = i(i(gx * gx) + i(gy * gy))


@kernel
def _slide(energy: Wholes, ring: Wholes, columns: Wholes) -> None:
    i = columns.dtype.type
    for x in range(columns.size):
        new = energy[x]
        columns[x] = i(columns[x] + i(new - ring[x]))
        ring[x] = new


@kernel
def _slide_grey(here: Greys, ring: Wholes, columns: Wholes, squares: Wholes) -> None:
    """Sums of grey and of its square, by the difference d and the sum s of what enters and what leaves."""
    i = columns.dtype.type
    for x in range(columns.size):
        new = i(here[x + 1])
        d = i(new - ring[x])
        s = i(new + ring[x])
        columns[x] = i(columns[x] + d)
        squares[x] = i(squares[x] + i(d * s))
        ring[x] = new


@kernel
def _add_up(measure: Whole, window: Whole, rows: Rows) -> None:
    """The measure of one row of pixels, in rows.value: for eq. 4 times the number of pixels of the window."""
    _box(rows.columns, window, rows.doubled, rows.redoubled, rows.sums)
    if measure == _GLV:
        _box(rows.squares, window, rows.doubled, rows.redoubled, rows.square_sums)
        _deviations(rows.sums, rows.square_sums, 1.0 / (window * window), rows.value)
    else:
        _as_float(rows.sums, rows.value)


@kernel
def _as_float(sums: Wholes, value: Float32s) -> None:
    for x in range(value.size):
        value[x] = np.float32(sums[x])


@kernel
def _box(columns: Wholes, window: Whole, doubled: Wholes, redoubled: Wholes, sums: Wholes) -> None:
    """Sums of `window` neighbours by doubling: log2(window) additions a pixel instead of window - 1.

    Sums of 2, 4, 8 ... neighbours are made in turn and those that make up an odd window are added.
    """
    i = sums.dtype.type
    power, spare = doubled, redoubled
    _pairs(columns, 1, power)
    for x in range(sums.size):
        sums[x] = columns[x]
    width, done = 2, 1
    while width <= window:
        if window & width:
            ahead = power[done:]
            for x in range(sums.size):
                sums[x] = i(sums[x] + ahead[x])
            done += width
        if 2 * width <= window:
            _pairs(power, width, spare)
            power, spare = spare, power
        width *= 2


@kernel
def _pairs(values: Wholes, distance: Whole, out: Wholes) -> None:
    i = out.dtype.type
    ahead = values[distance:]
    for x in range(ahead.size):
        out[x] = i(values[x] + ahead[x])


@kernel
def _deviations(sums: Wholes, square_sums: Wholes, per_pixel: Real, value: Float32s) -> None:
    """Sum of squared deviations from the mean: exact in float64 for 16-bit grey and a window of 25."""
    for x in range(value.size):
        total = np.float64(sums[x])
        value[x] = np.float32(np.float64(square_sums[x]) - total * total * per_pixel)


@kernel
def _note(bits: Int32s, shift: Whole, k: Whole, level: UInt16s, best: UInt16s, peak: UInt16s) -> None:
    """Keep log2 of a row and the best frame so far.

    The bits of a float32 are its logarithm already, with a mantissa that is linear between powers of two: cut to 16
    they are monotone, and `log2_table` makes them exact.
    """
    i = np.int32
    bias = i(i(127 << 23) - i(1 << (shift - 1)))
    for x in range(level.size):
        q = i(i(bits[x] - bias) >> shift)
        q = q if q > i(0) else i(0)
        old = i(best[x])
        at = peak[x]
        level[x] = q
        best[x] = q if q > old else old
        peak[x] = k if q > old else at


@kernel
def _count_clipped(row: Greys, margin: Whole, clipped_counts: Whole, clipped: UInt16s) -> None:
    limit = np.int32(clipped_counts)
    inner = row[margin:]
    for x in range(clipped.size):
        clipped[x] += np.uint16(np.int32(inner[x]) >= limit)
