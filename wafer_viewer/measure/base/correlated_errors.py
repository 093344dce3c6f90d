"""Uncertainty of fits to points with correlated errors, by means of blocks or tiles.

Block means are the observations. Blocks are several correlation lengths long, so that their means are independent.
Where neighbouring errors are uncorrelated, the points themselves are the observations.

The error of a depth map is correlated over the focus window and by the form of the surface itself; the standard error
of single points would be several times too small. Means of tiles larger than the correlation length scatter by their
true error. Tiles of side T still miss the error shared by neighbours, a share that falls as 1/T. Two sizes, one twice
the other, determine that share, and the result is extrapolated to infinitely large tiles.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import Floats, HeightSamples
from wafer_viewer.numerics.normal_statistics import student

PIECE = 3.0
"""Block length, in correlation lengths of the errors."""
MIN_CHAIN_FREEDOM = 4
"""Lower limit of the degrees of freedom; it bounds the block length."""
MOST_LAGS = 200
"""Largest lag of the autocorrelation of errors, in points."""
LOST_CORRELATION = 0.05
"""Correlation of an area's errors, as a mean over a distance, below which it is lost in its own scatter."""


def chain_uncertainty(design: Floats, residuals: Floats, gradient: Floats) -> float | None:
    """Standard uncertainty of gradient [p] times the parameters of a fit of `design` [n, p], by its residuals [n].

    Rows must be in the order of the chain. Returns None with too few points. The value is widened by Student's t so
    that the expanded uncertainty with k = 2 still covers 95 % with few blocks.
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
    return math.sqrt(max(0.0, factor) * float(np.sum(left**2)) / freedom) * student(freedom) / 2


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


def area_correlation(residuals: Floats) -> tuple[Floats, float]:
    """Return the correlation of errors by lag, and the number of independent ones.

    Parameters
    ----------
    residuals : ndarray
        Residuals of a fit to an area [row, col], NaN where there is none.

    Returns
    -------
    correlation : ndarray
        Correlation at each lag, [2 r + 1, 2 c + 1], 1 in the middle; NaN at lags with few pairs.
    independent : float
        Number of residuals over their integrated correlation, which ends at the distance where it is lost.
    """
    from wafer_viewer.numerics.correlation import autocorrelation

    correlation = autocorrelation(residuals)
    down, across = np.indices(correlation.shape) - np.array(correlation.shape)[:, None, None] // 2
    distance = np.rint(np.hypot(down, across)).astype(np.intp)
    known = np.isfinite(correlation)
    sums = np.bincount(distance[known], correlation[known], minlength=distance.max() + 2)
    pairs = np.bincount(distance[known], minlength=distance.max() + 2)
    alike = sums > LOST_CORRELATION * pairs
    end = int(np.argmin(alike))
    return correlation, float(np.isfinite(residuals).sum()) / max(1.0, float(sums[:end].sum()))


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
    freedom = max(1.0, n / length - n_parameters)
    variance = 2 * float(pull[:last] @ covariance[:last]) - float(pull[0] * covariance[0])
    return Scatter(math.sqrt(max(0.0, variance) * (freedom + n_parameters) / freedom), freedom)


def _autocorrelation(row: Floats) -> Floats:
    """Return the sums of products of samples at each lag from 0 to n - 1."""
    size = 2 * len(row)
    spectrum = np.fft.rfft(row, size)
    return np.fft.irfft(np.abs(spectrum) ** 2, size)[: len(row)]


def _means(rows: Floats, pieces: int, length: int) -> Floats:
    return rows[: pieces * length].reshape(pieces, length, -1).mean(axis=1)


SIDES = (16, 8, 4)
"""Tiles along each side of a region; tiles of each entry are twice as large as those of the one before."""
MIN_FILL = 0.25
"""Smallest number of points of a tile that is used, relative to the median tile."""
MIN_FREEDOM = 2
"""Smallest number of degrees of freedom of a covariance from tiles."""
STILL_GROWING = 1.5
"""Ratio of the scatter of double tiles to that of single ones above which the correlation exceeds a tile."""
SURPRISING = 1.75
"""Ratio of the extrapolated uncertainties of larger to smaller tiles above which form is assumed.

Only the larger tiles resolve such form; by chance the ratio is exceeded in one of a hundred cases.
"""
Labels = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Scatter:
    """A standard uncertainty (k = 1) and its degrees of freedom."""

    u: float
    freedom: float

    @property
    def widened(self) -> float:
        """Standard uncertainty widened by Student's t, so that k = 2 covers 95.45 % with few degrees of freedom."""
        return self.u * student(self.freedom) / 2

    @classmethod
    def joined(cls, *parts: Scatter) -> Scatter:
        """Return the uncertainty of a sum of independent parts (Welch-Satterthwaite)."""
        variance = sum(part.u**2 for part in parts)
        if variance == 0:
            return cls(0.0, min(part.freedom for part in parts))
        return cls(math.sqrt(variance), variance**2 / sum(part.u**4 / part.freedom for part in parts))


@dataclass(frozen=True, slots=True, eq=False)
class Tiles:
    """Counts of points per tile, [region, side, side], and sums of the columns, [..., c]."""

    count: NDArray[np.intp]
    sums: Floats

    @classmethod
    def of(cls, points: HeightSamples, columns: Floats, part: Labels | None = None, side: int = SIDES[0]) -> Tiles:
        """Sum columns [n, c] of points over side x side tiles; part: region index of each point, [n]."""
        labels = np.zeros(len(points), np.intp) if part is None else part
        n = int(labels.max(initial=0)) + 1
        cell = (labels * side + _cells(points.y_um, labels, n, side)) * side + _cells(points.x_um, labels, n, side)
        count = np.bincount(cell, minlength=n * side**2)
        sums: Floats = np.stack([np.bincount(cell, column, n * side**2) for column in columns.T], axis=1).astype(float)
        return cls(count.reshape(n, side, side), sums.reshape(n, side, side, -1))

    @property
    def halved(self) -> Tiles:
        """The same points in half as many tiles along each side."""
        n, side = self.count.shape[0], self.count.shape[1] // 2
        blocks = (n, side, 2, side, 2)
        return Tiles(self.count.reshape(blocks).sum(axis=(2, 4)), self.sums.reshape(*blocks, -1).sum(axis=(2, 4)))

    @property
    def means(self) -> Floats:
        """Column means of each sufficiently filled tile, [tile, c]."""
        full = self.count >= max(1.0, MIN_FILL * float(np.median(self.count[self.count > 0])))
        return self.sums[full] / self.count[full][:, None]


def tile_means(points: HeightSamples, residuals: Floats, side: int) -> tuple[HeightSamples, Floats]:
    """Return mean position, height and residual of each of side x side tiles; sparse tiles are omitted."""
    columns = np.stack([points.x_um, points.y_um, points.z_um, residuals], axis=1)
    x_um, y_um, z_um, left = Tiles.of(points, columns, side=side).means.T
    return HeightSamples(x_um, y_um, z_um), left


def parameter_u(points: HeightSamples, design: Floats, residuals: Floats, gradient: Floats) -> float | None:
    """Standard uncertainty of gradient [p] times the parameters of a fit of `design` [n, p], by tiles.

    None with too few tiles. Widened by Student's t so that the expanded uncertainty with k = 2 covers 95 %.
    """
    found = extrapolated_uncertainty(tile_covariances(points, design, residuals), gradient)
    return None if found is None else found.widened


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """Covariance [p, p] of fit parameters, estimated from tiles of one size, and its degrees of freedom."""

    covariance: Floats
    freedom: float

    def scatter(self, gradient: Floats) -> Scatter:
        """Return the uncertainty of gradient [p] times the parameters."""
        return Scatter(math.sqrt(max(0.0, float(gradient @ self.covariance @ gradient))), self.freedom)


def tile_covariances(
    points: HeightSamples, design: Floats, residuals: Floats, part: Labels | None = None
) -> list[Spread]:
    """Return the covariances by tile size, smallest first, for sizes with enough tiles; part: region index."""
    tiles = [Tiles.of(points, np.column_stack([design, residuals]), part)]
    for _ in SIDES[1:]:
        tiles.append(tiles[-1].halved)
    found = (covariance_of_means(each.means) for each in tiles)
    return [spread for spread in found if spread is not None]


def extrapolated_uncertainty(found: Sequence[Spread], gradient: Floats) -> Scatter | None:
    """Return the uncertainty of gradient [p] times the parameters, extrapolated to infinitely large tiles.

    None without tiles. found: covariances by tile size, smallest first, each twice the one before.
    """
    scatters = [spread.scatter(gradient) for spread in found]
    if len(scatters) < 2:
        return scatters[0] if scatters else None
    best = _extrapolated(scatters[0], scatters[1])
    for smallest, small, large in zip(scatters, scatters[1:], scatters[2:], strict=False):
        coarser = _extrapolated(small, large)
        if small.u > STILL_GROWING * smallest.u or coarser.u > SURPRISING * best.u:
            best = coarser
    return best


def _extrapolated(small: Scatter, large: Scatter) -> Scatter:
    """Extrapolate from a pair of tile sizes; never below the value of the larger.

    The variance of means over areas lacks (1 - a/T) for each axis, so u itself goes as 1 - a/T.
    """
    u = 2 * large.u - small.u
    lost = 4 / large.freedom - 3 / small.freedom
    return Scatter(max(u, large.u), 1 / lost if lost > 0 else large.freedom)


def covariance_of_means(means: Floats) -> Spread | None:
    """Return the covariance from tile means [tile, c]; None with too few tiles.

    The columns are those of the design and, last, the residual.
    """
    design, residuals = means[:, :-1], means[:, -1]
    freedom = len(residuals) - design.shape[1]
    if freedom < MIN_FREEDOM:
        return None
    scale = np.sqrt(np.mean(design**2, axis=0))
    scale = np.where(scale > 0, scale, 1.0)
    inverse = np.linalg.pinv((design / scale).T @ (design / scale), hermitian=True)
    return Spread(inverse / np.outer(scale, scale) * float(np.sum(residuals**2)) / freedom, freedom)


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
