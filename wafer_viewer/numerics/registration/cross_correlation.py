"""How alike two pictures are at every whole shift: normalised correlation of the pixels that both know.

Source: D. Padfield, Masked object registration in the Fourier domain, IEEE Trans. Image Process. 21 (2012) 2706,
for pictures whose local mean was taken away.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.array_types import Bools, Float32s

_STEEPEST = 3.0
"""Contrast counts up to about three times its usual size: one bright spot must not speak for the whole overlap."""


@dataclass(frozen=True, slots=True, eq=False)
class Likeness:
    """What is known of a square of lags, all [lag row, lag col].

    correlation: -1 ... 1, 0 where too few pixels are common; pixels: how many are; sigmas: how far the correlation is
    above what two unlike pictures with as much structure would reach, in standard deviations.
    """

    correlation: NDArray[np.float64]
    pixels: NDArray[np.float64]
    sigmas: NDArray[np.float64]


def contrast(picture: Float32s, known: Bools, size: int) -> Float32s:
    """The picture less its local mean of size x size pixels, strong contrast held down; 0 where it is not known.

    It does not change, but for its scale, when the picture gets brighter or darker as a whole or slowly across.
    """
    from wafer_viewer.numerics.filters.sliding_filters import mean, mean_of_known

    local = mean(picture, size) if known.all() else mean_of_known(picture, known, size)
    detail = np.where(known, picture - local, np.float32(0))
    usual = _STEEPEST * float(np.median(np.abs(detail[known][::3]))) if known.any() else 0.0
    held: Float32s = np.sqrt(1 + (detail / np.float32(usual)) ** 2) if usual > 0 else np.ones_like(detail)
    return np.asarray(detail / held, np.float32)


def likeness(
    first: Float32s, first_known: Bools, second: Float32s, second_known: Bools, lag: tuple[int, int], reach: int
) -> Likeness:
    """Compare two contrasts at all lags within `reach` of a lag (rows, cols).

    At a lag, pixel (r, c) of the second lies on pixel (r + lag row, c + lag col) of the first. What is unknown is 0.
    """
    import scipy.fft

    shape = _room(first.shape, second.shape, lag, reach)
    size: list[int] = [scipy.fft.next_fast_len(n, real=True) or n for n in shape]
    a: Any = scipy.fft.rfft2(_moments(first, first_known), size)
    b: Any = scipy.fft.rfft2(_moments(second, second_known), size)
    products = np.stack([a[0] * b[0].conj(), a[1] * b[2].conj(), a[2] * b[1].conj(), a[2] * b[2].conj()])
    sums: Any = scipy.fft.irfft2(products, size)
    rows, cols = (np.arange(n - reach, n + reach + 1) % m for n, m in zip(lag, size, strict=True))
    common, of_first, of_second, pixels = (s[np.ix_(rows, cols)].astype(np.float64) for s in sums)
    pixels = np.rint(pixels)
    energy = np.sqrt(np.maximum(of_first, 0) * np.maximum(of_second, 0))
    floor = 1e-3 * float(energy.max(initial=0)) + 1e-12
    correlation = np.where(energy > floor, common / np.maximum(energy, floor), 0.0).clip(-1, 1)
    alike = _alike_pixels(sums[0], first, second)
    sigmas = np.arctanh(correlation.clip(-0.9999, 0.9999)) * np.sqrt(pixels / alike)
    return Likeness(correlation, pixels, sigmas)


def _room(first: tuple[int, ...], second: tuple[int, ...], lag: tuple[int, int], reach: int) -> tuple[int, int]:
    """The smallest torus on which no lag within reach meets a pixel twice."""
    rows, cols = (max(a, a - n + reach, b, b + n + reach) for a, b, n in zip(first, second, lag, strict=True))
    return rows, cols


def _moments(picture: Float32s, known: Bools) -> Float32s:
    return np.stack([picture, picture * picture, known.astype(np.float32)])


def _alike_pixels(common: Float32s, first: Float32s, second: Float32s) -> float:
    """How many pixels tell as much as one independent one (Bartlett): the sum of both autocorrelations' product.

    It is the mean square of the correlation over all shifts, which structure that goes on over many pixels makes large.
    """
    energy = float(np.vdot(first, first)) * float(np.vdot(second, second))
    return max(1.0, float(np.vdot(common, common)) / energy) if energy > 0 else 1.0
