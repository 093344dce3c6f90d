"""Weighted sums of lattices that lie on a common one, at whole or broken pixels: what a mosaic is blended from."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wafer_viewer.numerics.arrays import Float32s, Greys, Real, UInt8s, Whole
from wafer_viewer.numerics.jit import kernel

_MEASURED = 0
_FILLED = 1
_NOT_COVERED = 10


class Sums(NamedTuple):
    """What a window of a mosaic has added up so far, all [row, col]."""

    z: Float32s
    raw: Float32s
    confidence: Float32s
    weight: Float32s
    origin: UInt8s


class Shift(NamedTuple):
    """Pixel (r, c) of a window lies at (r + row + row_part, c + col + col_part) of a field, the parts in 0 ... 1."""

    row: int
    col: int
    row_part: float
    col_part: float


@kernel
def add_heights(
    z: Float32s,
    raw: Float32s,
    confidence: Float32s,
    origin: UInt8s,
    shift: Shift,
    row_weights: Float32s,
    col_weights: Float32s,
    max_step: Real,
    sums: Sums,
) -> None:
    """Add one field to the part of the sums that it covers.

    Where the field lies between the pixels it is read bilinearly, but never across NaN or a step over `max_step`. A
    measured height replaces filled ones and is not mixed with them.
    """
    n = col_weights.size
    heights, raws, new, kept = (
        np.empty(n, np.float32),
        np.empty(n, np.float32),
        np.empty(n, np.float32),
        np.empty(n, np.float32),
    )
    near_col = shift.col + (1 if shift.col_part > 0.5 else 0)
    for r in range(row_weights.size):
        near_row = r + shift.row + (1 if shift.row_part > 0.5 else 0)
        codes = origin[near_row, near_col : near_col + n]
        _read(z, r, shift, max_step, heights)
        _read(raw, r, shift, max_step, raws)
        _weigh(heights, codes, row_weights[r], col_weights, sums.origin[r], new, kept)
        _add(heights, new, kept, sums.z[r])
        _add(raws, new, kept, sums.raw[r])
        _add(confidence[near_row, near_col : near_col + n], new, kept, sums.confidence[r])
        _add_weight(new, kept, sums.weight[r])


@kernel
def add_picture(
    picture: Greys, shift: Shift, row_weights: Float32s, col_weights: Float32s, grey: Float32s, weight: Float32s
) -> None:
    """Add the grey of one picture to the part of the sums that it covers, bilinearly between the pixels."""
    n = col_weights.size
    ahead = shift.col + (1 if shift.col_part > 0 else 0)
    s, t = np.float32(shift.row_part), np.float32(shift.col_part)
    for r in range(row_weights.size):
        i = r + shift.row
        k = i + (1 if shift.row_part > 0 else 0)
        a, b = picture[i, shift.col : shift.col + n], picture[i, ahead : ahead + n]
        c, d = picture[k, shift.col : shift.col + n], picture[k, ahead : ahead + n]
        _add_grey(a, b, t, row_weights[r] * (np.float32(1) - s), col_weights, grey[r])
        if s > 0:
            _add_grey(c, d, t, row_weights[r] * s, col_weights, grey[r])
        for x in range(n):
            weight[r, x] += row_weights[r] * col_weights[x]


@kernel
def _read(layer: Float32s, r: Whole, shift: Shift, max_step: Real, out: Float32s) -> None:
    """One row of a layer, in the window's pixels."""
    n, i, j = out.size, r + shift.row, shift.col
    if shift.row_part == 0 and shift.col_part == 0:
        out[:] = layer[i, j : j + n]
        return
    k, ahead = i + (1 if shift.row_part > 0 else 0), j + (1 if shift.col_part > 0 else 0)
    near_row, near_col = k if shift.row_part > 0.5 else i, ahead if shift.col_part > 0.5 else j
    nearest = layer[near_row, near_col : near_col + n]
    a, b, c, d = layer[i, j : j + n], layer[i, ahead : ahead + n], layer[k, j : j + n], layer[k, ahead : ahead + n]
    _between(a, b, c, d, nearest, np.float32(shift.row_part), np.float32(shift.col_part), np.float32(max_step), out)


@kernel
def _between(
    a: Float32s,
    b: Float32s,
    c: Float32s,
    d: Float32s,
    nearest: Float32s,
    s: Real,
    t: Real,
    max_step: Real,
    out: Float32s,
) -> None:
    """The bilinear value, or the nearest one beside NaN (which no comparison lets pass) or a step."""
    for x in range(out.size):
        above, below = a[x] + t * (b[x] - a[x]), c[x] + t * (d[x] - c[x])
        flat = (abs(b[x] - a[x]) <= max_step) & (abs(d[x] - c[x]) <= max_step) & (abs(c[x] - a[x]) <= max_step)
        out[x] = above + s * (below - above) if flat else nearest[x]


@kernel
def _weigh(
    heights: Float32s,
    codes: UInt8s,
    row_weight: Real,
    col_weights: Float32s,
    origin: UInt8s,
    new: Float32s,
    kept: Float32s,
) -> None:
    """What the new heights count, what becomes of the old sums (1 kept, 0 replaced), and whose origin it is."""
    for x in range(new.size):
        old, code = origin[x], codes[x]
        there = heights[x] == heights[x]
        taken = there & ((code == _MEASURED) | (old != _MEASURED))
        replaces = taken & (code == _MEASURED) & (old != _MEASURED)
        new[x] = row_weight * col_weights[x] if taken else np.float32(0)
        kept[x] = np.float32(0) if replaces else np.float32(1)
        origin[x] = code if taken | (old == _NOT_COVERED) else old


@kernel
def _add(values: Float32s, new: Float32s, kept: Float32s, total: Float32s) -> None:
    """NaN counts only where it is taken and stays: neither a weight of nothing nor a replaced sum brings it in."""
    for x in range(total.size):
        old = total[x] if kept[x] > 0 else np.float32(0)
        v = values[x] if new[x] > 0 else np.float32(0)
        total[x] = old + new[x] * v


@kernel
def _add_weight(new: Float32s, kept: Float32s, total: Float32s) -> None:
    for x in range(total.size):
        total[x] = kept[x] * total[x] + new[x]


@kernel
def _add_grey(a: Greys, b: Greys, t: Real, row_weight: Real, col_weights: Float32s, grey: Float32s) -> None:
    for x in range(grey.size):
        left = np.float32(a[x])
        grey[x] += row_weight * col_weights[x] * (left + t * (np.float32(b[x]) - left))
