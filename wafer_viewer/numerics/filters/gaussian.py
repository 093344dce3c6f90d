"""Gaussian filters that ignore gaps: means at several scales, and those of ISO 16610-21 and 16610-61."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.fourier import fast_length
from wafer_viewer.numerics.jit import Float32s, fast_kernel


def binned(plane: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """Return the sums of factor x factor pixels; an incomplete remainder at the end is omitted."""
    rows, cols = (n // factor * factor for n in plane.shape)
    wide: Any = sum(plane[:rows, k:cols:factor] for k in range(factor))
    both: Any = sum(wide[k::factor] for k in range(factor))
    return both


FINE_PX = 2.9
"""Scales below this are filtered at full resolution; wider ones on blocks of 2, 4, ... pixels."""
LEAST_KNOWN = 0.3
"""Smallest known fraction of the weight for which a mean is defined."""


def coarseness(sigma_px: float) -> int:
    """Return the block size in pixels at which a scale is filtered."""
    return 1 if sigma_px < FINE_PX else 2 ** max(1, math.floor(math.log2(sigma_px / 2)))


def gaussian_sums(filled: Float32s, valid: Float32s, sigma_px: float) -> Float32s:
    """Return Gaussian-weighted sums divided by the square root of the known weight, which makes their noise uniform.

    At borders and around holes a mean of fewer pixels would scatter more. One value per block of `coarseness(sigma_px)`
    pixels, NaN if too little is known. filled: 0 where unknown; valid: 1 or 0.
    """
    side = coarseness(sigma_px)
    value, weight = (filled, valid) if side == 1 else (binned(filled, side), binned(valid, side))
    if sigma_px > 0:
        value, weight = smooth(value, sigma_px / side), np.maximum(0, smooth(weight, sigma_px / side))
    enough = weight >= LEAST_KNOWN * side**2 if sigma_px > 0 else weight > 0
    return np.divide(value, np.sqrt(weight), out=np.full(value.shape, np.nan, np.float32), where=enough)


def smooth(plane: Float32s, sigma_px: float) -> Float32s:
    """Convolve with a Gaussian of sum one, with zeros beyond the border."""
    reach = max(1, math.ceil(3 * sigma_px))
    weights = np.exp(-((np.arange(-reach, reach + 1) / sigma_px) ** 2) / 2)
    weights = (weights / weights.sum()).astype(np.float32)
    padded = np.zeros((plane.shape[0], plane.shape[1] + 2 * reach), np.float32)
    out = np.zeros(plane.shape, np.float32)
    _down_then_along(np.ascontiguousarray(plane), weights, padded, out)
    return out


@fast_kernel
def _down_then_along(plane: Float32s, weights: Float32s, padded: Float32s, out: Float32s) -> None:
    reach, n_rows, n_cols = weights.size // 2, plane.shape[0], plane.shape[1]
    for r in range(n_rows):
        for k in range(max(0, r - reach), min(n_rows, r + reach + 1)):
            w, row, into = weights[k - r + reach], plane[k], padded[r, reach:]
            for x in range(n_cols):
                into[x] += w * row[x]
        for k in range(weights.size):
            w, row, into = weights[k], padded[r, k:], out[r]
            for x in range(n_cols):
                into[x] += w * row[x]


Floats = NDArray[np.float64]
ALPHA = math.sqrt(math.log(2) / math.pi)
"""Filter constant: transmission of half the amplitude at the cut-off wavelength."""
REACH = 1.0
"""Half width of the kernel in cut-offs; the truncated part of the weighting function is under a millionth."""


def gaussian_mean(z: Floats, cutoff_px: float) -> Floats:
    """Return the long-wave component of z [n] or [row, col]; shorter wavelengths are damped to less than half.

    Unmeasured points (NaN) have no weight and stay unmeasured. At borders and around holes the remaining weights are
    normalised to sum to one (moment criterion of order zero, ISO 16610-28).
    """
    valid = np.isfinite(z)
    total, weight = np.where(valid, z, 0.0), valid.astype(np.float64)
    complete = bool(valid.all())
    for axis in range(z.ndim):
        total = _along(total, axis, cutoff_px)
        weight = _border_weight(z.shape, axis, cutoff_px) * weight if complete else _along(weight, axis, cutoff_px)
    return np.divide(total, weight, out=np.full(z.shape, np.nan), where=valid)


def weighting(cutoff_px: float) -> Floats:
    """Return the sampled weights from -REACH to REACH cut-offs, with sum one."""
    places = np.arange(-_reach_px(cutoff_px), _reach_px(cutoff_px) + 1)
    weights = np.exp(-np.pi * (places / (ALPHA * cutoff_px)) ** 2)
    return weights / weights.sum()


def _along(plane: Floats, axis: int, cutoff_px: float) -> Floats:
    """Convolve along one axis, with zeros beyond the border."""
    from scipy.fft import irfft, rfft

    n, reach = plane.shape[axis], _reach_px(cutoff_px)
    padded = fast_length(max(n, reach + 1) + reach)
    kernel = np.zeros(padded)
    kernel[: 2 * reach + 1] = weighting(cutoff_px)
    transfer: Any = rfft(np.roll(kernel, -reach))
    shape = [1] * plane.ndim
    shape[axis] = -1
    spectrum: Any = rfft(plane, padded, axis=axis)
    spectrum *= transfer.reshape(shape)
    smooth: Any = irfft(spectrum, padded, axis=axis)
    return np.asarray(np.take(smooth, range(n), axis=axis) if axis else smooth[:n], np.float64)


def _border_weight(shape: tuple[int, ...], axis: int, cutoff_px: float) -> Floats:
    """Return the remaining weight along one axis if every point is measured."""
    along = [1] * len(shape)
    along[axis] = -1
    return _along(np.ones(shape[axis]), 0, cutoff_px).reshape(along)


def _reach_px(cutoff_px: float) -> int:
    return max(1, math.ceil(REACH * cutoff_px))
