"""The choices that a recipe leaves to the data, made on a few tiles of the field and written into the recipe."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from wafer_viewer.model.recipe import Recipe
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface import Origin
from wafer_viewer.reconstruct.focus import mantissa_bits
from wafer_viewer.reconstruct.gate import auto_min_confidence, gate_of, origins
from wafer_viewer.reconstruct.levy import AUTO_ITERATIONS
from wafer_viewer.reconstruct.noise import noise_scores
from wafer_viewer.reconstruct.peak import Peaks
from wafer_viewer.reconstruct.prepare import Frames
from wafer_viewer.reconstruct.search import Bench, Search, search_part

AUTO_WINDOWS = (5, 9, 13, 17)
ENOUGH_COVERAGE = 0.92
"""The smallest window is taken that measures 92 % of what the largest does."""

OUTLIER_FLOOR_STEPS = 1.5
GAP_WIDTHS = 2.0
_PROBE_WINDOW = 9
_TILE_PX = 64
_TILES = 4


@dataclass(frozen=True, slots=True)
class Settled:
    """A recipe without `auto`, and how far apart two peaks of one pixel must be to count as rivals."""

    recipe: Recipe
    search: Search


def settle(frames: Frames, recipe: Recipe) -> Settled:
    """Replace every `auto` of a recipe by what the data say."""
    window = None if recipe.window == "auto" else recipe.window
    gap = rival_gap(frames, recipe, window or _PROBE_WINDOW)
    window = window or best_window(frames, recipe, gap)
    search = Search(recipe.focus_measure, window, recipe.peak, gap)
    levy, outliers = recipe.levy, recipe.outliers
    if levy.iterations == "auto":
        levy = replace(levy, iterations=AUTO_ITERATIONS[levy.mode])
    if outliers.floor_um == "auto":
        outliers = replace(outliers, floor_um=OUTLIER_FLOOR_STEPS * frames.step_um)
    confidence = _min_confidence(recipe, search, frames.n_frames)
    settled = replace(recipe, window=window, min_confidence=confidence, levy=levy, outliers=outliers)
    return Settled(settled, search)


def rival_gap(frames: Frames, recipe: Recipe, window: int) -> int:
    """Frames from a peak to where another maximum is a rival, not a shoulder: twice the width of a focus curve.

    The width at half height in the best textured quarter of the tiles; at most a quarter of the stack.
    """
    widths = [_half_height_width(bench, peaks) for bench, peaks in _tiles(frames, _search(recipe, window, 1))]
    usual = float(np.median([w for w in widths if w > 0] or [1.0]))
    return int(np.clip(round(GAP_WIDTHS * usual), 1, max(1, (frames.n_frames - 1) // 4)))


def best_window(frames: Frames, recipe: Recipe, gap: int) -> int:
    """The smallest window that covers nearly as much as the largest."""
    coverages = {w: _coverage(frames, recipe, _search(recipe, w, gap)) for w in AUTO_WINDOWS}
    enough = ENOUGH_COVERAGE * coverages[AUTO_WINDOWS[-1]]
    return next(w for w in AUTO_WINDOWS if coverages[w] >= enough)


def _search(recipe: Recipe, window: int, gap: int) -> Search:
    return Search(recipe.focus_measure, window, recipe.peak, gap)


def _min_confidence(recipe: Recipe, search: Search, n_frames: int) -> float:
    if recipe.min_confidence == "auto":
        return auto_min_confidence(noise_scores(search, n_frames))
    return recipe.min_confidence


def _coverage(frames: Frames, recipe: Recipe, search: Search) -> float:
    """The share of pixels that pass the gate, clipping aside."""
    noise = noise_scores(search, frames.n_frames)
    gate = gate_of(noise, _min_confidence(recipe, search, frames.n_frames), 1.0, search.window)
    return float(
        np.mean([np.mean(origins(p, gate, frames.n_frames) == Origin.MEASURED) for _, p in _tiles(frames, search)])
    )


def _half_height_width(bench: Bench, peaks: Peaks) -> float:
    """The median number of frames with at least half the focus of the peak, where there is texture; 0 without any."""
    textured = (peaks.contrast >= np.percentile(peaks.contrast, 75)) & (peaks.contrast > 1) & ~peaks.at_end
    if not textured.any():
        return 0.0
    half = 2 ** mantissa_bits(bench.block.dtype)
    levels = bench.curves.levels[:, textured].astype(np.int32)
    return float(np.median(np.count_nonzero(levels > levels.max(axis=0) - half, axis=0)))


def _tiles(frames: Frames, search: Search) -> Iterator[tuple[Bench, Peaks]]:
    """The peaks of a few tiles spread over the field; bench and peaks are used again for the next tile."""
    n_rows, n_cols = frames.shape
    shape = min(_TILE_PX, n_rows), min(_TILE_PX, n_cols)
    bench = Bench.make(frames.n_frames, shape, search.window, frames.images.dtype)
    peaks = Peaks.empty(shape, bench.block.dtype)
    for top in _starts(n_rows, shape[0]):
        for left in _starts(n_cols, shape[1]):
            search_part(frames, slice(top, top + shape[0]), slice(left, left + shape[1]), search, bench, peaks)
            yield bench, peaks


def _starts(length: int, size: int) -> list[int]:
    """Where tiles begin: evenly spread, none beyond the border, fewer when they would overlap."""
    count = min(_TILES, max(1, length // size))
    return [round((i + 0.5) * length / count - size / 2) for i in range(count)]
