"""Reading of field layers at a subpixel shift, with correction of offset and tilt."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wafer_viewer.numerics.array_types import Float32s, Greys, Real, Whole
from wafer_viewer.numerics.jit import lean_kernel, lean_part


class Shift(NamedTuple):
    """Subpixel shift: pixel (r, c) of a piece is at (r + row + row_part, c + col + col_part) of a field.

    The parts are in 0 ... 1.
    """

    row: int
    col: int
    row_part: float
    col_part: float


class TiltedField(NamedTuple):
    """Correction subtracted from the heights at (r, c) of a piece: rows[r] + cols[c] + up[r] * right[c]."""

    rows: Float32s
    cols: Float32s
    up: Float32s
    right: Float32s


@lean_kernel
def read_heights(
    layer: Float32s, shift: Shift, leaning: TiltedField, max_step: Real, out: Float32s, row: Whole, col: Whole
) -> None:
    """Read the heights of a field into `out` from (row, col) on, in the size of `leaning`.

    Between pixels they are interpolated bilinearly, but not next to NaN or across a step over `max_step`.
    """
    n = leaning.cols.size
    s, t, limit = np.float32(shift.row_part), np.float32(shift.col_part), np.float32(max_step)
    ahead = shift.col + (1 if t > 0 else 0)
    near = ahead if t > 0.5 else shift.col
    for r in range(leaning.rows.size):
        i = r + shift.row
        k = i + (1 if s > 0 else 0)
        nearest = layer[k if s > 0.5 else i, near : near + n]
        target = out[row + r, col : col + n]
        base, up = leaning.rows[r], leaning.up[r]
        if s == 0 and t == 0:
            _subtract_tilt(nearest, base, up, leaning.cols, leaning.right, target)
        else:
            a, b = layer[i, shift.col : shift.col + n], layer[i, ahead : ahead + n]
            c, d = layer[k, shift.col : shift.col + n], layer[k, ahead : ahead + n]
            _interpolate_row(a, b, c, d, nearest, s, t, limit, base, up, leaning.cols, leaning.right, target)


@lean_kernel
def read_grey(picture: Greys, shift: Shift, out: Float32s) -> None:
    """Read the grey values of a picture at the pixels of a piece, interpolated bilinearly."""
    n = out.shape[1]
    ahead = shift.col + (1 if shift.col_part > 0 else 0)
    s, t = np.float32(shift.row_part), np.float32(shift.col_part)
    for r in range(out.shape[0]):
        i = r + shift.row
        k = i + (1 if shift.row_part > 0 else 0)
        a, b = picture[i, shift.col : shift.col + n], picture[i, ahead : ahead + n]
        c, d = picture[k, shift.col : shift.col + n], picture[k, ahead : ahead + n]
        _grey_between(a, b, c, d, s, t, out[r])


@lean_part
def _subtract_tilt(heights: Float32s, base: Real, up: Real, cols: Float32s, right: Float32s, out: Float32s) -> None:
    for x in range(out.size):
        out[x] = heights[x] - (base + cols[x] + up * right[x])


@lean_part
def _interpolate_row(
    a: Float32s,
    b: Float32s,
    c: Float32s,
    d: Float32s,
    nearest: Float32s,
    s: Real,
    t: Real,
    limit: Real,
    base: Real,
    up: Real,
    cols: Float32s,
    right: Float32s,
    out: Float32s,
) -> None:
    """Corrected bilinear value, or the nearest one next to NaN (which fails every comparison) or a step."""
    for x in range(out.size):
        above, below = a[x] + t * (b[x] - a[x]), c[x] + t * (d[x] - c[x])
        flat = (abs(b[x] - a[x]) <= limit) & (abs(d[x] - c[x]) <= limit) & (abs(c[x] - a[x]) <= limit)
        value = above + s * (below - above) if flat else nearest[x]
        out[x] = value - (base + cols[x] + up * right[x])


@lean_part
def _grey_between(a: Greys, b: Greys, c: Greys, d: Greys, s: Real, t: Real, out: Float32s) -> None:
    for x in range(out.size):
        left, below = np.float32(a[x]), np.float32(c[x])
        above = left + t * (np.float32(b[x]) - left)
        out[x] = above + s * (below + t * (np.float32(d[x]) - below) - above)
