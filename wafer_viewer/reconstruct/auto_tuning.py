"""Tuning of a recipe to a field: values for `auto` from a few tiles, and the parameters of all later stages."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.calibration import LARGEST_APERTURE, WAVELENGTH_UM
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.cleaning.clean import settle_cleaning
from wafer_viewer.reconstruct.focus.peak import Peaks
from wafer_viewer.reconstruct.focus.peak_centring import LEAST_SIGMA
from wafer_viewer.reconstruct.focus.peak_search import Search, ThreadScratch, coarse_step, largest_gap, search_block
from wafer_viewer.reconstruct.frame_blocks import Frames, StackWindow, developed
from wafer_viewer.reconstruct.gates.edge_bleeding import EdgeSearch, edge_search_for
from wafer_viewer.reconstruct.gates.edge_sides import STANDING_GAPS
from wafer_viewer.reconstruct.gates.evidence import auto_least_probability
from wafer_viewer.reconstruct.gates.gate import LEAST_FRAMES, Gate, gate_for, origins
from wafer_viewer.reconstruct.preprocess.camera_noise import camera_of, settled_noise
from wafer_viewer.reconstruct.preprocess.frame_jitter import LEAST_GAP

AUTO_WINDOWS = (9, 13, 17)
"""Candidate windows in pixels. Below 9 px, height noise grows faster than resolution improves."""

ENOUGH_COVERAGE = 0.92
"""The smallest window with at least 92 % of the coverage of the largest is selected."""

GAP_WIDTHS = 2.0
"""Distance from a peak to its rivals, in widths of the focus curve."""
REACH_WIDTHS = 0.55
"""Distance from a peak to its interpolation points, in widths of the focus curve."""
BLEND_WIDTHS = 0.33
"""Averaging distance along z before interpolation, in widths of the focus curve."""
SIGMA_WIDTHS = 0.8
"""Standard deviation of the window of a centred peak, in widths of the curve of a measure of power 1."""
FLOOR_WIDTHS = 5.0
"""A sweep at least this many focus-curve widths long reaches the noise floor of the curve."""

SUITABLE_WIDTH = 2.5
"""Full width at half maximum of a well-sampled focus curve, in frames."""


@dataclass(frozen=True, slots=True)
class FocusWidthParameters:
    """Limits of the estimate of the focus width from a few tiles.

    Parameters
    ----------
    probe_window : int, px
        Window of the focus measure whose curves are measured.
    least_contrast : float
        Smallest contrast of a curve that is measured, in powers of two of the focus measure.
    enough_curves : int
        Smallest number of single-peaked curves that determine the width.
    percentile : float
        Percentile of the widths of single-peaked curves. Bleeding light only widens a curve: tests/truth/bleeding.py.
    finest_px : float, px
        Largest number of pixels per Airy radius of the objective; it bounds an unknown aperture.
    """

    probe_window: int = 9
    least_contrast: float = 2.0
    enough_curves: int = 64
    percentile: float = 5.0
    finest_px: float = 4.0


FOCUS_WIDTH = FocusWidthParameters()
LEAST_BESIDE, LEAST_BEND = 1e-4, 1e-4
"""Smallest value of a curve beside its highest frame, of that one, and smallest bend, in powers of two per um."""
TOO_WIDE = 2.0
"""Largest plausible focus width, in depths of field; wide-open and apodised pupils reach 1.5."""

_AIRY = 0.61
"""Airy radius in units of wavelength / aperture."""
_TILE_PX = (32, 128)
"""Rows and columns of a sampled tile."""
_TILES = 3
"""Largest number of sampled tiles along each axis."""


@dataclass(frozen=True, slots=True)
class TunedRecipe:
    """A recipe without `auto`, and the parameters that the later stages take from it.

    search, gate, edges: parameters of the peak search, of the gates and of the search at edges, None where edges are
    not searched; resolution_um: the step of the sweep, or the step that suits the optics where the sweep is finer;
    peak_width_um: width of a focus curve at its peak; notes: one sentence for each choice that the data did not
    support, and for requested tests that were not possible.
    """

    recipe: Recipe
    search: Search
    gate: Gate
    edges: EdgeSearch | None
    resolution_um: float
    peak_width_um: float
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class FocusWidth:
    """Full width at half maximum of a focus curve, with a note where the data did not determine it.

    peak_um: the same by the three highest frames of each curve, which hardly depends on where they lie on it.
    """

    um: float
    peak_um: float
    notes: tuple[str, ...] = ()


def tune_recipe(frames: Frames, recipe: Recipe) -> TunedRecipe:
    """Replace every `auto` of a recipe by a value estimated from the data, each from those before it."""
    n_frames = frames.n_frames
    recipe = replace(recipe, noise=settled_noise(frames, recipe.noise))
    width = focus_width(frames, recipe)
    if not isinstance(recipe.focus_width_um, str):
        width = FocusWidth(recipe.focus_width_um, width.peak_um)
    recipe = replace(recipe, focus_width_um=width.um)
    tiles = SearchedTiles(frames)
    recipe = replace(recipe, window=best_window(tiles, recipe) if recipe.window == "auto" else recipe.window)
    search = search_of(recipe, n_frames, frames.step_um, frames.scale)
    resolution_um = max(1.0, width.um / frames.step_um / SUITABLE_WIDTH) * frames.step_um
    gate = gate_for(recipe, search, n_frames, resolution_um, _gap_share(recipe, search, frames.step_um))
    recipe = replace(recipe, min_confidence=gate.min_confidence)
    if recipe.least_probability == "auto":
        recipe = replace(recipe, least_probability=auto_least_probability(n_frames))
    maps = tiles.gated_um(search, gate) if recipe.heights_have_auto else []
    recipe = settle_cleaning(maps, recipe, resolution_um)
    edges = edge_search_for(recipe, search, n_frames, resolution_um)
    coarse = coarse_step(frames.step_um, frames.depth_of_field_um, width.um)
    notes = (*coarse, *width.notes, *_untested(frames, recipe, edges))
    return TunedRecipe(recipe, search, gate, edges, resolution_um, width.peak_um, notes)


class SearchedTiles:
    """Peaks of a few tiles of a field by the parameters of the search, each searched once."""

    def __init__(self, frames: Frames) -> None:
        self.frames = frames
        self._found: dict[Search, list[Peaks]] = {}

    def gated_um(self, search: Search, gate: Gate) -> list[NDArray[np.float32]]:
        """Return the heights of the tiles, NaN where the gate rejects them."""
        if search not in self._found:
            self._found[search] = [copy.deepcopy(peaks) for _, peaks in _tiles(self.frames, search)]
        return [
            np.where(origins(peaks, gate, self.frames.n_frames) == Origin.MEASURED, peaks.z_um, np.float32(np.nan))
            for peaks in self._found[search]
        ]


def focus_width(frames: Frames, recipe: Recipe) -> FocusWidth:
    """Estimate the full width at half maximum of a focus curve from a few tiles, bounded by the optics.

    Only curves with a single peak inside the stack are used. A low percentile of their widths is taken because noise
    and light bleeding from a bright out-of-focus surface make curves wider. The width is limited to the depth of field
    or, where that is unknown, to the depth of field of the smallest aperture that fits the pixel size. Without enough
    curves the result is the known depth of field, at least one step.
    """
    camera = camera_of(recipe.noise, frames.scale)
    probe = Search(
        recipe.focus_measure, FOCUS_WIDTH.probe_window, recipe.peak, 1, camera=camera
    )  # heights are not used
    power = focus_measures()[recipe.focus_measure].power
    each = [
        (_widths_um(bench, peaks, power, frames.z_um), _peak_widths_um(bench, peaks, power, frames.z_um))
        for bench, peaks in _tiles(frames, probe)
    ]
    widths_um, peak_widths_um = (np.concatenate(part) for part in zip(*each, strict=True))
    step_um, depth_um = frames.step_um, frames.depth_of_field_um
    if len(widths_um) < FOCUS_WIDTH.enough_curves:
        assumed_um = max(step_um, depth_um)
        return FocusWidth(assumed_um, assumed_um, () if depth_um > 0 else (_NO_CURVES,))
    found_um = max(step_um, float(np.percentile(widths_um, FOCUS_WIDTH.percentile)))
    peak_um = float(np.percentile(peak_widths_um, FOCUS_WIDTH.percentile)) if len(peak_widths_um) else step_um
    most_um = max(step_um, depth_um or _largest_depth_um(frames.pixel_um))
    if depth_um > 0 or found_um <= most_um:
        return FocusWidth(min(found_um, most_um), peak_um)
    return FocusWidth(most_um, peak_um, (_too_wide(found_um, most_um, frames.pixel_um),))


def best_window(tiles: SearchedTiles, recipe: Recipe) -> int:
    """Return the smallest window with nearly the coverage of the largest, for a recipe with a settled focus width."""

    def coverage(window: int) -> float:
        return _coverage(tiles, replace(recipe, window=window))

    *smaller, largest = AUTO_WINDOWS
    enough = ENOUGH_COVERAGE * coverage(largest)
    return next((w for w in smaller if coverage(w) >= enough), largest)


def search_of(recipe: Recipe, n_frames: int, step_um: float, scale: float = 1.0) -> Search:
    """Return the search parameters of a recipe with settled window, focus width and noise.

    Rivals are two widths from the peak, at most a quarter of the stack; interpolation points half a width.
    """
    width = float(recipe.focus_width_um) / step_um
    gap = int(np.clip(round(GAP_WIDTHS * width), 1, largest_gap(n_frames)))
    reach = int(np.clip(round(REACH_WIDTHS * width), 1, gap))
    blend = max(1, round(BLEND_WIDTHS * width)) if n_frames >= LEAST_FRAMES else 0
    floored = n_frames >= max(LEAST_FRAMES, FLOOR_WIDTHS * width)
    sigma = max(LEAST_SIGMA, SIGMA_WIDTHS * width / focus_measures()[recipe.focus_measure].power ** 0.5)
    camera = camera_of(recipe.noise, scale)
    window = int(recipe.window)
    return Search(recipe.focus_measure, window, recipe.peak, gap, reach, blend, floored, camera, sigma=sigma)


def _gap_share(recipe: Recipe, search: Search, step_um: float) -> float:
    """Return the gap of a search in units of that which a settled focus width asks for: whole frames may be fewer."""
    return search.gap * step_um / (GAP_WIDTHS * float(recipe.focus_width_um))


def _coverage(tiles: SearchedTiles, recipe: Recipe) -> float:
    """Return the fraction of pixels that pass the gate, ignoring clipping."""
    frames = tiles.frames
    search = search_of(recipe, frames.n_frames, frames.step_um, frames.scale)
    gap_share = _gap_share(recipe, search, frames.step_um)
    gate = gate_for(replace(recipe, clipped_fraction=1.0), search, frames.n_frames, np.inf, gap_share)
    return float(np.mean([np.mean(np.isfinite(z_um)) for z_um in tiles.gated_um(search, gate)]))


def _widths_um(bench: ThreadScratch, peaks: Peaks, power: float, z_um: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the widths of the curves of a tile that exceed half maximum once within the stack.

    The half maximum is that of a measure that falls as the square of the blur variance, so the width characterises the
    optics whatever the measure. The lowest frame is taken as noise floor and subtracted. Crossings are interpolated
    between frames.
    """
    textured = (peaks.contrast > FOCUS_WIDTH.least_contrast) & ~peaks.at_end
    levels = bench.curves.levels[:, textured].astype(np.float32)
    over_floor = 1 + (np.exp2(peaks.contrast[textured]) - 1) * np.float32(2 ** (-power / 2))
    half = levels.min(axis=0, initial=65535) + np.log2(over_floor) * np.float32(2**bench.spots.table.bits)
    over = levels > half
    single = (np.count_nonzero(over[1:] & ~over[:-1], axis=0) == 1) & ~over[0] & ~over[-1]
    levels, half, over = levels[:, single], half[single], over[:, single]
    first, last = over.argmax(axis=0), len(over) - 1 - over[::-1].argmax(axis=0)
    index = np.arange(len(first))
    rise_um, fall_um = (
        z_um[inside]
        + (z_um[outside] - z_um[inside])
        * ((levels[inside, index] - half) / (levels[inside, index] - levels[outside, index]))
        for inside, outside in ((first, first - 1), (last, last + 1))
    )
    return fall_um - rise_um


def _peak_widths_um(bench: ThreadScratch, peaks: Peaks, power: float, z_um: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the widths of the curves of a tile by the bend of their logarithm at the highest frame, over the lowest.

    A width between crossings of half the maximum reads one to two steps, by where the frames lie, for all curves that
    are hardly wider than a step; this one changes by a seventh. Curves at a gap between frames are left out.
    """
    textured = (peaks.contrast > FOCUS_WIDTH.least_contrast) & ~peaks.at_end
    levels = bench.curves.levels[:, textured].astype(np.float32) / 2**bench.spots.table.bits
    highest, index = levels.argmax(axis=0), np.arange(levels.shape[1])
    apart_um = np.diff(z_um, prepend=-np.inf, append=np.inf)
    even = np.maximum(apart_um[:-1], apart_um[1:]) < LEAST_GAP * np.median(np.diff(z_um))
    inside = even[highest]
    highest, index = highest[inside], index[inside]
    top = levels[highest, index]
    floor = np.exp2(levels.min(axis=0)[inside] - top)
    below, above = (np.maximum(np.exp2(levels[highest + k, index] - top) - floor, LEAST_BESIDE) for k in (-1, 1))
    down_um, up_um = apart_um[highest], apart_um[highest + 1]
    fall = (np.log2(1 - floor) - np.log2(below)) / down_um + (np.log2(1 - floor) - np.log2(above)) / up_um
    return np.sqrt(2 * power * (down_um + up_um) / np.maximum(fall, LEAST_BEND))


_GIVE_APERTURE = (
    "Name the objective with its aperture in the calibration, as in 10x/0.28, give the aperture (NA) when images are "
    "imported, or set focus_width_um."
)
_NO_CURVES = (
    "No focus curve is clear enough to tell the depth of field: walls between bright and dark heights could not be "
    f"tested. {_GIVE_APERTURE}"
)


def _too_wide(found_um: float, most_um: float, pixel_um: float) -> str:
    return (
        f"Walls between bright and dark heights could not be tested for sure: focus curves look {found_um:.3g} um "
        f"wide, as bleeding light makes them, so {most_um:.3g} um was assumed from the pixel of {pixel_um:.3g} um. "
        + _GIVE_APERTURE
    )


def _untested(frames: Frames, recipe: Recipe, edges: EdgeSearch | None) -> tuple[str, ...]:
    """Return a note on the requested tests that are disabled in a short stack, or else on walls that do not show."""
    if frames.n_frames >= LEAST_FRAMES:
        return () if edges is None else _walls_untested(frames, float(recipe.focus_width_um))
    wanted = (
        ("windows are not compared", recipe.compare_windows),
        ("edges are not looked for", recipe.edges != "none"),
    )
    off = " and ".join(words for words, is_wanted in wanted if is_wanted)
    return (f"The stack has {frames.n_frames} frames: in fewer than {LEAST_FRAMES} {off}.",) if off else ()


def _walls_untested(frames: Frames, width_um: float) -> tuple[str, ...]:
    """Return a note where the focus width is too large, against the optics or the sweep, to detect walls."""
    depth_um = frames.depth_of_field_um
    sweep_um, least_um = float(np.ptp(frames.z_um)), STANDING_GAPS * GAP_WIDTHS * width_um
    if depth_um > 0 and width_um > TOO_WIDE * max(depth_um, frames.step_um):
        return (
            f"Walls between bright and dark heights could not be tested: the focus width of {width_um:.3g} um is "
            f"{width_um / depth_um:.2g} times the depth of field. Leave focus_width_um to the data.",
        )
    if sweep_um < least_um:
        return (
            f"Walls between bright and dark heights could not be tested: they show in a sweep of {least_um:.3g} um or "
            f"more, and this one is {sweep_um:.3g} um long.",
        )
    return ()


def _largest_depth_um(pixel_um: float) -> float:
    """Return the depth of field of the smallest aperture with at most `finest_px` pixels per Airy radius."""
    aperture = min(LARGEST_APERTURE, _AIRY * WAVELENGTH_UM / (FOCUS_WIDTH.finest_px * pixel_um))
    return WAVELENGTH_UM / aperture**2


def _tiles(frames: Frames, search: Search) -> Iterator[tuple[ThreadScratch, Peaks]]:
    """Yield the peaks of a few tiles spread over the field; scratch buffers and peaks are reused for each tile."""
    n_rows, n_cols = frames.shape
    shape = min(_TILE_PX[0], n_rows), min(_TILE_PX[1], n_cols)
    bench = ThreadScratch.make(frames.n_frames, shape, search, frames.dtype)
    peaks = Peaks.empty(shape, frames.dtype)
    tiles = [
        StackWindow(slice(top, top + shape[0]), slice(left, left + shape[1]))
        for top in _starts(n_rows, shape[0])
        for left in _starts(n_cols, shape[1])
    ]
    for _, block in developed(frames, tiles, search.margin_px):
        search_block(block, frames.z_um, search, bench, peaks)
        yield bench, peaks


def _starts(length: int, size: int) -> list[int]:
    """Return evenly spaced tile starts within the border; fewer tiles where they would overlap."""
    count = min(_TILES, max(1, length // size))
    return [round((i + 0.5) * length / count - size / 2) for i in range(count)]
