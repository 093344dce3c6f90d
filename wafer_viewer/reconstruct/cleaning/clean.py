"""Cleaning of heights: smoothing, removal of outliers, filling of gaps.

Outliers: `cloud` is the paper's form: neighbours in the point cloud, with their mean distance compared to its mean and
deviation over the field. `lattice` takes the neighbours among the surrounding pixels and measures along z. On a clean
field that deviation is tiny and the rule would remove the edges of steps, so it has a lower bound.

`lattice` also detects pixels that smoothing moved by much more than usual.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.model.surface.recipe import Fill, Levy, Outliers, Recipe
from wafer_viewer.numerics.filters.denoising import NEIGHBOUR_REACH_PX, distances_in_cloud, few_near, mean_distances
from wafer_viewer.numerics.filters.interpolation import fill_gaps, fill_rows
from wafer_viewer.numerics.filters.regions import blank, blanked
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA, median
from wafer_viewer.reconstruct.cleaning.levy_flight import SMOOTHERS, bends_of, flight_lengths, height_noise_um, smooth

MAX_STEP_FRAMES = 1.5
"""A gap whose sides differ by more than one and a half steps of the sweep is a step of the surface."""


def fill(z_um: NDArray[np.float32], how: Fill, step_um: float) -> NDArray[np.float32]:
    """Return a filled copy of a map.

    `small_gaps`: along rows and along columns, the mean where both reach, never across a step. `all`: the paper's
    method, along the rows and then along the columns of the result, across any gap; regions measured on one side only,
    as at the border of the map, stay unmeasured.
    """
    if how.mode == "none":
        return z_um.copy()
    if how.mode == "small_gaps":
        return fill_gaps(z_um, how.max_gap_px, MAX_STEP_FRAMES * step_um)
    longest = max(z_um.shape)
    return np.ascontiguousarray(fill_rows(fill_rows(z_um, longest, math.inf).T, longest, math.inf).T)


def mark_filled(origin: NDArray[np.uint8], z_um: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return the origins of a map after gap filling; unmeasured pixels with a height become FILLED."""
    return np.where((origin != Origin.MEASURED) & np.isfinite(z_um), np.uint8(Origin.FILLED), origin)


_SAMPLE_EVERY_PX = 7
"""Stride at which moves by smoothing and distances to neighbours are sampled, in pixels."""
_MOVED_DEVIATIONS = 6.0
"""Smallest move of an outlier by smoothing, in standard deviations of the moves."""
_MOVED_FLOORS = 1 / 3
"""Smallest move of an outlier by smoothing, as a fraction of the outlier floor."""

Map = NDArray[np.float32]
Found = NDArray[np.bool_]


def find_outliers(raw_um: Map, smoothed_um: Map, pixel_um: float, recipe: Recipe) -> Found:
    """Return a mask of the outliers among the measured pixels, by the settled recipe; bool [row, col]."""
    return FINDERS[recipe.outliers.mode](raw_um, smoothed_um, pixel_um, recipe)


def _none(raw_um: Map, smoothed_um: Map, pixel_um: float, recipe: Recipe) -> Found:
    return np.zeros(raw_um.shape, bool)


def _lattice(raw_um: Map, smoothed_um: Map, pixel_um: float, recipe: Recipe) -> Found:
    """Judge moved pixels at their smoothed position, so that one wrong pixel does not condemn its neighbours."""
    floor_um = float(recipe.outliers.floor_um)
    found = far_on_lattice(smoothed_um, recipe.outliers) | _moved(raw_um, smoothed_um, floor_um)
    return found & np.isfinite(raw_um)


def _cloud(raw_um: Map, smoothed_um: Map, pixel_um: float, recipe: Recipe) -> Found:
    return far_in_cloud(smoothed_um, pixel_um, recipe.outliers)


def _moved(raw_um: Map, smoothed_um: Map, floor_um: float) -> Found:
    moved_um = np.abs(smoothed_um - raw_um)
    some = moved_um[::_SAMPLE_EVERY_PX, ::_SAMPLE_EVERY_PX]
    usual_um = MAD_TO_SIGMA * median(some[np.isfinite(some)]) if np.isfinite(some).any() else 0.0
    return moved_um > max(_MOVED_FLOORS * floor_um, _MOVED_DEVIATIONS * usual_um)


def far_on_lattice(z_um: Map, how: Outliers) -> Found:
    """Detect outliers by the mean distance to the nearest of 7 x 7 pixels; too few neighbours also count.

    Beyond its border the map is extended by its edge values, so that the edge of a step is no outlier there. Pixels
    with enough neighbours within the threshold are skipped, which leaves few to test.
    """
    neighbours = min(how.neighbours, (2 * NEIGHBOUR_REACH_PX + 1) ** 2 // 2)
    padded = np.pad(z_um, NEIGHBOUR_REACH_PX, mode="edge")
    found = np.zeros(z_um.shape, bool)
    rows, cols = np.nonzero(np.isfinite(z_um[::_SAMPLE_EVERY_PX, ::_SAMPLE_EVERY_PX]))
    if not rows.size:
        return found
    usual = mean_distances(padded, rows * _SAMPLE_EVERY_PX, cols * _SAMPLE_EVERY_PX, neighbours)
    threshold_um = _threshold(usual, how)
    rows, cols = np.nonzero(np.isfinite(z_um) & few_near(padded, threshold_um, neighbours))
    found[rows, cols] = mean_distances(padded, rows, cols, neighbours) > threshold_um
    return found


def far_in_cloud(z_um: Map, pixel_um: float, how: Outliers) -> Found:
    """Detect outliers by the paper's method: neighbours near on the lattice, the others by a search tree."""
    rows, cols = np.nonzero(np.isfinite(z_um))
    found = np.zeros(z_um.shape, bool)
    if len(rows) <= how.neighbours:
        return found
    distance = distances_in_cloud(z_um, pixel_um, how.neighbours)[rows, cols]
    if (beyond := np.isnan(distance)).any():
        from scipy.spatial import KDTree

        points = np.stack([cols * pixel_um, rows * pixel_um, z_um[rows, cols]], axis=1)
        tree = KDTree(points, balanced_tree=False, compact_nodes=False)  # few are asked for: built 4 times as fast
        distance[beyond] = tree.query(points[beyond], how.neighbours + 1)[0][:, 1:].mean(axis=1)
    far = distance > _threshold(distance, how)
    found[rows[far], cols[far]] = True
    return found


def _threshold(distances: NDArray[np.floating], how: Outliers) -> float:
    finite, floor_um = distances[np.isfinite(distances)], float(how.floor_um)
    if not finite.size:
        return floor_um
    return float(finite.mean() + max(how.n_sigma * finite.std(), floor_um))


FINDERS: dict[str, Callable[[Map, Map, float, Recipe], Found]] = {"none": _none, "lattice": _lattice, "cloud": _cloud}
"""Each takes the raw and the smoothed map, the pixel size and the settled recipe."""


OUTLIER_FLOOR_STEPS = 1.5
"""Outlier floor of `auto`, in steps of the resolution."""

MOST_ROUNDS = {"none": 1, "literal": 30, "guided": 30, "switching_median": 6, "sigma_filter": 2}
"""Maximum rounds per smoother. Two rounds of averages reach 8 px.

A structure 20 px wide, the smallest to trust at a window of 9, then retains its height.
"""


@dataclass(frozen=True, slots=True)
class LevyTuningParameters:
    """Limits by which noise limit, flight length and number of rounds are chosen for a map.

    Parameters
    ----------
    n_sigmas : tuple[float, ...]
        Noise limits that are compared, rising, in standard deviations of the noise.
    more_than_noise : float
        Number of errors beyond a noise limit, relative to that of Gaussian noise, from which the limit is taken.
    flights : int
        Number of flights whose median length is taken.
    least_flight_steps : float
        Smallest length of the median literal flight, in steps of the resolution.
    least_gain : float
        Smallest move of the map in a round that counts, relative to the largest move.
    """

    n_sigmas: tuple[float, ...] = (3.0, 3.5, 4.0, 4.5)
    more_than_noise: float = 2.0
    flights: int = 20_001
    least_flight_steps: float = 0.05
    least_gain: float = 1e-4


LEVY_TUNING = LevyTuningParameters()


@dataclass(frozen=True, slots=True, eq=False)
class Cleaned:
    """A cleaned map and the mask of removed heights.

    z_um: smoothed, without outliers, filled; raw_um: only without outliers; outlier: bool [row, col].
    """

    z_um: Map
    raw_um: Map
    outlier: NDArray[np.bool_]


def clean(z_um: Map, pixel_um: float, recipe: Recipe, resolution_um: float) -> Cleaned:
    """Clean a map, NaN where unmeasured, by a settled recipe.

    resolution_um: axial resolution of the optics, the reference for steps of the surface.
    """
    smoothed = smooth(z_um, recipe.levy, resolution_um)
    outlier = find_outliers(z_um, smoothed, pixel_um, recipe)
    blank(smoothed, outlier)
    return Cleaned(fill(smoothed, recipe.fill, resolution_um), blanked(z_um, outlier), outlier)


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
    for n in LEVY_TUNING.n_sigmas[:-1]:
        beyond = np.count_nonzero(np.abs(bends) > n * noise_um)
        if beyond > LEVY_TUNING.more_than_noise * math.erfc(n / math.sqrt(2)) * bends.size:
            return n
    return LEVY_TUNING.n_sigmas[-1]


def _alpha(maps: Sequence[Map], levy: Levy, resolution_um: float) -> float:
    """Return the flight scale at which the median flight ends at the guide, or as far away as the noise.

    A guided flight is measured relative to the distance to its guide, a literal one in um.
    """
    middle = float(np.median(flight_lengths(np.random.default_rng(levy.seed), LEVY_TUNING.flights, levy.beta)))
    noise_um = float(np.median([height_noise_um(z) for z in maps] or [0.0]))
    return (max(noise_um, LEVY_TUNING.least_flight_steps * resolution_um) if levy.mode == "literal" else 1.0) / middle


def _rounds_that_count(z_um: Map, levy: Levy, resolution_um: float) -> int:
    """Return the last round that moves the map by more than 1e-4 of the largest move."""
    before, moves = z_um, list[float]()
    for after in islice(SMOOTHERS[levy.mode](z_um, levy, resolution_um), MOST_ROUNDS[levy.mode]):
        moves.append(float(np.nansum(np.abs(after - before), dtype=np.float64)))
        before = after.copy()
    return max((n for n, move in enumerate(moves, 1) if move > LEVY_TUNING.least_gain * max(moves)), default=1)
