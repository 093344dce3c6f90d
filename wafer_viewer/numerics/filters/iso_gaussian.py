"""Gaussian filter of ISO 16610-21 (profiles) and 16610-61 (areas) for grids with unmeasured points."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
    known = np.isfinite(z)
    total, weight = np.where(known, z, 0.0), known.astype(np.float64)
    whole = bool(known.all())
    for axis in range(z.ndim):
        total = _along(total, axis, cutoff_px)
        weight = _border_weight(z.shape, axis, cutoff_px) * weight if whole else _along(weight, axis, cutoff_px)
    return np.divide(total, weight, out=np.full(z.shape, np.nan), where=known)


def weighting(cutoff_px: float) -> Floats:
    """Return the sampled weights from -REACH to REACH cut-offs, with sum one."""
    places = np.arange(-_reach_px(cutoff_px), _reach_px(cutoff_px) + 1)
    weights = np.exp(-np.pi * (places / (ALPHA * cutoff_px)) ** 2)
    return weights / weights.sum()


def fast_length(n: int) -> int:
    """Return the smallest length of at least n for which a real Fourier transform is fast."""
    from scipy.fft import next_fast_len

    return next_fast_len(n, real=True) or n


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
