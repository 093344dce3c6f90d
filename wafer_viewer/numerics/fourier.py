"""Fourier transforms: their lengths, and the autocorrelation of a grid with gaps, without loading Numba."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

# -------------------------------------------------------------------------------------------------------------- fourier


def fast_length(n: int) -> int:
    """Return the smallest length of at least n for which a real Fourier transform is fast."""
    from scipy.fft import next_fast_len

    return next_fast_len(n, real=True) or n


# ------------------------------------------------------------------------------------------------------ autocorrelation


Floats = NDArray[np.float64]
LEAST_PAIRS = 0.05
"""Fraction of the measured points; a lag with fewer pairs has no value."""


def autocorrelation(z: Floats) -> Floats:
    """Return the autocorrelation of z [row, col] with mean 0, for lags up to half of its sides.

    Shape [2 r + 1, 2 c + 1], 1 in the middle. The value of a lag is the mean product over pairs of measured points at
    this lag, divided by the mean square; NaN with fewer pairs than a twentieth of the measured points.
    """
    valid = np.isfinite(z)
    n_valid = int(valid.sum())
    reach = z.shape[0] // 2, z.shape[1] // 2
    products = lagged_products(np.where(valid, z, 0.0), reach)
    pairs = (
        _full_pairs(z.shape, reach) if n_valid == z.size else np.rint(lagged_products(valid.astype(np.float64), reach))
    )
    middle = float(products[reach]) / n_valid
    return np.divide(products / middle, pairs, out=np.full(pairs.shape, np.nan), where=pairs >= LEAST_PAIRS * n_valid)


def lagged_products(plane: Floats, reach: tuple[int, int]) -> Floats:
    """Return the sums of products of points one lag apart, [2 r + 1, 2 c + 1] for lags up to reach (r, c)."""
    from scipy.fft import irfft2, rfft2

    padded = [fast_length(n + r) for n, r in zip(plane.shape, reach, strict=True)]
    spectrum: Any = rfft2(plane, padded)
    power = spectrum.real**2 + spectrum.imag**2
    lags: Any = irfft2(power, padded)
    down, across = reach
    middle = np.roll(lags[:, : across + 1], down, axis=0)[: 2 * down + 1]
    # The same lag backwards has the same pairs.
    return np.hstack([middle[::-1, :0:-1], middle])


def _full_pairs(shape: tuple[int, int], reach: tuple[int, int]) -> Floats:
    """Return the number of pairs per lag of a grid without holes."""
    down, across = (n - np.abs(np.arange(-r, r + 1)) for n, r in zip(shape, reach, strict=True))
    return np.outer(down, across).astype(np.float64)
