"""Smoothing of height maps: Levy flights of the paper (eq. 7-14), two denoising variants, and the default.

Taken literally the equations cannot remove noise: a flight is accepted when it comes nearer to the noisy map itself, so
the noisy map is the optimum. `guided` flies towards the median of the neighbourhood instead, and only where a pixel
stands out from it; `switching_median` is the deterministic end point of those flights. Both leave the noise of all
other pixels unchanged. `sigma_filter` also averages that noise, over the neighbours that agree with a pixel (after Lee
1983), and it detects outliers along lines instead of squares, so that corners and narrow ridges are preserved. Where
averages flatten crests and troughs by more than noise moves them, what they removed is smoothed and added again
(twicing, Tukey 1977).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.recipe import Levy
from wafer_viewer.numerics.filters.denoising import (
    LINE_REACH_PX,
    beside_lines,
    line_medians_at,
    line_outliers,
    median_outliers,
    medians_at,
    pad_with_nan,
    pair_mean,
)
from wafer_viewer.numerics.filters.sliding_filters import mean_of_valid
from wafer_viewer.numerics.jit import Float32s, Real, lean_kernel
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA, median

NOISE_LAG_PX = 15
"""Distance at which errors are nearly independent: they share little of a focus window."""

_GUIDE_RENEWED_EVERY = 5
"""Number of rounds of flights towards the same medians."""
_SAMPLE_EVERY_PX = 5
"""Stride at which deviations from the median are sampled, in pixels."""
_SPIKE_PASSES = 3
"""Largest number of passes over the spikes in a round."""
_MANY_SPIKES = 0.25
"""Largest fraction of pixels that are spikes; more cannot be repaired."""
_LEAST_STEPS = 0.05
"""Smallest noise limit, in steps of the resolution."""

Map = NDArray[np.float32]
Rounds = Callable[[Map, Levy, float], Iterator[Map]]


def smooth(z_um: Map, levy: Levy, resolution_um: float) -> Map:
    """Return a smoothed copy of a map, by a settled `Levy`; NaN stays NaN.

    resolution_um: axial resolution of the optics. A deviation below a twentieth of it is never an outlier, however
    quiet the map; a deviation above it always is, however much of the map is false.
    """
    if levy.mode == "sigma_filter":
        limit_um = _limit_um(height_noise_um(z_um), levy, resolution_um)
        reference = _without_spikes(z_um, limit_um)
        return _with_curvature(reference, list(islice(_averages(reference, limit_um), int(levy.iterations))), limit_um)
    rounds = islice(SMOOTHERS[levy.mode](z_um, levy, resolution_um), int(levy.iterations))
    return deque(rounds, maxlen=1)[0].copy()


def flight_lengths(rng: np.random.Generator, count: int, beta: float) -> NDArray[np.float32]:
    """Return |Z| of eq. 7, Z = U / |V|^(1 / beta), with the deviation of U from eq. 8 (Mantegna 1994)."""
    top = math.gamma(1 + beta) * math.sin(math.pi * beta / 2)
    bottom = math.gamma((1 + beta) / 2) * beta * 2 ** ((beta - 1) / 2)
    deviation = np.float32((top / bottom) ** (1 / beta))
    u = np.abs(rng.standard_normal(count, np.float32))
    v = np.abs(rng.standard_normal(count)).astype(np.float32)  # single precision would draw a zero now and then
    return (u * deviation / v ** np.float32(1 / beta)).astype(np.float32, copy=False)


def height_noise_um(z_um: Map) -> float:
    """Return the robust standard deviation of height errors from second differences, insensitive to slopes."""
    bends = bends_of(z_um)
    return MAD_TO_SIGMA * median(np.abs(bends)) if bends.size else 0.0


def bends_of(z_um: Map) -> NDArray[np.float32]:
    """Return second differences over `NOISE_LAG_PX` along both axes, scaled to the deviation of one pixel."""
    lag, found = NOISE_LAG_PX, list[NDArray[np.float32]]()
    for z in (z_um, z_um.T):
        lines = z[:: 1 + len(z) // 200]
        bends = lines[:, : -2 * lag] - 2 * lines[:, lag:-lag] + lines[:, 2 * lag :]
        found.append(bends[np.isfinite(bends)] / np.float32(math.sqrt(6)))
    return np.concatenate(found)


def _unsmoothed(z_um: Map, levy: Levy, resolution_um: float) -> Iterator[Map]:
    yield z_um


def _literal(z_um: Map, levy: Levy, resolution_um: float) -> Iterator[Map]:
    """Yield eq. 10-14 as published: move the map (12), accept if its mean square distance to z_um falls (14).

    Flights accumulate: an accepted map is the start of the next flight. chi (13) is one number for the entire map.
    """
    rng = np.random.default_rng(levy.seed)
    measured = np.isfinite(z_um)
    start, out = z_um[measured], z_um.copy()
    away = _flights(rng, start.size, levy)
    chi = _mean_square(away)
    out[measured] = start + away
    yield out
    while True:
        candidate = away + _flights(rng, start.size, levy)
        new_chi = _mean_square(candidate)
        if new_chi < chi:
            away, chi = candidate, new_chi
            out[measured] = start + away
        yield out


def _flights(rng: np.random.Generator, count: int, levy: Levy) -> NDArray[np.float32]:
    """Return L_d = alpha sign(R) |Z| of eq. 10 and 11."""
    signs = np.sign(rng.standard_normal(count, np.float32))
    return np.float32(levy.alpha) * signs * flight_lengths(rng, count, levy.beta)


def _mean_square(values: NDArray[np.float32]) -> float:
    return float(np.mean(np.square(values), dtype=np.float64)) if values.size else 0.0


def _guided(z_um: Map, levy: Levy, resolution_um: float) -> Iterator[Map]:
    """Move outliers along their distance to the median; a flight is accepted if it ends nearer to it."""
    rng = np.random.default_rng(levy.seed)
    padded = pad_with_nan(z_um)
    limit = _limit_about_median(padded, z_um, levy, resolution_um)
    inner = padded[2:-2, 2:-2]
    while True:
        rows, cols = np.nonzero(median_outliers(padded, limit))
        guide, values = medians_at(padded, rows, cols), inner[rows, cols]
        for _ in range(_GUIDE_RENEWED_EVERY):
            candidate = values + _flights(rng, values.size, levy) * (values - guide)
            values = np.where(np.abs(candidate - guide) < np.abs(values - guide), candidate, values)
            inner[rows, cols] = values
            yield inner


def _switching_median(z_um: Map, levy: Levy, resolution_um: float) -> Iterator[Map]:
    """Replace outliers by the median of their neighbourhood, until none is left."""
    padded = pad_with_nan(z_um)
    limit = _limit_about_median(padded, z_um, levy, resolution_um)
    inner = padded[2:-2, 2:-2]
    while True:
        rows, cols = np.nonzero(median_outliers(padded, limit))
        inner[rows, cols] = medians_at(padded, rows, cols)
        yield inner
        if not rows.size:
            return


def _limit_about_median(padded: Map, z_um: Map, levy: Levy, resolution_um: float) -> np.float32:
    """Return the noise limit about the median: n_sigma deviations, by the median deviation of sampled pixels."""
    rows, cols = np.nonzero(np.isfinite(z_um[::_SAMPLE_EVERY_PX, ::_SAMPLE_EVERY_PX]))
    if not rows.size:
        return np.float32(np.inf)
    rows, cols = rows * _SAMPLE_EVERY_PX, cols * _SAMPLE_EVERY_PX
    away = np.abs(z_um[rows, cols] - medians_at(padded, rows, cols))
    return np.float32(_limit_um(MAD_TO_SIGMA * median(away), levy, resolution_um))


def _sigma_filter(z_um: Map, levy: Levy, resolution_um: float) -> Iterator[Map]:
    """Replace outliers along all lines by their median, then average each pixel with agreeing neighbours."""
    limit_um = _limit_um(height_noise_um(z_um), levy, resolution_um)
    yield from _averages(_without_spikes(z_um, limit_um), limit_um)


def _averages(z_um: Map, limit_um: float) -> Iterator[Map]:
    """Yield the rounds of averages of a map without spikes."""
    while True:
        yield (averaged := pair_mean(z_um, limit_um))
        z_um = _without_spikes(averaged, limit_um)


@dataclass(frozen=True, slots=True)
class CurvatureParameters:
    """Limits from which flattened curvature is added again, and how often: tests/truth/relief.py.

    Parameters
    ----------
    significance : float
        Root mean square of the systematic move by all rounds, relative to the random move by one round, from which it
        is restored; restored completely at sqrt 2 times that. Noise on a plane reaches a quarter to half of it.
    window_px : int, px
        Side of the square in which the mean square is taken.
    passes : int
        Number of corrections.
    """

    significance: float = 0.5
    window_px: int = 15
    passes: int = 2


CURVATURE = CurvatureParameters()


def _with_curvature(reference: Map, rounds: Sequence[Map], limit_um: float) -> Map:
    """Return the last round of averages of `reference`, with the crests and troughs that the rounds have flattened."""
    smoothed, random = rounds[-1], np.abs(reference - rounds[0])
    valid = np.isfinite(random)
    if not valid.any():
        return smoothed
    limit = (CURVATURE.significance * MAD_TO_SIGMA * median(random[valid])) ** 2
    share: Map | None = None
    for _ in range(CURVATURE.passes):
        removed = np.empty(smoothed.shape, np.float32)
        _subtract(reference, smoothed, np.float32(len(rounds) * limit_um), removed)
        for _ in rounds:
            removed = pair_mean(removed, limit_um)
        if share is None:
            squares = np.empty(removed.shape, np.float32)
            _square(removed, squares)
            share = mean_of_valid(squares, valid, CURVATURE.window_px)
            share /= np.float32(max(limit, _LEAST_ENERGY_UM2))
            share -= np.float32(1)
            np.clip(share, np.float32(0), np.float32(1), out=share)
        restored = np.empty(removed.shape, np.float32)
        _restore(smoothed, share, removed, restored)
        smoothed = restored
        if not share.any():
            break
    return smoothed


@lean_kernel
def _square(removed: Float32s, squares: Float32s) -> None:
    """Write the squares of what was removed, 0 where it is not known."""
    for r in range(removed.shape[0]):
        for x in range(removed.shape[1]):
            move = removed[r, x]
            squares[r, x] = move * move if move == move else np.float32(0)


@lean_kernel
def _restore(smoothed: Float32s, share: Float32s, removed: Float32s, restored: Float32s) -> None:
    """Add a share of what was removed, where it is known."""
    for r in range(removed.shape[0]):
        for x in range(removed.shape[1]):
            move = removed[r, x]
            restored[r, x] = smoothed[r, x] + share[r, x] * (move if move == move else np.float32(0))


@lean_kernel
def _subtract(reference: Float32s, smoothed: Float32s, most: Real, removed: Float32s) -> None:
    """Write what was removed, NaN where it is more than all rounds of averages move."""
    for r in range(removed.shape[0]):
        for x in range(removed.shape[1]):
            move = reference[r, x] - smoothed[r, x]
            removed[r, x] = np.float32(np.nan) if abs(move) > most else move


_LEAST_ENERGY_UM2 = 1e-12
"""Mean square of the moves that counts as no noise at all."""


def _limit_um(noise_um: float, levy: Levy, resolution_um: float) -> float:
    return float(np.clip(float(levy.n_sigma) * noise_um, _LEAST_STEPS * resolution_um, resolution_um))


def _without_spikes(z_um: Map, limit_um: float) -> Map:
    """Remove adjacent spikes in several passes; stop where there are too many to repair.

    A later pass tests only pixels with a replaced one on a line through them: the others see what they saw before.
    """
    padded = np.pad(z_um, LINE_REACH_PX, constant_values=np.nan)
    inner, near = padded[LINE_REACH_PX:-LINE_REACH_PX, LINE_REACH_PX:-LINE_REACH_PX], None
    for _ in range(_SPIKE_PASSES):
        rows, cols = np.divmod(np.flatnonzero(line_outliers(padded, limit_um, near)), z_um.shape[1])
        if rows.size > _MANY_SPIKES * z_um.size:
            break
        inner[rows, cols] = line_medians_at(padded, rows, cols)
        if not rows.size:
            break
        near = beside_lines(rows, cols, z_um.shape)
    return np.ascontiguousarray(inner)


SMOOTHERS: dict[str, Rounds] = {
    "none": _unsmoothed,
    "literal": _literal,
    "guided": _guided,
    "switching_median": _switching_median,
    "sigma_filter": _sigma_filter,
}
"""Each yields the map after one round, after two, and so on; it may reuse the same memory."""
