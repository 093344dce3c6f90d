"""Prediction of the z range in focus of every field from a coarse look at a few of them, with its uncertainty.

Two models are fitted. On a smooth sample, the lowest and the highest z in focus of a field are kriged over the stage.
On a sample with steps longer than a field, the parts of a field are predicted from the nearest parts of the places
around, weighted by an inverse power of their distance, and the disagreement of these places is the uncertainty: near a
step the window becomes as long as the step, away from it the window stays short.

Both are checked by leaving out one place after the other: where the windows of the places that were left out do not
hold the heights found there, all deviations are scaled up. The smooth model is used unless the windows of the other
are clearly shorter.

Heights are a polynomial trend, a Gaussian process (Matern 5/2) and scatter. Correlation length and share of the scatter
are averaged over a lattice by their restricted likelihood, and the variance is estimated from the residuals, so that
few places give wide intervals [1]_.

References
----------
.. [1] Handcock, M. S. & Stein, M. L. (1993). A Bayesian analysis of kriging. Technometrics 35, 403-410.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.plan import FocusPlace
from wafer_viewer.model.errors import RigError

# -------------------------------------------------------------------------------------------------------------- kriging


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


# -------------------------------------------------------------------------------------------------------------- surface


Floats = NDArray[np.float64]
NEIGHBOURS = 8
"""Number of places around that predict the parts of a field."""
POWER = 6.0
"""Power of the distance by which they are weighted: beyond a nearer place, others hardly count."""
COVERED = 0.954
"""Share of the fields whose heights lie within two standard uncertainties."""
CLEARLY_SHORTER = 0.75
"""Mean length of the windows over that of the smooth model under which a sample counts as stepped."""
FOLDS = 16
"""Largest number of groups in which places are left out."""
CHUNK = 20_000
"""Number of fields that are predicted at once."""
CELL_ROWS, CELL_COLS = 3, 4
"""Parts of a field."""


@dataclass(frozen=True, slots=True, eq=False)
class FocusRange:
    """Predicted z range in focus of fields [field], with the standard uncertainty of its ends."""

    low_um: Floats
    high_um: Floats
    u_low_um: Floats
    u_high_um: Floats

    def reach(self, factor: float) -> tuple[Floats, Floats]:
        """Return the lowest and the highest z, farther out by `factor` standard uncertainties."""
        return self.low_um - factor * self.u_low_um, self.high_um + factor * self.u_high_um

    @property
    def mean_length_um(self) -> float:
        """Mean length of the windows at twice the uncertainty."""
        low_um, high_um = self.reach(2)
        return float(np.mean(high_um - low_um))

    def scaled(self, factor: float) -> FocusRange:
        """Return the same range with other uncertainties."""
        return FocusRange(self.low_um, self.high_um, factor * self.u_low_um, factor * self.u_high_um)


def predicted_ranges(
    places: Sequence[FocusPlace], x_um: Floats, y_um: Floats, field_um: tuple[float, float]
) -> FocusRange:
    """Return the predicted range in focus of fields by the places of a coarse look.

    Parameters
    ----------
    places : sequence of FocusPlace
        Places of the look; those without a focus are left out.
    x_um, y_um : float64 [field]
        Centres of the fields, um.
    field_um : tuple of float
        Width and height of a field, um.

    Returns
    -------
    FocusRange
        Range of heights in focus within each field.

    Raises
    ------
    RigError
        If no place has a focus.
    """
    found = [place for place in places if place.found]
    if not found:
        raise RigError("The coarse look found no focus: look again with a longer sweep or other light.")
    centers_um = np.stack([x_um, y_um], axis=-1)
    smooth, stepped = (_predicted(fit, found, field_um, centers_um) for fit in (_Smooth, _Stepped))
    return stepped if stepped.mean_length_um < CLEARLY_SHORTER * smooth.mean_length_um else smooth


def _predicted(
    fit: type[_Smooth] | type[_Stepped],
    places: Sequence[FocusPlace],
    field_um: tuple[float, float],
    centers_um: Floats,
) -> FocusRange:
    """Return the ranges by one model, with calibrated uncertainties."""
    model = fit(places, field_um)
    parts = [model.ranges(centers_um[i : i + CHUNK]) for i in range(0, len(centers_um), CHUNK)]
    columns = ((part.low_um, part.high_um, part.u_low_um, part.u_high_um) for part in parts)
    return FocusRange(*map(np.concatenate, zip(*columns, strict=True))).scaled(_factor(fit, places, field_um))


class _Smooth:
    """Kriging of the ends of whole fields."""

    def __init__(self, places: Sequence[FocusPlace], field_um: tuple[float, float]) -> None:
        at_um = np.array([(place.x_um, place.y_um) for place in places])
        ends_um = np.array([(place.low_um, place.high_um) for place in places])
        self._kriging = Kriging(at_um, ends_um, np.array([place.u_um for place in places]))

    def ranges(self, centers_um: Floats) -> FocusRange:
        """Return the ranges of fields by their centres [field, 2]."""
        ends_um, u_um = self._kriging.predict(centers_um)
        return FocusRange(ends_um[:, 0], ends_um[:, 1], u_um[:, 0], u_um[:, 1])


@dataclass(frozen=True, eq=False)
class _Stepped:
    """Parts of fields by the nearest parts of the places around."""

    places: Sequence[FocusPlace]
    field_um: tuple[float, float]

    def ranges(self, centers_um: Floats) -> FocusRange:
        """Return the ranges of fields by their centres [field, 2]."""
        at_um = centers_um[:, None] + part_centres(*self.field_um)
        shape = at_um.shape[:2]
        ends_um, u_um = (each.reshape(*shape, 2) for each in self._predict(at_um.reshape(-1, 2)))
        low = (ends_um - 2 * u_um)[..., 0].argmin(1)
        high = (ends_um + 2 * u_um)[..., 1].argmax(1)
        field = np.arange(len(centers_um))
        return FocusRange(ends_um[field, low, 0], ends_um[field, high, 1], u_um[field, low, 0], u_um[field, high, 1])

    @cached_property
    def _parts(self) -> tuple[Floats, Floats]:
        """Centres [place, part, 2] and ranges [place, part, 2] of the parts in focus; NaN for others."""
        n_parts = max(len(place.cells) for place in self.places)
        cells = np.full((len(self.places), n_parts, 4), np.nan)
        for i, place in enumerate(self.places):
            cells[i, : len(place.cells)] = [(cell.x_um, cell.y_um, cell.low_um, cell.high_um) for cell in place.cells]
        return cells[..., :2], cells[..., 2:]

    @cached_property
    def _centers(self) -> tuple[Floats, Floats]:
        """Centres [place, 2] and uncertainties [place]."""
        return np.array([(p.x_um, p.y_um) for p in self.places]), np.array([p.u_um for p in self.places])

    def _predict(self, at_um: Floats) -> tuple[Floats, Floats]:
        """Return the ends and their uncertainties [n, 2] at positions [n, 2]."""
        (parts_um, ranges_um), (centers_um, u_um) = self._parts, self._centers
        n_near = min(NEIGHBOURS, len(self.places))
        away = np.hypot(*(at_um[:, None] - centers_um).transpose(2, 0, 1))
        near = np.argpartition(away, n_near - 1, axis=1)[:, :n_near]
        gaps = np.hypot(*(parts_um[near] - at_um[:, None, None]).transpose(3, 0, 1, 2))
        part = np.nanargmin(gaps, axis=2)
        values = ranges_um[near, part]
        softened = np.take_along_axis(gaps, part[..., None], 2)[..., 0] ** 2 + (0.1 * self.field_um[1]) ** 2
        weights = softened ** (-POWER / 2)
        weights /= weights.sum(1, keepdims=True)
        mean = (weights[..., None] * values).sum(1)
        spread2 = (weights[..., None] * (values - mean[:, None]) ** 2).sum(1)
        return mean, np.sqrt(spread2 + (weights * u_um[near] ** 2).sum(1, keepdims=True))


def _factor(fit: type[_Smooth] | type[_Stepped], places: Sequence[FocusPlace], field_um: tuple[float, float]) -> float:
    """Return the factor of the deviations, at least 1, at which COVERED of the left out places are held."""
    left_out = ((fit(rest, field_um), some) for rest, some in _left_out(places))
    factors = [_needed(model.ranges(np.array([(p.x_um, p.y_um) for p in some])), some) for model, some in left_out]
    if not factors:
        return 1.0
    ordered = np.sort(np.concatenate(factors))
    n, rank = len(ordered), int(np.ceil(COVERED * (len(ordered) + 1)))
    return max(1.0, float(ordered[rank - 1]) if rank <= n else float(ordered[-1]) * (1 + 1 / n))


def _needed(ranges: FocusRange, places: Sequence[FocusPlace]) -> Floats:
    """Return the factor of the deviations at which the window at twice the uncertainty holds each place."""
    low = (ranges.low_um - [place.low_um for place in places]) / (2 * ranges.u_low_um)
    high = ([place.high_um for place in places] - ranges.high_um) / (2 * ranges.u_high_um)
    return np.maximum(np.maximum(low, high), 0.0)


def _left_out(places: Sequence[FocusPlace]) -> Iterable[tuple[list[FocusPlace], list[FocusPlace]]]:
    """Yield the other places and those left out, one at a time or, of many, several together."""
    n_folds = min(FOLDS, len(places)) if len(places) > 1 else 0
    for fold in range(n_folds):
        yield [place for i, place in enumerate(places) if i % n_folds != fold], list(places[fold::n_folds])


def part_centres(width_um: float, height_um: float) -> Floats:
    """Return the centres [part, 2] of the parts of a field relative to its centre, um."""
    x_um = ((np.arange(CELL_COLS) + 0.5) / CELL_COLS - 0.5) * width_um
    y_um = (0.5 - (np.arange(CELL_ROWS) + 0.5) / CELL_ROWS) * height_um
    return np.stack(np.meshgrid(x_um, y_um), axis=-1).reshape(-1, 2)
