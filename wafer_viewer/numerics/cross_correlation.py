"""Masked cross-correlation of two pictures.

Source: D. Padfield, Masked object registration in the Fourier domain, IEEE Trans. Image Process. 21 (2012) 2706,
for pictures with the local mean removed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.jit import Float32s, Float64s, Int64s, lean_kernel
from wafer_viewer.numerics.normal_statistics import median

_STEEPEST = 3.0
"""Contrast saturates at about three times its typical value, so that one bright spot does not dominate the overlap."""

_MOST_CORRELATION = 0.9999
"""Correlation at which the Fisher transform is clipped, which is infinite at 1."""
_LEAST_ENERGY = 1e-3
"""Smallest contrast energy of an overlap for a correlation, relative to the largest one over all lags."""


@dataclass(frozen=True, slots=True, eq=False)
class Likeness:
    """Correlation over a square of lags, all [lag row, lag col].

    correlation: -1 ... 1, 0 with too few common pixels; pixels: number of common pixels; sigmas: excess of the
    correlation over that of two unrelated pictures with equal structure, in standard deviations.
    """

    correlation: NDArray[np.float64]
    pixels: NDArray[np.float64]
    sigmas: NDArray[np.float64]


def contrast(picture: NDArray[np.float32], valid: NDArray[np.bool_], size: int) -> NDArray[np.float32]:
    """Return the picture minus its local mean of size x size pixels, with saturated contrast; 0 where unknown.

    Invariant, except for scale, to uniform or slowly varying changes of brightness.
    """
    from wafer_viewer.numerics.filters.sliding_filters import mean, mean_of_valid

    local = mean(picture, size) if valid.all() else mean_of_valid(picture, valid, size)
    detail = np.where(valid, picture - local, np.float32(0))
    usual = _STEEPEST * median(np.abs(detail[valid][::3])) if valid.any() else 0.0
    held: NDArray[np.float32] = np.sqrt(1 + (detail / np.float32(usual)) ** 2) if usual > 0 else np.ones_like(detail)
    return np.asarray(detail / held, np.float32)


def normalised_cross_correlation(
    first: NDArray[np.float32],
    first_valid: NDArray[np.bool_],
    second: NDArray[np.float32],
    second_valid: NDArray[np.bool_],
    lag: tuple[int, int],
    reach: int,
) -> Likeness:
    """Correlate two contrast images at all lags within `reach` of a lag (rows, cols).

    At a lag, pixel (r, c) of the second is at pixel (r + lag row, c + lag col) of the first. Unknown pixels are 0.
    """
    import scipy.fft

    shape = _transform_shape(first.shape, second.shape, lag, reach)
    size: list[int] = [scipy.fft.next_fast_len(n, real=True) or n for n in shape]
    full = bool(first_valid.all() and second_valid.all())
    a: Any = scipy.fft.rfft2(first[None] if full else _moments(first, first_valid), size)
    b: Any = scipy.fft.rfft2(second[None] if full else _moments(second, second_valid), size)
    products = a * b.conj() if full else _products(a, b.conj())
    sums: Any = scipy.fft.irfft2(products, size)
    rows, cols = (np.arange(n - reach, n + reach + 1) for n in lag)
    common, *others = (s[np.ix_(rows % size[0], cols % size[1])].astype(np.float64) for s in sums)
    first_sums, second_sums, pixels = _sums_of_rectangles(first, second, rows, cols) if full else others
    pixels = np.rint(pixels)
    energy = np.sqrt(np.maximum(first_sums, 0) * np.maximum(second_sums, 0))
    floor = _LEAST_ENERGY * float(energy.max(initial=0)) + 1e-12
    correlation = np.where(energy > floor, common / np.maximum(energy, floor), 0.0).clip(-1, 1)
    n_correlated = _correlated_pixels(sums[0], first, second)
    sigmas = np.arctanh(correlation.clip(-_MOST_CORRELATION, _MOST_CORRELATION)) * np.sqrt(pixels / n_correlated)
    return Likeness(correlation, pixels, sigmas)


def _transform_shape(
    first: tuple[int, ...], second: tuple[int, ...], lag: tuple[int, int], reach: int
) -> tuple[int, int]:
    """Return the smallest size without wrap-around at any lag within reach."""
    rows, cols = (max(a, a - n + reach, b, b + n + reach) for a, b, n in zip(first, second, lag, strict=True))
    return rows, cols


def _products(first: Any, second: Any) -> Any:
    return np.stack([first[0] * second[0], first[1] * second[2], first[2] * second[1], first[2] * second[2]])


def _sums_of_rectangles(
    first: NDArray[np.float32], second: NDArray[np.float32], rows: NDArray[np.intp], cols: NDArray[np.intp]
) -> tuple[NDArray[np.float64], ...]:
    """Return the sums of squares of both pictures, and the pixels, in the common rectangle at each lag."""
    (top, bottom), (left, right) = (
        (begun := np.clip(lags, 0, n), np.maximum(begun, np.minimum(n, m + lags)))
        for lags, n, m in zip((rows, cols), first.shape, second.shape, strict=True)
    )
    n_rows, n_cols = second.shape
    of_second = (
        [np.clip(row - rows, 0, n_rows) for row in (top, bottom)],
        [np.clip(col - cols, 0, n_cols) for col in (left, right)],
    )
    pixels = np.outer(bottom - top, right - left).astype(np.float64)
    return _sums_between(first, [top, bottom], [left, right]), _sums_between(second, *of_second), pixels


def _sums_between(
    picture: NDArray[np.float32], rows: list[NDArray[np.intp]], cols: list[NDArray[np.intp]]
) -> NDArray[np.float64]:
    """Return the sums of squares over all ranges of rows and cols, [row range, col range]."""
    summed = np.zeros((picture.shape[0] + 1, picture.shape[1] + 1))
    out = np.empty((len(rows[0]), len(cols[0])))
    _fill_sums_between(picture, rows[0], rows[1], cols[0], cols[1], summed, out)
    return out


@lean_kernel
def _fill_sums_between(
    picture: Float32s, tops: Int64s, bottoms: Int64s, lefts: Int64s, rights: Int64s, summed: Float64s, out: Float64s
) -> None:
    """Fill the sums by those of all rectangles from the corner; summed: room for these, with zeros along both edges."""
    for r in range(picture.shape[0]):
        row, above = summed[r + 1], summed[r]
        for c in range(picture.shape[1]):
            value = float(picture[r, c])
            row[c + 1] = above[c + 1] + value * value
    for r in range(1, summed.shape[0]):
        row = summed[r]
        for c in range(1, row.size):
            row[c] += row[c - 1]
    for r in range(out.shape[0]):
        upper, lower = summed[tops[r]], summed[bottoms[r]]
        for c in range(out.shape[1]):
            out[r, c] = (lower[rights[c]] - upper[rights[c]]) - (lower[lefts[c]] - upper[lefts[c]])


def _moments(picture: NDArray[np.float32], valid: NDArray[np.bool_]) -> NDArray[np.float32]:
    return np.stack([picture, picture * picture, valid.astype(np.float32)])


def _correlated_pixels(common: NDArray[np.float32], first: NDArray[np.float32], second: NDArray[np.float32]) -> float:
    """Return the number of pixels equivalent to one independent pixel, after Bartlett.

    It is the sum of the product of both autocorrelations, which equals the mean square of the correlation over all
    shifts. It is large for structures that extend over many pixels.
    """
    energy = float(np.vdot(first, first)) * float(np.vdot(second, second))
    return max(1.0, float(np.vdot(common, common)) / energy) if energy > 0 else 1.0
