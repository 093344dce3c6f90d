"""From gated heights to a clean surface: smooth, drop outliers and edges of steps, fill; what of that is `auto`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.recipe import Levy, Recipe
from wafer_viewer.numerics.filters.connected_components import small_islands
from wafer_viewer.reconstruct.cleaning.gap_fill import fill
from wafer_viewer.reconstruct.cleaning.levy_flight import SMOOTHERS, bends_of, flight_lengths, height_noise_um, smooth
from wafer_viewer.reconstruct.cleaning.outliers import find_outliers
from wafer_viewer.reconstruct.cleaning.step_edges import JUMP_STEPS, apart_um

OUTLIER_FLOOR_STEPS = 1.5

MOST_ROUNDS = {"none": 1, "literal": 30, "guided": 30, "switching_median": 6, "sigma_filter": 2}
"""Two rounds of averages reach 8 px: what is 20 px wide, the smallest to trust at a window of 9, keeps its height."""

_LEAST_GAIN = 1e-4
_N_SIGMAS = (3.0, 3.5, 4.0, 4.5)
_MORE_THAN_NOISE = 2.0
_FLIGHTS_TRIED = 20_001
_LEAST_FLIGHT_STEPS = 0.05

Map = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Cleaned:
    """z_um: smoothed, without what was left out, filled; raw_um: only without that.

    outlier, step_edge: what was left out and why, bool [row, col].
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

    resolution_um: what the optics resolve along z, the measure of what counts as a step of the surface; told_apart:
    where it is known which side of a wall a pixel is on, None where nobody asks for the edges of steps; bled_um: the
    heights that were left out because light bled there, NaN elsewhere: what goes on from them is beside a jump, too.
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
    """Which heights have others within about half a window that are not of the same surface."""
    seen_um = z_um if bled_um is None else np.where(np.isnan(z_um), bled_um, z_um)
    return (apart_um(seen_um, int(recipe.window)) > JUMP_STEPS * resolution_um) & np.isfinite(z_um)


def _leftovers(z_um: Map, recipe: Recipe, resolution_um: float) -> NDArray[np.bool_]:
    """What stands alone once the edges of steps are gone, which took about half a window from each side of a piece.

    A sliver of a slope that light made up may look flat by itself, and is smaller than the window that saw it.
    """
    return small_islands(z_um, OUTLIER_FLOOR_STEPS * resolution_um, int(recipe.window) ** 2)


def settle_cleaning(maps: Sequence[Map], recipe: Recipe, resolution_um: float) -> Recipe:
    """The recipe with every `auto` of its cleaning replaced by what gated maps of the sample say: fields or parts."""
    outliers = recipe.outliers
    if outliers.floor_um == "auto":
        outliers = replace(outliers, floor_um=OUTLIER_FLOOR_STEPS * resolution_um)
    levy = settle_levy(maps, recipe.levy, resolution_um)
    return replace(recipe, levy=levy, outliers=outliers)


def settle_levy(maps: Sequence[Map], levy: Levy, resolution_um: float) -> Levy:
    """How far noise goes, how long flights are, how many rounds still change something: in this order."""
    if levy.n_sigma == "auto":
        levy = replace(levy, n_sigma=_n_sigma(maps))
    if levy.alpha == "auto":
        levy = replace(levy, alpha=_alpha(maps, levy, resolution_um))
    if levy.iterations == "auto":
        levy = replace(levy, iterations=max((_rounds_that_count(z, levy, resolution_um) for z in maps), default=1))
    return levy


def _n_sigma(maps: Sequence[Map]) -> float:
    """Where errors have no more large ones than Gaussian noise has, a wide limit costs nothing and averages more.

    The narrowest limit beyond which lies twice what noise would leave there, or else the widest.
    """
    bends = np.concatenate([np.zeros(0, np.float32), *(bends_of(z) for z in maps)])
    noise_um = max((height_noise_um(z) for z in maps), default=0.0)
    for n in _N_SIGMAS[:-1]:
        beyond = np.count_nonzero(np.abs(bends) > n * noise_um)
        if beyond > _MORE_THAN_NOISE * math.erfc(n / math.sqrt(2)) * bends.size:
            return n
    return _N_SIGMAS[-1]


def _alpha(maps: Sequence[Map], levy: Levy, resolution_um: float) -> float:
    """The middle one of all flights ends where it is wanted: at the guide, or as far away as noise goes.

    A guided flight is measured by the distance to its guide, a literal one in um.
    """
    middle = float(np.median(flight_lengths(np.random.default_rng(levy.seed), _FLIGHTS_TRIED, levy.beta)))
    noise_um = float(np.median([height_noise_um(z) for z in maps] or [0.0]))
    return (max(noise_um, _LEAST_FLIGHT_STEPS * resolution_um) if levy.mode == "literal" else 1.0) / middle


def _rounds_that_count(z_um: Map, levy: Levy, resolution_um: float) -> int:
    """The last round that moves the map by more than a ten-thousandth of what the one that moves it most does."""
    before, moves = z_um, list[float]()
    for after in islice(SMOOTHERS[levy.mode](z_um, levy, resolution_um), MOST_ROUNDS[levy.mode]):
        moves.append(float(np.nansum(np.abs(after - before), dtype=np.float64)))
        before = after.copy()
    return max((n for n, move in enumerate(moves, 1) if move > _LEAST_GAIN * max(moves)), default=1)
