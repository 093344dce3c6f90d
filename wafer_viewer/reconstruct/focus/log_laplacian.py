"""Stabilised log-Laplacian: a focus measure for dark textures next to bright ones that bleed light.

The square root scales the grey to units of its own noise, so that bright and dark areas have equal weight and pure
noise has the same energy everywhere. The energy of a Laplacian is averaged over 3 x 3 pixels and its logarithm twice
over the window, which equals a triangle filter. Unlike a sum of energies, a mean of logarithms is not dominated by a
bright speck or a distant edge.

With v the stabilised grey, B = [1 2 1] x [1 2 1] / 16 * v:
L = 3 (mean3x3(B) - B), l = log2(19/64 + mean3x3(L^2)), F = box_w(box_w(l)); 19/64 is the energy of unit white noise.

Rows are processed in ring buffers, as for the measures of the paper. 48 L has integer coefficients, 48 L =

     1   3   4   3   1
     3   0  -6   0   3
     4  -6 -20  -6   4
     3   0  -6   0   3
     1   3   4   3   1

and is a symmetric row filter of two column filters. The triangle down the columns is integrated twice from its second
difference, l(y) - 2 l(y - w) + l(y - 2 w), in integers, so that rounding errors do not accumulate.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.filters.sliding_filters import AHEAD, box, window_pieces
from wafer_viewer.numerics.jit import (
    Float32s,
    Greys,
    Int,
    Int32s,
    Int64s,
    Real,
    UInt16s,
    aligned,
    inlined_part,
    lean_kernel,
    lean_part,
    quick_log2,
)
from wafer_viewer.reconstruct.focus.focus_volume import (
    Focusing,
    FocusKernels,
    Volume,
    accumulate_row,
    count_clipped,
    empty,
    fraction_table,
    take_grey,
)
from wafer_viewer.reconstruct.frame_blocks import StackSource
from wafer_viewer.reconstruct.preprocess.camera_noise import CameraNoise

LEVEL_BITS = 11
"""Fraction bits of a level."""

LEVEL_OFFSET = 2
"""A level is 2^11 (F + 2): the logarithm of the noise energy itself is -1.75."""

NOISE_ENERGY = 19 / 64
"""E[L^2] on white noise of unit variance: the sum of the squares of L's coefficients."""

_TAPS_PX = 3
"""Reach of L and of the mean of its square together, in pixels."""
_UNIT_OF_L = 1 / 48
"""L per unit of 48 L, which has integer coefficients."""
_MOST_ENERGY = 2.0**29
"""Upper limit of the energy; its level, 2^11 (29 + 2), fits 16 bits."""
_HIGH_PASS = math.sqrt(2 / 3)
"""Factor of the high-pass along z with which white noise retains its variance."""
_HIGH_PASS_AT_AN_END = math.sqrt(1 / 2)
"""The same at the ends of the stack, where a single frame is subtracted."""


class Stabiliser(NamedTuple):
    """Variance-stabilising transform v = sqrt(scale I + offset) = 2 / gain sqrt(gain I + floor).

    Its noise has unit variance at every grey.
    """

    scale: float
    offset: float

    @classmethod
    def of(cls, noise: CameraNoise) -> Stabiliser:
        """Return the stabiliser of a camera."""
        return cls(4 / noise.gain_counts, 4 * noise.floor_counts2 / noise.gain_counts**2)


class LogRows(NamedTuple):
    """Work rows of the kernel, one set for each thread.

    Every row begins on a cache line, is processed in full vectors, and ends in zeros that the loops read ahead into:
    columns beyond the block are undefined.
    """

    grey: Greys
    stable: Float32s
    wide: Float32s
    narrow: Float32s
    energy: Float32s
    columns: Float32s
    ring: UInt16s
    slope: Int32s
    sums: Int32s
    total: Int32s
    pieces: Int64s

    @classmethod
    def make(cls, cols: int, window: int, dtype: np.dtype[Any]) -> LogRows:
        """Allocate rows for blocks `cols` wide."""
        wide = cols + 2 * log_margin_px(window)

        def rows(count: int, kind: Any) -> NDArray[Any]:
            return aligned((count, -(-wide // AHEAD) * AHEAD + AHEAD), kind)

        return cls(
            grey=rows(3, dtype),
            stable=rows(5, np.float32),
            wide=rows(1, np.float32)[0],
            narrow=rows(1, np.float32)[0],
            energy=rows(3, np.float32),
            columns=rows(1, np.float32)[0],
            ring=rows(2 * window, np.uint16),
            slope=rows(1, np.int32)[0],
            sums=rows(8, np.int32).reshape(2, 4, -1),
            total=aligned((cols,), np.int32),
            pieces=window_pieces(window),
        )


def log_margin_px(window: int) -> int:
    """Return the margin of a block in pixels: the triangle filter, and three pixels for L and its mean."""
    return window - 1 + _TAPS_PX


@lean_kernel
def log_laplacian_block(
    source: StackSource, window: Int, stabiliser: Stabiliser, lag: Int, rows: LogRows, volume: Volume
) -> None:
    """Compute the focus volume of a block of frames.

    lag: 0, or the distance in frames to the two that are subtracted from each: a high-pass along z, which removes
    slowly varying light that bleeds from far away; at most (k - 1) / 2, so that one of the two exists at the ends.
    """
    empty(volume)
    margin = window - 1 + _TAPS_PX
    n_rows = volume.best.shape[0]
    unit = _ring_unit(window)
    scale = np.float32((1 << LEVEL_BITS) / (np.float64(unit) * window**4))
    for k in range(volume.levels.shape[0]):
        _begin(rows)
        for r in range(n_rows + 2 * margin):
            _stabilise(source, volume, k, r - margin, margin, lag, stabiliser, rows, rows.stable[r % 5])
            if margin <= r < n_rows + margin:
                count_clipped(rows.grey[0, margin:], source.clipped_counts, volume.clipped[r - margin])
            if r >= 4:
                _energy_row(rows, r)
            if r >= 6:
                _enter(
                    rows.columns,
                    unit,
                    rows.ring[(r - 6) % (2 * window)],
                    rows.ring[(r - 6 + window) % (2 * window)],
                    rows,
                )
            if r >= 2 * margin:
                _across(scale, rows, volume.levels[k, r - 2 * margin])
                accumulate_row(volume, k, r - 2 * margin)


def _fill(source: StackSource, how: Focusing, rows: LogRows, volume: Volume) -> None:
    log_laplacian_block(source, how.window, Stabiliser.of(how.camera), how.lag, rows, volume)


KERNELS = FocusKernels(lambda _: fraction_table(LEVEL_BITS), LogRows.make, _fill)


@inlined_part
def _ring_unit(window: Int) -> Real:
    """Return the scale of log2 in the ring: a power of two, so that window^4 maximal logarithms fit 31 bits."""
    unit = 1 << LEVEL_BITS
    while window**4 * 32 * unit >= 1 << 31:
        unit //= 2
    return np.float32(unit)


@inlined_part
def _begin(rows: LogRows) -> None:
    rows.ring[:] = 0
    rows.slope[:] = 0
    rows.sums[0, 0] = 0


@inlined_part
def _stabilise(
    source: StackSource,
    volume: Volume,
    k: Int,
    y: Int,
    margin: Int,
    lag: Int,
    stabiliser: Stabiliser,
    rows: LogRows,
    stable: Float32s,
) -> None:
    """Transform row y to unit noise; with a lag, the difference along z, rescaled to unit noise."""
    scale, offset, last = np.float32(stabiliser.scale), np.float32(stabiliser.offset), volume.levels.shape[0] - 1
    grey = rows.grey
    before, after = k - lag if k >= lag else k + lag, k + lag if k + lag <= last else k - lag
    for n in range(3 if lag else 1):
        take_grey(source, k if n == 0 else before if n == 1 else after, y, margin, volume.best.shape[1], grey[n])
    if lag == 0:
        _root(grey[0], scale, offset, stable)
    else:
        centre = np.float32(_HIGH_PASS_AT_AN_END if k < lag or k + lag > last else _HIGH_PASS)
        _roots(grey[0], grey[1], grey[2], centre, np.float32(-0.5) * centre, scale, offset, stable)


@inlined_part
def _root(grey: Greys, scale: Real, offset: Real, stable: Float32s) -> None:
    for x in range(stable.size - AHEAD):
        stable[x] = np.sqrt(np.float32(grey[x]) * scale + offset)


@lean_part
def _roots(
    grey: Greys, before: Greys, after: Greys, centre: Real, side: Real, scale: Real, offset: Real, stable: Float32s
) -> None:
    for x in range(stable.size - AHEAD):
        v = np.sqrt(np.float32(grey[x]) * scale + offset)
        a = np.sqrt(np.float32(before[x]) * scale + offset)
        b = np.sqrt(np.float32(after[x]) * scale + offset)
        stable[x] = centre * v + side * (a + b)


@inlined_part
def _energy_row(rows: LogRows, r: Int) -> None:
    """Compute L^2 of the row r - 2, from the five rows up to r, and its sum with the two rows above."""
    v, e = rows.stable, rows.energy
    _columns_of_five(v[(r - 4) % 5], v[(r - 3) % 5], v[(r - 2) % 5], v[(r - 1) % 5], v[r % 5], rows.wide, rows.narrow)
    _squared(rows.wide, rows.narrow, e[(r - 2) % 3], e[(r - 1) % 3], e[r % 3], rows.columns)


@lean_part
def _columns_of_five(
    v0: Float32s, v1: Float32s, v2: Float32s, v3: Float32s, v4: Float32s, wide: Float32s, narrow: Float32s
) -> None:
    """Down the columns: wide = [1 3 4 3 1], the sum of 3 of t = [1 2 1]; narrow = wide - 3 t."""
    for x in range(wide.size - AHEAD):
        far, near, mid = v0[x] + v4[x], v1[x] + v3[x], v2[x]
        total = far + np.float32(3) * near + np.float32(4) * mid
        wide[x] = total
        narrow[x] = total - np.float32(3) * (near + np.float32(2) * mid)


@lean_part
def _squared(
    wide: Float32s, narrow: Float32s, above: Float32s, middle: Float32s, energy: Float32s, columns: Float32s
) -> None:
    """Along the row: (48 L)^2 from [1 0 -2 0 1] of wide and [3 6 3] of narrow; columns: the sum of three rows of it."""
    wide_2, wide_4 = wide[2:], wide[4:]
    narrow_1, narrow_2, narrow_3 = narrow[1:], narrow[2:], narrow[3:]
    for x in range(energy.size - AHEAD):
        outer = wide[x] + wide_4[x] - np.float32(2) * wide_2[x]
        inner = narrow_1[x] + narrow_3[x] + np.float32(2) * narrow_2[x]
        laplacian = outer + np.float32(3) * inner
        square = laplacian * laplacian
        columns[x] = above[x] + middle[x] + square
        energy[x] = square


# Numba widens the sum of two int32 to int64, which halves the lanes of a vector: every operation is cast back.


@lean_part
def _enter(columns: Float32s, unit: Real, leaving: UInt16s, middle: UInt16s, rows: LogRows) -> None:
    """Add log2(19/64 + mean of 3 x 3 of L^2) to the column triangle, replacing the row that leaves it."""
    i = np.int32
    part, floor, most = np.float32(_UNIT_OF_L**2 / 9), np.float32(NOISE_ENERGY), np.float32(_MOST_ENERGY)
    offset, half, one, two = np.float32(LEVEL_OFFSET), np.float32(0.5), columns[1:], columns[2:]
    slope, triangle = rows.slope, rows.sums[0, 0]
    for x in range(triangle.size - AHEAD):
        value = (columns[x] + one[x] + two[x]) * part + floor
        log = quick_log2(value if value < most else most)
        new = i((log + offset) * unit + half)
        old, twice = i(leaving[x]), i(i(middle[x]) + i(middle[x]))
        rise = i(slope[x] + i(i(new + old) - twice))
        leaving[x] = new
        slope[x] = rise
        triangle[x] = i(triangle[x] + rise)


@inlined_part
def _across(scale: Real, rows: LogRows, level: UInt16s) -> None:
    """Apply the triangle filter along the row and store the level."""
    box(rows.sums[0], rows.pieces, rows.sums[1, 0])
    box(rows.sums[1], rows.pieces, rows.total)
    _as_level(rows.total, scale, level)


@inlined_part
def _as_level(total: Int32s, scale: Real, level: UInt16s) -> None:
    half = np.float32(0.5)
    for x in range(level.size):
        level[x] = np.int32(np.float32(total[x]) * scale + half)
