"""Uncertainty of fits to points of a line with correlated errors, and means over tiles of areas.

Block means are the observations. Blocks are several correlation lengths long, so that their means are independent.
Where neighbouring errors are uncorrelated, the points themselves are the observations.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import Floats, HeightSamples
from wafer_viewer.model.quantity import coverage_factor, effective_freedom

PIECE = 3.0
"""Block length, in correlation lengths of the errors."""
LOST_PER_PARAMETER = 3
"""Apparent independent errors that each parameter of a fit costs: residuals look less correlated than errors are.

With it, U of level and slopes of planes covers 92 to 96 %: tests/bench/bench_coverage.py, seeds below 1000.
"""
LOST_PER_LINE_PARAMETER = 2
"""The same of a fit to a line, by the same runs."""
LEAST_FREEDOM = 3.0
"""Smallest degrees of freedom: fewer are form, which does not scatter."""
MIN_CHAIN_FREEDOM = 4
"""Lower limit of the degrees of freedom; it bounds the block length."""
MOST_LAGS = 200
"""Largest lag of the autocorrelation of errors, in points."""


def chain_uncertainty(design: Floats, residuals: Floats, gradient: Floats) -> Scatter | None:
    """Uncertainty of gradient [p] times the parameters of a fit of `design` [n, p], by its residuals [n].

    Rows must be in the order of the chain. Returns None with too few points.
    """
    reach = correlation_length(residuals)
    longest = len(residuals) // (design.shape[1] + MIN_CHAIN_FREEDOM)
    if not longest:
        return None
    length = min(math.ceil(PIECE * reach), longest) if reach > 1 else 1
    pieces = len(residuals) // length
    freedom = pieces - design.shape[1]
    means, left = (_means(a, pieces, length) for a in (design, residuals[:, None]))
    scale = np.where((found := np.sqrt(np.mean(means**2, axis=0))) > 0, found, 1.0)
    inverse = np.linalg.pinv((means / scale).T @ (means / scale), hermitian=True)
    factor = float((gradient / scale) @ inverse @ (gradient / scale))
    return Scatter(math.sqrt(max(0.0, factor) * float(np.sum(left**2)) / freedom), freedom)


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


def functional_scatter(weights: Floats, residuals: Floats, n_parameters: int) -> Scatter | None:
    """Uncertainty of a weighted sum of values on a line, by the covariance of the residuals along all of it.

    Parameters
    ----------
    weights : ndarray
        Weight of each sample in the sum [n], 0 where it does not contribute; samples are equally spaced.
    residuals : ndarray
        Residuals [n] of a fit to the line, NaN where there is none.
    n_parameters : int
        Number of parameters of that fit.

    Returns
    -------
    Scatter or None
        Standard uncertainty with its degrees of freedom, the number of independent residuals less the parameters; None
        with no more residuals than parameters.

    Notes
    -----
    A part of the line that is shorter than the correlation length does not show its own error: its residuals are alike.
    The covariance is therefore that of the whole line, up to the lag at which it is lost in its own scatter. The fit
    has removed a share of it, which is returned by the degrees of freedom.
    """
    known = np.isfinite(residuals)
    n = int(known.sum())
    if n <= n_parameters:
        return None
    left = np.where(known, residuals, 0.0)
    pairs, power, pull = (_autocorrelation(row) for row in (known.astype(float), left, weights))
    covariance = power / np.maximum(np.round(pairs), 1.0)
    if covariance[0] <= 0:
        return Scatter(0.0, n - n_parameters)
    noise = covariance < 2 / math.sqrt(n) * covariance[0]
    last = int(noise.argmax()) if noise.any() else len(covariance)
    length = 2 * float(covariance[:last].sum()) / float(covariance[0]) - 1
    freedom = max(LEAST_FREEDOM, n / length - LOST_PER_LINE_PARAMETER * n_parameters)
    variance = 2 * float(pull[:last] @ covariance[:last]) - float(pull[0] * covariance[0])
    return Scatter(math.sqrt(max(0.0, variance) * (freedom + n_parameters) / freedom), freedom)


def _autocorrelation(row: Floats) -> Floats:
    """Return the sums of products of samples at each lag from 0 to n - 1."""
    size = 2 * len(row)
    spectrum = np.fft.rfft(row, size)
    return np.fft.irfft(np.abs(spectrum) ** 2, size)[: len(row)]


def _means(rows: Floats, pieces: int, length: int) -> Floats:
    return rows[: pieces * length].reshape(pieces, length, -1).mean(axis=1)


TILES = 16
"""Tiles along each side of a region."""
MIN_FILL = 0.25
"""Smallest number of points of a tile or cell that is used, relative to the median one."""
Labels = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Scatter:
    """A standard uncertainty (k = 1) that was evaluated from scatter, and its degrees of freedom."""

    u: float
    freedom: float

    @property
    def expanded(self) -> float:
        """Expanded uncertainty: covers 95.45 % with few degrees of freedom too."""
        return coverage_factor(self.freedom) * self.u

    @staticmethod
    def largest(parts: Iterable[Scatter]) -> Scatter:
        """Return the one with the largest expanded uncertainty."""
        return max(parts, key=lambda part: part.expanded)

    def times(self, factor: float) -> Scatter:
        """Return the uncertainty of a multiple."""
        return Scatter(abs(factor) * self.u, self.freedom)

    @classmethod
    def joined(cls, *parts: Scatter | float) -> Scatter:
        """Return the uncertainty of a sum of independent parts; a plain number has no finite degrees of freedom."""
        known = [(part.u, part.freedom) if isinstance(part, Scatter) else (part, None) for part in parts]
        u, freedom = math.hypot(*(u for u, _ in known)), effective_freedom(known)
        if u == 0:
            return cls(0.0, min((freedom for _, freedom in known if freedom is not None), default=math.inf))
        return cls(u, math.inf if freedom is None else freedom)


@dataclass(frozen=True, slots=True, eq=False)
class Tiles:
    """Counts of points per tile, [region, side, side], and sums of the columns, [..., c]."""

    count: NDArray[np.intp]
    sums: Floats

    @classmethod
    def of(cls, points: HeightSamples, columns: Floats, part: Labels | None = None, side: int = TILES) -> Tiles:
        """Sum columns [n, c] of points over side x side tiles; part: region index of each point, [n]."""
        labels = np.zeros(len(points), np.intp) if part is None else part
        n = int(labels.max(initial=0)) + 1
        cell = (labels * side + _cells(points.y_um, labels, n, side)) * side + _cells(points.x_um, labels, n, side)
        count = np.bincount(cell, minlength=n * side**2)
        sums: Floats = np.stack([np.bincount(cell, column, n * side**2) for column in columns.T], axis=1).astype(float)
        return cls(count.reshape(n, side, side), sums.reshape(n, side, side, -1))

    @property
    def means(self) -> Floats:
        """Column means of each sufficiently filled tile, [tile, c]."""
        full = well_filled(self.count)
        return self.sums[full] / self.count[full][:, None]


def well_filled(count: NDArray[np.integer] | Floats) -> NDArray[np.bool_]:
    """Return the mask of the tiles or cells that hold enough points for their means to count."""
    return count >= max(1.0, MIN_FILL * float(np.median(count[count > 0])))


def _cells(coordinate: Floats, labels: Labels, n: int, side: int) -> Labels:
    """Return the tile index of each point along one axis, from 0, within the range of its own region."""
    if n == 1:
        return _between(coordinate, float(coordinate.min()), float(coordinate.max()), side)
    low, high = np.full(n, np.inf), np.full(n, -np.inf)
    np.minimum.at(low, labels, coordinate)
    np.maximum.at(high, labels, coordinate)
    return _between(coordinate, low[labels], high[labels], side)


def _between(coordinate: Floats, low: Floats | float, high: Floats | float, side: int) -> Labels:
    wide = np.maximum(np.subtract(high, low), 1e-12)
    return np.minimum(((coordinate - low) / wide * side).astype(np.intp), side - 1)
