"""Gaussian means of a picture with unknown pixels at several scales; wide scales use binned pixels."""

from __future__ import annotations

import math

import numpy as np

from wafer_viewer.numerics.array_types import Float32s
from wafer_viewer.numerics.filters.binning import binned
from wafer_viewer.numerics.jit import fast_kernel

FINE_PX = 2.9
"""Scales below this are filtered at full resolution; wider ones on blocks of 2, 4, ... pixels."""
LEAST_KNOWN = 0.3
"""Smallest known fraction of the weight for which a mean is defined."""


def coarseness(sigma_px: float) -> int:
    """Return the block size in pixels at which a scale is filtered."""
    return 1 if sigma_px < FINE_PX else 2 ** max(1, math.floor(math.log2(sigma_px / 2)))


def gaussian_sums(filled: Float32s, known: Float32s, sigma_px: float) -> Float32s:
    """Return Gaussian-weighted sums divided by the square root of the known weight, which makes their noise uniform.

    At borders and around holes a mean of fewer pixels would scatter more. One value per block of `coarseness(sigma_px)`
    pixels, NaN if too little is known. filled: 0 where unknown; known: 1 or 0.
    """
    side = coarseness(sigma_px)
    value, weight = (filled, known) if side == 1 else (binned(filled, side), binned(known, side))
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
