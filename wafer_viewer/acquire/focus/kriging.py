"""Kriging of the ends of the range in focus: a smooth surface with the uncertainty of its prediction.

Heights are a polynomial trend, a Gaussian process (Matern 5/2) and scatter. Correlation length and share of the scatter
are averaged over a lattice by their restricted likelihood, and the variance is estimated from the residuals, so that
few places give wide intervals [1]_.

References
----------
.. [1] Handcock, M. S. & Stein, M. L. (1993). A Bayesian analysis of kriging. Technometrics 35, 403-410.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
LENGTHS = tuple(np.geomspace(0.08, 3.0, 6).tolist())
"""Candidate correlation lengths as shares of the extent."""
SCATTERS = (1e-4, 1e-2, 0.1, 0.5)
"""Candidate variances of the scatter as shares of that of the surface."""
PLACES_FOR_DEGREE = ((8, 2), (5, 1), (1, 0))
"""Smallest number of places for a trend of a degree, the highest degree first."""
NEGLIGIBLE = 1e-3
"""Share of the likelihood under which a candidate is left out."""


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    length: float
    weight: float
    inverse: Floats
    inverse_terms: Floats
    covariance_of_trend: Floats
    residual_weights: Floats
    trend: Floats
    variance: Floats
    scatter: float


class Kriging:
    """Prediction of values [n, end] at positions [n, 2] in um, with known standard uncertainties [n]."""

    def __init__(self, at_um: Floats, values: Floats, u_um: Floats) -> None:
        self._center, self._size = at_um.mean(0), max(float(np.ptp(at_um, axis=0).max()), 1.0)
        self._at = (at_um - self._center) / self._size
        self._degree = next(degree for least, degree in PLACES_FOR_DEGREE if len(at_um) >= least)
        self._floor = float(np.mean(u_um**2))
        terms = _terms(self._degree, self._at)
        gaps = _gaps(self._at, self._at)
        fitted = [self._fit(gaps, terms, values, length, scatter) for length in LENGTHS for scatter in SCATTERS]
        best = max(likelihood for likelihood, _ in fitted)
        shares = [float(np.exp(likelihood - best)) for likelihood, _ in fitted]
        total = sum(shares)
        self._candidates = [
            _Candidate(weight=share / total, **parts)
            for share, (_, parts) in zip(shares, fitted, strict=True)
            if share > NEGLIGIBLE
        ]

    def predict(self, at_um: Floats) -> tuple[Floats, Floats]:
        """Return values and standard deviations [n, end] at positions [n, 2]."""
        at = (at_um - self._center) / self._size
        terms, gaps = _terms(self._degree, at), _gaps(at, self._at)
        total = sum(one.weight for one in self._candidates)
        mean = square = np.zeros((len(at), 1))
        for one in self._candidates:
            value, variance = self._of(one, terms, gaps)
            mean = mean + one.weight / total * value
            square = square + one.weight / total * (variance + value**2)
        return mean, np.sqrt(np.maximum(square - mean**2, self._floor))

    def _fit(self, gaps: Floats, terms: Floats, values: Floats, length: float, scatter: float) -> tuple[float, dict]:
        """Return the restricted log-likelihood of a candidate and what its predictions need."""
        n, n_terms = terms.shape
        covariance = _matern(gaps / length) + (scatter + 1e-9) * np.eye(n)
        inverse = np.linalg.inv(covariance)
        inverse_terms = inverse @ terms
        normal = terms.T @ inverse_terms
        covariance_of_trend = np.linalg.pinv(normal)
        trend = covariance_of_trend @ (inverse_terms.T @ values)
        residual = values - terms @ trend
        weights = inverse @ residual
        freedom = max(n - n_terms, 1)
        variance = np.maximum((residual * weights).sum(0) / freedom, self._floor)
        log_determinants = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(normal + 1e-9 * np.eye(n_terms))[1]
        likelihood = -0.5 * float(np.sum(freedom * np.log(variance) + log_determinants))
        inflated = variance * freedom / max(freedom - 2, 0.5)
        parts = {
            "length": length,
            "inverse": inverse,
            "inverse_terms": inverse_terms,
            "covariance_of_trend": covariance_of_trend,
            "residual_weights": weights,
            "trend": trend,
            "variance": inflated,
            "scatter": scatter,
        }
        return likelihood, parts

    def _of(self, one: _Candidate, terms: Floats, gaps: Floats) -> tuple[Floats, Floats]:
        """Return the values and variances of one candidate."""
        near = _matern(gaps / one.length)
        value = terms @ one.trend + near @ one.residual_weights
        off = terms - near @ one.inverse_terms
        share = 1 + one.scatter - ((near @ one.inverse) * near).sum(1)
        share = np.maximum(share, 0) + ((off @ one.covariance_of_trend) * off).sum(1)
        return value, share[:, None] * one.variance


def _matern(gaps: Floats) -> Floats:
    scaled = np.sqrt(5) * gaps
    return (1 + scaled + scaled**2 / 3) * np.exp(-scaled)


def _gaps(a: Floats, b: Floats) -> Floats:
    return np.hypot(a[:, None, 0] - b[None, :, 0], a[:, None, 1] - b[None, :, 1])


def _terms(degree: int, at: Floats) -> Floats:
    x, y = at[:, 0], at[:, 1]
    return np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=-1)
