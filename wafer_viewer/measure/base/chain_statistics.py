"""How sure a fit through a chain of points is when neighbours err alike: pieces of the chain are the observations.

The pieces are several times as long as the errors are found to be alike, so their means are independent; where the
errors of neighbours have nothing in common the points themselves are taken.
"""

from __future__ import annotations

import math

import numpy as np

from wafer_viewer.measure.base.height_samples import Floats

PIECE = 3.0
"""Length of a piece, in lengths over which errors are alike."""
MIN_FREEDOM = 4
"""No piece is so long that fewer degrees of freedom are left."""
MOST_LAGS = 200


def chain_u(design: Floats, residuals: Floats, gradient: Floats) -> float | None:
    """Standard uncertainty of gradient [p] times the parameters of a fit of `design` [n, p] by its residuals [n].

    Rows in the order of the chain. None with too few points to tell. It is widened by Student's t so that an
    expansion by k = 2 still covers 95 % with few pieces.
    """
    reach = alike(residuals)
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


def alike(residuals: Floats) -> float:
    """Over how many points errors are alike: 1 where neighbours have nothing in common (integrated autocorrelation)."""
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
