"""Separable resampling of a picture by a windowed sinc of six points (Lanczos).

Shorter kernels smooth more near the middle between two pixels, so drifting frames would alternate between sharp and
blurred.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.array_types import Float32s, Greys, Int64s, Real
from wafer_viewer.numerics.jit import fast_kernel

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

    def seen_from(self, start: int) -> Taps:
        """Return the taps relative to a part of the picture that starts at `start`."""
        return Taps(self.first - start, self.weights)

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
