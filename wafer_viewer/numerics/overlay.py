"""Weighted sums of lattices that lie on a common one, at whole or broken pixels: what a mosaic is blended from."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.jit import inline_kernel, kernel

_MEASURED = 0
_FILLED = 1
_NOT_COVERED = 10


class Sums(NamedTuple):
    """What a window of a mosaic has added up so far, all [row, col]."""

    z: NDArray[np.float32]
    raw: NDArray[np.float32]
    confidence: NDArray[np.float32]
    weight: NDArray[np.float32]
    origin: NDArray[np.uint8]


class Shift(NamedTuple):
    """Pixel (r, c) of a window lies at (r + row + row_part, c + col + col_part) of a field, the parts in 0 ... 1."""

    row: int
    col: int
    row_part: float
    col_part: float


@kernel
def add_heights(z, raw, confidence, origin, shift, row_weights, col_weights, max_step, sums):
    """Add one field to the part of the sums that it covers.

    Where the field lies between the pixels it is read bilinearly, but never across NaN or a step over `max_step`. A
    measured height replaces filled ones and is not mixed with them.
    """
    whole = shift.row_part == 0 and shift.col_part == 0
    for r in range(row_weights.size):
        i = r + shift.row
        for c in range(col_weights.size):
            j = c + shift.col
            p, q = (i, j) if whole else _nearest(i, j, shift)
            code = origin[p, q]
            v = z[p, q] if whole else _between(z, i, j, shift, max_step)
            if v != v:
                if sums.origin[r, c] == _NOT_COVERED:
                    sums.origin[r, c] = code
                continue
            if code == _FILLED and sums.weight[r, c] > 0 and sums.origin[r, c] == _MEASURED:
                continue
            if code == _MEASURED and sums.origin[r, c] != _MEASURED:
                sums.z[r, c] = sums.raw[r, c] = sums.confidence[r, c] = sums.weight[r, c] = 0
            w = row_weights[r] * col_weights[c]
            sums.origin[r, c] = code
            sums.weight[r, c] += w
            sums.z[r, c] += w * v
            sums.raw[r, c] += w * (raw[p, q] if whole else _between(raw, i, j, shift, max_step))
            sums.confidence[r, c] += w * confidence[p, q]


@kernel
def add_picture(picture, shift, row_weights, col_weights, grey, weight):
    """Add the grey of one picture to the part of the sums that it covers, bilinearly between the pixels."""
    last_row, last_col = picture.shape[0] - 1, picture.shape[1] - 1
    s, t = np.float32(shift.row_part), np.float32(shift.col_part)
    for r in range(row_weights.size):
        upper = picture[r + shift.row]
        lower = picture[min(r + shift.row + 1, last_row)]
        for c in range(col_weights.size):
            j = c + shift.col
            k = min(j + 1, last_col)
            above = np.float32(upper[j]) + t * (np.float32(upper[k]) - np.float32(upper[j]))
            below = np.float32(lower[j]) + t * (np.float32(lower[k]) - np.float32(lower[j]))
            w = row_weights[r] * col_weights[c]
            grey[r, c] += w * (above + s * (below - above))
            weight[r, c] += w


@inline_kernel
def _nearest(i, j, shift):
    return i + (1 if shift.row_part > 0.5 else 0), j + (1 if shift.col_part > 0.5 else 0)


@kernel
def _between(z, i, j, shift, max_step):
    """The bilinear value, or the nearest one beside NaN or a step."""
    i1, j1 = min(i + 1, z.shape[0] - 1), min(j + 1, z.shape[1] - 1)
    a, b, c, d = z[i, j], z[i, j1], z[i1, j], z[i1, j1]
    s, t = np.float32(shift.row_part), np.float32(shift.col_part)
    if max(max(a, b), max(c, d)) - min(min(a, b), min(c, d)) <= max_step and a + b + c + d == a + b + c + d:
        above, below = a + t * (b - a), c + t * (d - c)
        return above + s * (below - above)
    p, q = _nearest(i, j, shift)
    return z[p, q]
