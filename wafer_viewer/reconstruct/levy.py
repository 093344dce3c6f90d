"""Smoothing by Levy flights, eq. 7-14 of the paper, and the two forms of it that take noise away.

Taken literally the equations cannot remove noise: a flight is kept when it comes nearer to the noisy map itself, so
the noisy map is the best there is. `guided` flies towards the median of the neighbourhood instead, and only where a
pixel stands out from it; `switching_median` is where those flights end, without chance.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.recipe import Levy
from wafer_viewer.numerics.median import far_from_median, medians_at, pad_with_nan

AUTO_ITERATIONS = {"none": 1, "literal": 30, "guided": 30, "switching_median": 6}
_GUIDE_RENEWED_EVERY = 5
_NOISE_SPREADS = 3.0
_MAD_TO_DEVIATION = 1.4826
_SAMPLE_EVERY_PX = 5

Map = NDArray[np.float32]
Smoother = Callable[[Map, Levy, int, float], Map]


def smooth(z_um: Map, levy: Levy, iterations: int, least_um: float) -> Map:
    """A smoothed copy of a map; NaN stays NaN. What is within least_um of its neighbourhood is never touched."""
    return SMOOTHERS[levy.mode](z_um, levy, iterations, least_um)


def flight_lengths(rng: np.random.Generator, count: int, beta: float) -> NDArray[np.float64]:
    """|Z| of eq. 7, Z = U / |V|^(1 / beta), with the deviation of U from eq. 8 (Mantegna 1994)."""
    top = math.gamma(1 + beta) * math.sin(math.pi * beta / 2)
    bottom = math.gamma((1 + beta) / 2) * beta * 2 ** ((beta - 1) / 2)
    deviation = max(top / bottom, 0.0) ** (1 / beta)
    u, v = rng.standard_normal(count) * deviation, rng.standard_normal(count)
    return np.abs(u) / np.maximum(np.abs(v), 1e-12) ** (1 / beta)


def _unsmoothed(z_um: Map, levy: Levy, iterations: int, least_um: float) -> Map:
    return z_um.copy()


def _literal(z_um: Map, levy: Levy, iterations: int, least_um: float) -> Map:
    """Eq. 10-14 word for word: the whole map flies, and stays where its mean square distance to z_um falls."""
    rng = np.random.default_rng(levy.seed)
    measured = np.isfinite(z_um)
    start = z_um[measured].astype(np.float64)
    now, misfit = start + _flights(rng, start.size, levy), math.inf
    for _ in range(iterations):
        candidate = now + _flights(rng, start.size, levy)
        if misfit == math.inf:
            misfit = float(np.mean((start - now) ** 2))
        new_misfit = float(np.mean((start - candidate) ** 2))
        if new_misfit < misfit:
            now, misfit = candidate, new_misfit
    out = z_um.copy()
    out[measured] = now
    return out


def _flights(rng: np.random.Generator, count: int, levy: Levy) -> NDArray[np.float64]:
    """L_d = alpha sign(R) |Z| of eq. 10 and 11."""
    return levy.alpha * np.sign(rng.standard_normal(count)) * flight_lengths(rng, count, levy.beta)


def _guided(z_um: Map, levy: Levy, iterations: int, least_um: float) -> Map:
    """Pixels that stand out fly along their distance to the median; a flight counts when it ends nearer to it."""
    rng = np.random.default_rng(levy.seed)
    padded = pad_with_nan(z_um)
    limit = _limit(padded, z_um, least_um)
    inner = padded[2:-2, 2:-2]
    for done in range(0, iterations, _GUIDE_RENEWED_EVERY):
        rows, cols = np.nonzero(far_from_median(padded, limit))
        if not rows.size:
            break
        guide = medians_at(padded, rows, cols).astype(np.float64)
        values = inner[rows, cols].astype(np.float64)
        for _ in range(min(_GUIDE_RENEWED_EVERY, iterations - done)):
            candidate = values + _flights(rng, values.size, levy) * (values - guide)
            values = np.where(np.abs(candidate - guide) < np.abs(values - guide), candidate, values)
        inner[rows, cols] = values
    return inner.copy()


def _switching_median(z_um: Map, levy: Levy, iterations: int, least_um: float) -> Map:
    """Pixels that stand out take the median of their neighbourhood, until none is left or the passes are done."""
    padded = pad_with_nan(z_um)
    limit = _limit(padded, z_um, least_um)
    inner = padded[2:-2, 2:-2]
    for _ in range(iterations):
        rows, cols = np.nonzero(far_from_median(padded, limit))
        if not rows.size:
            break
        inner[rows, cols] = medians_at(padded, rows, cols)
    return inner.copy()


def _limit(padded: Map, z_um: Map, least_um: float) -> np.float32:
    """How far from the median noise goes: three deviations, by the median deviation of a sample of the pixels."""
    rows, cols = np.nonzero(np.isfinite(z_um[::_SAMPLE_EVERY_PX, ::_SAMPLE_EVERY_PX]))
    if not rows.size:
        return np.float32(np.inf)
    rows, cols = rows * _SAMPLE_EVERY_PX, cols * _SAMPLE_EVERY_PX
    away = np.abs(z_um[rows, cols] - medians_at(padded, rows, cols))
    return np.float32(max(_NOISE_SPREADS * _MAD_TO_DEVIATION * float(np.median(away)), least_um))


SMOOTHERS: dict[str, Smoother] = {
    "none": _unsmoothed,
    "literal": _literal,
    "guided": _guided,
    "switching_median": _switching_median,
}
