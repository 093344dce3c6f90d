"""Cleaning of gated heights: smoothing, removal of outliers and step edges, filling of gaps.

Outliers: `cloud` is the paper's form: neighbours in the point cloud, with their mean distance compared to its mean and
deviation over the field. `lattice` takes the neighbours among the surrounding pixels and measures along z. On a clean
field that deviation is tiny and the rule would remove the edges of steps, so it has a lower bound.

`lattice` detects three more kinds of isolated pixels: those that smoothing moved by much more than usual, those on
strips narrower than three quarters of the focus window, and those on islands smaller than the square of two windows or
within a window of the border. Any real structure appears at least as wide as the window; smaller ones are artefacts of
light that bleeds over an edge.

Edges of steps: a window across a jump sees the focus of both sides, and the sharper side wins, independent of the
position of the jump. Where a silhouette separates the sides their heights are tested against them; here jumps without
one are handled.

The light of a defocused bright line ends in a disc, whose rim looks sharp everywhere: it creates a surface that falls
away from the line as steeply as the aperture is wide. That is a jump within the window too.

Unsupported heights: false ones that pass every other test are uneven, at the margin of what is measured, on small
islands. None of this alone tells them apart; a height counts as an outlier where the product is large. Heights found by
the focus along a wall are exempt: they lie at the margin because the wall does. What is then left of an island must
still be as large as one, and heights along a wall must join others.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.calibration import WAVELENGTH_UM
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.model.surface.recipe import Fill, Levy, Outliers, Recipe
from wafer_viewer.numerics.filters.denoising import NEIGHBOUR_REACH_PX, few_near, mean_distances
from wafer_viewer.numerics.filters.interpolation import fill_gaps, fill_rows, local_planes
from wafer_viewer.numerics.filters.regions import blank, blanked, border_components, component_sizes, narrow_parts
from wafer_viewer.numerics.filters.sliding_filters import doubled, halved, highest, lowest, mean
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA, median
from wafer_viewer.numerics.open3d_library import load_open3d
from wafer_viewer.reconstruct.cleaning.levy_flight import SMOOTHERS, bends_of, flight_lengths, height_noise_um, smooth
from wafer_viewer.reconstruct.focus.peak_search import FOCUS_WIDTH_DEPTHS

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


BRIDGED_PX = 2
"""Gaps up to this size are bridged when the width of a strip is measured."""

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
    """Judge moved pixels at their smoothed position, so that one wrong pixel does not make a strip narrow."""
    floor_um, window = float(recipe.outliers.floor_um), int(recipe.window)
    found = far_on_lattice(smoothed_um, recipe.outliers) | _moved(raw_um, smoothed_um, floor_um)
    found |= narrow_parts(fill_gaps(smoothed_um, BRIDGED_PX, floor_um), floor_um, 3 * window // 4)
    remaining = blanked(smoothed_um, found)
    found |= _islands(remaining, component_sizes(remaining, floor_um), window)
    return found & np.isfinite(raw_um)


def _islands(z_um: Map, sizes: NDArray[np.int32], window: int) -> Found:
    """Detect islands smaller than the square of two windows, and those within a window of the border.

    sizes: of the components. What the border cuts off may be a wall whose light is all that the window sees:
    tests/truth/unseen.py.
    """
    measured = np.isfinite(z_um)
    return (measured & (sizes < (2 * window) ** 2)) | border_components(measured, window)


def _lone_islands(z_um: Map, tolerance_um: float, window: int, found_along: Found) -> Found:
    """Detect the islands that all removals have left.

    Of heights that the focus along a wall gave, those that join no others: they were expected from a surface further
    from the wall, and where nothing is left of it they may be those of the outline: tests/truth/unseen.py.
    """
    sizes = component_sizes(z_um, tolerance_um)
    along = blanked(z_um, ~found_along)
    alone = np.isfinite(along) & (component_sizes(along, tolerance_um) == sizes) if found_along.any() else found_along
    return (_islands(z_um, sizes, window) & ~found_along) | alone


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
    """Detect outliers by the paper's method, with Open3D's neighbour search."""
    open3d = load_open3d()
    rows, cols = np.nonzero(np.isfinite(z_um))
    found = np.zeros(z_um.shape, bool)
    if len(rows) <= how.neighbours:
        return found
    points = np.stack([cols * pixel_um, -rows * pixel_um, z_um[rows, cols]], axis=1).astype(np.float64)
    cloud = open3d.core.Tensor.from_numpy(points)
    tree = open3d.core.nns.NearestNeighborSearch(cloud)
    tree.knn_index()
    _, squared = tree.knn_search(cloud, how.neighbours + 1)
    distance = np.sqrt(squared.numpy())[:, 1:].mean(axis=1)
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


@dataclass(frozen=True, slots=True)
class JumpParameters:
    """Limits of the height range within a window that one surface may have: tests/truth/unseen.py.

    Parameters
    ----------
    steps : float
        Range from which there may be two surfaces, in steps of the resolution.
    cone_share : float
        Steepest slope of a surface, relative to the cone of light of the objective: bleeding light makes surfaces as
        steep as the cone.
    plane_share : float
        Steepest slope of a surface that a plane describes over two windows, relative to the cone of light.
    plane_coverage : float
        Smallest measured fraction of these windows.
    plane_residual : float
        Largest root mean square distance from the plane, in steps of the resolution: tests/truth/relief.py.
    plane_explained : float
        Smallest fraction of the variance that the plane explains; a jump in the middle of the windows leaves a quarter.
    """

    steps: float = 1.0
    cone_share: float = 0.6
    plane_share: float = 0.7
    plane_coverage: float = 0.7
    plane_residual: float = 0.2
    plane_explained: float = 0.9


JUMP = JumpParameters()


@dataclass(frozen=True, slots=True)
class SupportParameters:
    """Limits of the doubt in a height: unevenness times isolation.

    Unevenness is the height range within about half a window, relative to the largest of one surface; isolation the sum
    of the unmeasured share of a window and of the smallness of the island. Tuned on tests/truth/unseen.py.

    Parameters
    ----------
    most_doubt : float
        Largest doubt in a height that counts.
    island_windows : float, windows
        Side of the square as large as an island of smallness 1.
    smallest : float
        Largest smallness.
    """

    most_doubt: float = 0.2
    island_windows: float = 4.0
    smallest: float = 2.0


SUPPORT = SupportParameters()

_BEYOND_UM = np.float32(1e9)
"""Magnitude of a height beyond all others, which stands for unmeasured ones."""


def height_range_um(z_um: NDArray[np.float32], window: int) -> NDArray[np.float32]:
    """Return the height range within about half a window of each pixel; at most 0 where there are none.

    z_um: [row, col], NaN where unmeasured. Evaluated for 2 x 2 pixels together. At the border of the field the range is
    taken within a full window, because heights cut off by the border are missing, and a slope must not look flatter
    there.
    """
    cells = _range_cells(window)
    top_um, bottom_um = (_of_cells(z_um, choose) for choose in (np.fmax, np.fmin))
    high = highest(np.where(np.isnan(top_um), -_BEYOND_UM, top_um), cells)
    low = lowest(np.where(np.isnan(bottom_um), _BEYOND_UM, bottom_um), cells)
    return doubled(_full_windows(high - low, cells // 2), z_um.shape)


def _range_cells(window: int) -> int:
    """Return the side of the square of `height_range_um`, in cells of 2 x 2 pixels."""
    return 2 * (window // 4) + 1


def _full_windows(plane: NDArray[np.float32], reach: int) -> NDArray[np.float32]:
    """Replace border values by those of the nearest window inside; unchanged if none fits."""
    if min(plane.shape) <= 2 * reach or not reach:
        return plane
    return np.pad(plane[reach:-reach, reach:-reach], reach, mode="edge")


def _of_cells(plane: NDArray[np.float32], choose: np.ufunc) -> NDArray[np.float32]:
    """Reduce 2 x 2 pixels to one value; at an odd border the edge pixels repeat."""
    rows, cols = plane.shape
    padded = np.pad(plane, ((0, rows % 2), (0, cols % 2)), mode="edge") if rows % 2 or cols % 2 else plane
    tall = choose(padded[::2], padded[1::2])
    return np.asarray(choose(tall[:, ::2], tall[:, 1::2]), np.float32)


OUTLIER_FLOOR_STEPS = 1.5
"""Outlier floor of `auto`, and height tolerance within a remnant, in steps of the resolution."""

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
    side_is_known: NDArray[np.bool_] | None = None,
    bleeding_um: Map | None = None,
    found_along: NDArray[np.bool_] | None = None,
) -> Cleaned:
    """Clean a gated map, NaN where unmeasured, by a settled recipe.

    resolution_um: axial resolution of the optics, the reference for steps of the surface; side_is_known: mask of pixels
    with a known wall side, None if step edges are not requested; bleeding_um: heights rejected because light bled
    there, NaN elsewhere: measured heights that continue from them also lie next to a jump; found_along: mask of the
    heights that the focus along a wall gave, which need no support by others.
    """
    smoothed = smooth(z_um, recipe.levy, resolution_um)
    outlier = find_outliers(z_um, smoothed, pixel_um, recipe)
    raw, step_edge = blanked(z_um, outlier), np.zeros(z_um.shape, np.bool_)
    if side_is_known is not None:
        step_edge = _step_edges(raw, side_is_known, bleeding_um, pixel_um, recipe, resolution_um)
        blank(raw, step_edge)
        tolerance_um = OUTLIER_FLOOR_STEPS * resolution_um
        sizes = component_sizes(raw, tolerance_um)
        if step_edge.any():  # a sliver of a slope caused by bleeding light may look flat by itself
            outlier |= _islands(raw, sizes, int(recipe.window)) & ~side_is_known
            blank(raw, outlier)
        if recipe.outliers.mode == "lattice":
            exempt = np.zeros(z_um.shape, np.bool_) if found_along is None else found_along
            outlier |= _unsupported(raw, sizes, pixel_um, recipe, resolution_um) & ~exempt
            blank(raw, outlier)
            outlier |= _lone_islands(raw, tolerance_um, int(recipe.window), exempt)
            blank(raw, outlier)
    blank(smoothed, outlier | step_edge)
    return Cleaned(fill(smoothed, recipe.fill, resolution_um), raw, outlier, step_edge)


def _step_edges(
    z_um: Map, side_is_known: Found, bleeding_um: Map | None, pixel_um: float, recipe: Recipe, resolution_um: float
) -> Found:
    """Return a mask of heights with another surface within about half a window, where the side is not known."""
    edge_um = z_um if bleeding_um is None else np.where(np.isnan(z_um), bleeding_um, z_um)
    limit_um = _jump_limit_um(recipe, pixel_um, resolution_um)
    apart = (height_range_um(edge_um, int(recipe.window)) > limit_um) & np.isfinite(z_um) & ~side_is_known
    return apart & ~_on_slope(edge_um, pixel_um, recipe, resolution_um) if apart.any() else apart


def _on_slope(z_um: Map, pixel_um: float, recipe: Recipe, resolution_um: float) -> NDArray[np.bool_]:
    """Return a mask of the pixels in the middle of a steep plane two windows wide, evaluated for 2 x 2 pixels together.

    A jump within the windows is no plane, and light that bleeds over a wall makes a surface as steep as the cone.
    """
    finite = np.isfinite(z_um)
    share = halved(finite)
    cells = halved(np.where(finite, z_um, np.float32(0)))
    cells = np.divide(cells, share, out=np.full(share.shape, np.nan, np.float32), where=share > 0)
    planes = local_planes(cells, int(recipe.window))
    steepest = JUMP.plane_share * _cone(recipe) * 2 * pixel_um
    on_slope = (planes.gradient < steepest) & (planes.coverage >= JUMP.plane_coverage)
    on_slope &= (planes.residual < JUMP.plane_residual * resolution_um) & (planes.explained > JUMP.plane_explained)
    return doubled(on_slope, z_um.shape)


def _cone(recipe: Recipe) -> float:
    """Return the slope of the cone of light: the root of the depth of field, lambda / NA^2, in wavelengths.

    This holds for small apertures.
    """
    return math.sqrt(float(recipe.focus_width_um) / FOCUS_WIDTH_DEPTHS / WAVELENGTH_UM)


def _jump_limit_um(recipe: Recipe, pixel_um: float, resolution_um: float) -> float:
    """Return the largest height range of one surface within the pixels of `height_range_um`."""
    extent_um = (2 * _range_cells(int(recipe.window)) - 1) * pixel_um
    return max(JUMP.steps * resolution_um, JUMP.cone_share * _cone(recipe) * extent_um)


def _unsupported(z_um: Map, sizes: NDArray[np.int32], pixel_um: float, recipe: Recipe, resolution_um: float) -> Found:
    """Return a mask of uneven heights that too few others support; sizes: of the components."""
    measured, window = np.isfinite(z_um), int(recipe.window)
    unevenness = height_range_um(z_um, window) / np.float32(_jump_limit_um(recipe, pixel_um, resolution_um))
    smallness = np.minimum(np.float32((SUPPORT.island_windows * window) ** 2) / sizes, np.float32(SUPPORT.smallest))
    isolation = 1 - mean(measured, 2 * (window // 2) + 1) + smallness
    return measured & (unevenness * isolation > SUPPORT.most_doubt)


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
