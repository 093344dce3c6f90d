"""Resampling of the layers of a surface: affine, at a subpixel shift, and by a windowed sinc.

Heights are interpolated bilinearly, and only between measured pixels: gaps are not filled.

Shorter kernels smooth more near the middle between two pixels, so drifting frames would alternate between sharp and
blurred.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.jit import (
    Float32s,
    Float64s,
    Greys,
    Int,
    Int64s,
    Real,
    UInt8s,
    fast_kernel,
    kernel,
    lean_kernel,
    lean_part,
)

_NOT_COVERED = 10
"""Code of a pixel that no field covers, `Origin.NOT_COVERED`."""
_ON_PIXEL = 1e-4
"""Distance in pixels below which a position counts as on a pixel and its neighbours are ignored."""


class ResampledLayers(NamedTuple):
    """Layers of a surface, all [row, col]."""

    z: Float32s
    raw: Float32s
    confidence: Float32s
    grey: Greys
    origin: UInt8s


@kernel
def resample_affine(source: ResampledLayers, motion: Float64s, out: ResampledLayers) -> None:
    """Fill `out` with the source at (row, col) = motion [2, 3] @ (1, out row, out col); not covered beyond its border.

    A height is unmeasured if a pixel with weight is, with that pixel's reason, and filled if one of them is filled. Its
    confidence is the smallest of theirs.
    """
    n_rows, n_cols = source.z.shape
    for r in range(out.z.shape[0]):
        for c in range(out.z.shape[1]):
            y = motion[0, 0] + motion[0, 1] * r + motion[0, 2] * c
            x = motion[1, 0] + motion[1, 1] * r + motion[1, 2] * c
            i, j = int(y + 1.0) - 1, int(x + 1.0) - 1
            v, u = y - i, x - j
            if v > 1 - _ON_PIXEL:
                i, v = i + 1, 0.0
            if u > 1 - _ON_PIXEL:
                j, u = j + 1, 0.0
            v = 0.0 if v < _ON_PIXEL else v
            u = 0.0 if u < _ON_PIXEL else u
            below, right = i + (1 if v > 0 else 0), j + (1 if u > 0 else 0)
            if y < -_ON_PIXEL or x < -_ON_PIXEL or i < 0 or j < 0 or below >= n_rows or right >= n_cols:
                out.z[r, c] = out.raw[r, c] = float("nan")
                out.confidence[r, c] = 0
                out.grey[r, c] = 0
                out.origin[r, c] = _NOT_COVERED
                continue
            a, b, p, q = (1 - v) * (1 - u), (1 - v) * u, v * (1 - u), v * u
            out.z[r, c] = (
                a * source.z[i, j] + b * source.z[i, right] + p * source.z[below, j] + q * source.z[below, right]
            )
            out.raw[r, c] = (
                a * source.raw[i, j]
                + b * source.raw[i, right]
                + p * source.raw[below, j]
                + q * source.raw[below, right]
            )
            out.confidence[r, c] = min(
                min(source.confidence[i, j], source.confidence[i, right]),
                min(source.confidence[below, j], source.confidence[below, right]),
            )
            out.grey[r, c] = int(
                a * source.grey[i, j]
                + b * source.grey[i, right]
                + p * source.grey[below, j]
                + q * source.grey[below, right]
                + 0.5
            )
            worst = max(
                max(source.origin[i, j], source.origin[i, right]),
                max(source.origin[below, j], source.origin[below, right]),
            )
            out.origin[r, c] = worst


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
    layer: Float32s, shift: Shift, leaning: TiltedField, max_step: Real, out: Float32s, row: Int, col: Int
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


REACH = 3
"""Points on each side of a position."""


@dataclass(frozen=True, slots=True, eq=False)
class Taps:
    """The six taps around each of n positions along an axis: index of the first, and weights [tap, position]."""

    first: NDArray[np.int64]
    weights: NDArray[np.float32]

    @classmethod
    def at(cls, places: NDArray[np.float64]) -> Taps:
        """Return the taps around positions, which must ascend."""
        floor = np.floor(places)
        parts, of_place = np.unique((places - floor).round(4), return_inverse=True)
        away = parts - np.arange(1 - REACH, REACH + 1)[:, None]
        weights = np.sinc(away) * np.sinc(away / REACH)
        weights = (weights / weights.sum(axis=0)).astype(np.float32)
        return cls(floor.astype(np.int64) + 1 - REACH, np.ascontiguousarray(weights[:, of_place]))

    @property
    def span(self) -> tuple[int, int]:
        """First point of all, and one past the last."""
        return int(self.first[0]), int(self.first[-1]) + 2 * REACH


def resampled(picture: Greys, rows: Taps, cols: Taps) -> Greys:
    """Resample a picture at the positions rows x cols, rounded to its dtype; border pixels are replicated."""
    part = _edge_padded(_edge_padded(picture, rows.span, 0), cols.span, 1)
    out = np.empty((len(rows.first), len(cols.first)), picture.dtype)
    line = np.empty(part.shape[1], np.float32)
    most = np.float32(np.iinfo(picture.dtype).max)
    row_first, col_first = rows.first - rows.span[0], cols.first - cols.span[0]
    _resample(part, row_first, rows.weights, col_first, cols.weights, most, line, out)
    return out


def _edge_padded(picture: Greys, span: tuple[int, int], axis: int) -> Greys:
    """Return the pixels of a span along an axis, replicating border pixels outside the picture."""
    length = picture.shape[axis]
    if span[0] >= 0 and span[1] <= length:
        return picture[span[0] : span[1]] if axis == 0 else picture[:, span[0] : span[1]]
    return picture.take(np.arange(*span).clip(0, length - 1), axis=axis)


@fast_kernel
def _resample(
    part: Greys,
    row_first: Int64s,
    row_weights: Float32s,
    col_first: Int64s,
    col_weights: Float32s,
    most: Real,
    line: Float32s,
    out: Greys,
) -> None:
    for r in range(out.shape[0]):
        _down(part[row_first[r] :], row_weights[:, r], line)
        start = 0
        while start < col_first.size:
            stop = _run(col_first, start)
            _along(line[col_first[start] :], col_weights[:, start:stop], most, out[r, start:stop])
            start = stop


@fast_kernel
def _down(part: Greys, weights: Float32s, line: Float32s) -> None:
    a, b, c, d, e, f = part[0], part[1], part[2], part[3], part[4], part[5]
    u, v, w, p, q, s = weights[0], weights[1], weights[2], weights[3], weights[4], weights[5]
    for x in range(line.size):
        above = u * np.float32(a[x]) + v * np.float32(b[x]) + w * np.float32(c[x])
        line[x] = above + p * np.float32(d[x]) + q * np.float32(e[x]) + s * np.float32(f[x])


@fast_kernel
def _run(first: Int64s, start: int) -> int:
    """Return the end of a run of consecutive columns, over which the loop can be vectorised."""
    stop = start + 1
    while stop < first.size and first[stop] - first[start] == stop - start:
        stop += 1
    return stop


@fast_kernel
def _along(line: Float32s, weights: Float32s, most: Real, out: Greys) -> None:
    a, b, c, d, e, f = weights[0], weights[1], weights[2], weights[3], weights[4], weights[5]
    for x in range(out.size):
        left = a[x] * line[x] + b[x] * line[x + 1] + c[x] * line[x + 2]
        right = d[x] * line[x + 3] + e[x] * line[x + 4] + f[x] * line[x + 5]
        value = left + right + np.float32(0.5)
        out[x] = np.int32(min(most, max(np.float32(0), value)))
