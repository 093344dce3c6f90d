"""Cleaning of gated heights: smoothing, removal of outliers and step edges, filling; and `auto` parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.recipe import Levy, Recipe
from wafer_viewer.numerics.filters.connected_components import small_components
from wafer_viewer.reconstruct.cleaning.gap_fill import fill
from wafer_viewer.reconstruct.cleaning.levy_flight import SMOOTHERS, bends_of, flight_lengths, height_noise_um, smooth
from wafer_viewer.reconstruct.cleaning.outliers import find_outliers
from wafer_viewer.reconstruct.cleaning.step_edges import JUMP_STEPS, height_range_um

OUTLIER_FLOOR_STEPS = 1.5

MOST_ROUNDS = {"none": 1, "literal": 30, "guided": 30, "switching_median": 6, "sigma_filter": 2}
"""Maximum rounds per smoother. Two rounds of averages reach 8 px.

A structure 20 px wide, the smallest to trust at a window of 9, then retains its height.
"""

_LEAST_GAIN = 1e-4
_N_SIGMAS = (3.0, 3.5, 4.0, 4.5)
_MORE_THAN_NOISE = 2.0
_FLIGHTS_TRIED = 20_001
_LEAST_FLIGHT_STEPS = 0.05

Map = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Cleaned:
    """A cleaned map and the masks of removed heights.

    z_um: smoothed, without removed heights, filled; raw_um: only without removed heights. outlier, step_edge: reason of
    removal, bool [row, col].
    """

    z_um: Map
    raw_um: Map
    outlier: NDArray[np.bool_]
    step_edge: NDArray[np.bool_]


def clean(
    z_um: Map,
    pixel_um: float,
    recipe: Recipe,
    resolution_um: float,
    told_apart: NDArray[np.bool_] | None = None,
    bled_um: Map | None = None,
) -> Cleaned:
    """Clean a gated map, NaN where unmeasured, by a settled recipe.

    resolution_um: axial resolution of the optics, the reference for steps of the surface; told_apart: mask of pixels
    with a known wall side, None if step edges are not requested; bled_um: heights rejected because light bled there,
    NaN elsewhere: measured heights that continue from them also lie next to a jump.
    """
    smoothed = smooth(z_um, recipe.levy, resolution_um)
    outlier = find_outliers(z_um, smoothed, pixel_um, recipe)
    raw, step_edge = np.where(outlier, np.float32(np.nan), z_um), np.zeros(z_um.shape, np.bool_)
    if told_apart is not None:
        step_edge = _step_edges(raw, bled_um, recipe, resolution_um) & ~told_apart
        raw[step_edge] = np.nan
        if step_edge.any():
            outlier |= _leftovers(raw, recipe, resolution_um) & ~told_apart
            raw[outlier] = np.nan
    smoothed[outlier | step_edge] = np.nan
    return Cleaned(fill(smoothed, recipe.fill, resolution_um), raw, outlier, step_edge)


def _step_edges(z_um: Map, bled_um: Map | None, recipe: Recipe, resolution_um: float) -> NDArray[np.bool_]:
    """Return a mask of heights with another surface within about half a window."""
    seen_um = z_um if bled_um is None else np.where(np.isnan(z_um), bled_um, z_um)
    return (height_range_um(seen_um, int(recipe.window)) > JUMP_STEPS * resolution_um) & np.isfinite(z_um)


def _leftovers(z_um: Map, recipe: Recipe, resolution_um: float) -> NDArray[np.bool_]:
    """Return a mask of small remnants after the removal of step edges, which shrinks pieces by half a window.

    A sliver of a slope caused by bleeding light may look flat by itself, and is smaller than the focus window.
    """
    return small_components(z_um, OUTLIER_FLOOR_STEPS * resolution_um, int(recipe.window) ** 2)


def settle_cleaning(maps: Sequence[Map], recipe: Recipe, resolution_um: float) -> Recipe:
    """Replace every `auto` of a recipe's cleaning by values from gated maps of the sample: fields or parts."""
    outliers = recipe.outliers
    if outliers.floor_um == "auto":
        outliers = replace(outliers, floor_um=OUTLIER_FLOOR_STEPS * resolution_um)
    levy = settle_levy(maps, recipe.levy, resolution_um)
    return replace(recipe, levy=levy, outliers=outliers)


def settle_levy(maps: Sequence[Map], levy: Levy, resolution_um: float) -> Levy:
    """Settle noise limit, flight length and number of rounds, in this order."""
    if levy.n_sigma == "auto":
        levy = replace(levy, n_sigma=_n_sigma(maps))
    if levy.alpha == "auto":
        levy = replace(levy, alpha=_alpha(maps, levy, resolution_um))
    if levy.iterations == "auto":
        levy = replace(levy, iterations=max((_rounds_that_count(z, levy, resolution_um) for z in maps), default=1))
    return levy


def _n_sigma(maps: Sequence[Map]) -> float:
    """Return the narrowest noise limit beyond which there are twice as many errors as in Gaussian noise.

    Returns the widest limit if there is none: without an excess of large errors a wide limit averages more at no cost.
    """
    bends = np.concatenate([np.zeros(0, np.float32), *(bends_of(z) for z in maps)])
    noise_um = max((height_noise_um(z) for z in maps), default=0.0)
    for n in _N_SIGMAS[:-1]:
        beyond = np.count_nonzero(np.abs(bends) > n * noise_um)
        if beyond > _MORE_THAN_NOISE * math.erfc(n / math.sqrt(2)) * bends.size:
            return n
    return _N_SIGMAS[-1]


def _alpha(maps: Sequence[Map], levy: Levy, resolution_um: float) -> float:
    """Return the flight scale at which the median flight ends at the guide, or as far away as the noise.

    A guided flight is measured relative to the distance to its guide, a literal one in um.
    """
    middle = float(np.median(flight_lengths(np.random.default_rng(levy.seed), _FLIGHTS_TRIED, levy.beta)))
    noise_um = float(np.median([height_noise_um(z) for z in maps] or [0.0]))
    return (max(noise_um, _LEAST_FLIGHT_STEPS * resolution_um) if levy.mode == "literal" else 1.0) / middle


def _rounds_that_count(z_um: Map, levy: Levy, resolution_um: float) -> int:
    """Return the last round that moves the map by more than 1e-4 of the largest move."""
    before, moves = z_um, list[float]()
    for after in islice(SMOOTHERS[levy.mode](z_um, levy, resolution_um), MOST_ROUNDS[levy.mode]):
        moves.append(float(np.nansum(np.abs(after - before), dtype=np.float64)))
        before = after.copy()
    return max((n for n, move in enumerate(moves, 1) if move > _LEAST_GAIN * max(moves)), default=1)
