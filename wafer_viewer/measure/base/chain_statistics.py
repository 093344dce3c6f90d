"""Uncertainty of a fit through a chain of points with correlated errors, by block averaging.

Block means are the observations. Blocks are several correlation lengths long, so that their means are independent.
Where neighbouring errors are uncorrelated, the points themselves are the observations.
"""

from __future__ import annotations

import math

import numpy as np

from wafer_viewer.measure.base.height_samples import Floats

PIECE = 3.0
"""Block length, in correlation lengths of the errors."""
MIN_FREEDOM = 4
"""Lower limit of the degrees of freedom; it bounds the block length."""
MOST_LAGS = 200


def chain_uncertainty(design: Floats, residuals: Floats, gradient: Floats) -> float | None:
    """Standard uncertainty of gradient [p] times the parameters of a fit of `design` [n, p], by its residuals [n].

    Rows must be in the order of the chain. Returns None with too few points. The value is widened by Student's t so
    that the expanded uncertainty with k = 2 still covers 95 % with few blocks.
    """
    reach = correlation_length(residuals)
    longest = len(residuals) // (design.shape[1] + MIN_FREEDOM)
    if not longest:
        return None
    length = min(math.ceil(PIECE * reach), longest) if reach > 1 else 1
    pieces = len(residuals) // length
    freedom = pieces - design.shape[1]
    means, left = (_means(a, pieces, length) for a in (design, residuals[:, None]))
    scale = np.where((found := np.sqrt(np.mean(means**2, axis=0))) > 0, found, 1.0)
    inverse = np.linalg.pinv((means / scale).T @ (means / scale), hermitian=True)
    factor = float((gradient / scale) @ inverse @ (gradient / scale))
    return math.sqrt(max(0.0, factor) * float(np.sum(left**2)) / freedom) * _student(freedom) / 2


def correlation_length(residuals: Floats) -> float:
    """Return the correlation length of errors, in points: 1 if uncorrelated (integrated autocorrelation)."""
    n = len(residuals)
    left = residuals - residuals.mean()
    power = float(left @ left)
    if n < 4 or power <= 0:
        return 1.0
    total = 1.0
    for lag in range(1, min(n // 4, MOST_LAGS)):
        share = float(left[:-lag] @ left[lag:]) / power
        if share < 2 / math.sqrt(n):
            break
        total += 2 * share
    return total


def _means(rows: Floats, pieces: int, length: int) -> Floats:
    return rows[: pieces * length].reshape(pieces, length, -1).mean(axis=1)


def _student(freedom: int) -> float:
    """Two-sided 95.45 % point of Student's t, which is 2 for many degrees of freedom."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.97725))
