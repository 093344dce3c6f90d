"""Detection and correction of false heights near walls, caused by light that bleeds over them.

Walls are silhouettes that persist through many frames. Near them a height is accepted only where it agrees with the
surface on the same side further from the wall. On the dark side the focus is also measured along the wall, which is
insensitive to light that bleeds across it; this recovers the rims of dies, and a height that it does not confirm is
that of the wall's outline, which the focus window sees on both sides.

A polished rim shows as a bright line. Between the line and the wall lies the dark slope of the die, without texture,
and every focus window there sees the texture of the lower ground beyond. Below a line no height is accepted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.numerics.filters.sliding_filters import blurred, doubled, highest, lowest, repeated
from wafer_viewer.reconstruct.focus.focus_volume import COARSE_PX, on_threads
from wafer_viewer.reconstruct.focus.log_laplacian import Stabiliser
from wafer_viewer.reconstruct.focus.peak import Peaks
from wafer_viewer.reconstruct.focus.peak_search import Search
from wafer_viewer.reconstruct.frame_blocks import Frames, StackWindow, Window, developed, read_part, stripes
from wafer_viewer.reconstruct.gates.edge_sides import (
    BAND_REACH_PX,
    STANDING_GAPS,
    WALL,
    Band,
    EdgeSide,
    Sides,
    classify_sides,
    find_band,
    heights_near,
    outline_grey,
    surroundings,
)
from wafer_viewer.reconstruct.gates.focus_along_walls import (
    Near,
    Tile,
    Wall,
    noise_fall,
    peaks_near,
    side_heights_um,
    spread_wall,
    tangential_levels,
    tangential_margin_px,
    vectors_px,
)
from wafer_viewer.reconstruct.gates.gate import LEAST_FRAMES
from wafer_viewer.reconstruct.gates.mirrored_light import mirrored_light
from wafer_viewer.reconstruct.gates.silhouettes import DARK_SHARE_OF_WHITE, Silhouette, silhouette_of
from wafer_viewer.reconstruct.preprocess.camera_noise import CameraNoise

AGREEING_STEPS = 0.75
"""Tolerance for heights of the same surface, in steps of the resolution: tests/truth/unseen.py."""

LEAST_GAP = 4
"""Minimum rival gap in frames: focus along a wall is smoothed over three frames and placed by three more."""

OUTLINE_MARGIN_PX = 2
"""Distance from the outline of a wall over which sides are least certain, in pixels: tests/truth/unseen.py."""

LINE_PX = 11
"""Side of the largest square that a bright line cannot hold, in pixels: tests/truth/unseen.py."""

_TILE_PX = 96
"""Side of the tiles that are searched along walls, and rows that are read together, in pixels."""
_WALL_SIGMA = 3.0
"""Standard deviation of the Gaussian that smooths wall directions, in pixels of half resolution."""
_BORDER = 3
"""Margin at the border of the band, beyond which values are unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class BleedingEdges:
    """Wall side, expected height and wall-parallel focus of the pixels near walls, all arrays [row, col].

    side: codes of `EdgeSide`; expected_um: the height of the pixel's side further from the wall, NaN where none is
    near; z_um: where the focus along the wall peaks near the expected height, NaN where it does not or was not
    looked for; fall: how far it falls from there, in powers of two, NaN where it was not looked for or the sweep ends
    too soon; min_fall: what noise reaches once in a hundred pixels; below_line: whether a bright line above the
    expected height is near, bool; tolerance_um: how far from the expected height a height may be.
    """

    side: NDArray[np.uint8]
    expected_um: NDArray[np.float32]
    z_um: NDArray[np.float32]
    fall: NDArray[np.float32]
    min_fall: float
    below_line: NDArray[np.bool_]
    tolerance_um: float

    def agrees(self, z_um: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Return whether heights agree with those of their side further from the wall, bool [row, col]."""
        return np.abs(z_um - self.expected_um) < self.tolerance_um

    @property
    def unconfirmed(self) -> NDArray[np.bool_]:
        """Mask of pixels on the dark side whose focus along the wall has no peak near the expected height.

        Their focus changes across the wall only: it is that of the wall's outline, or of bleeding light.
        """
        return (self.side == EdgeSide.DARK) & (self.fall <= self.min_fall)

    @property
    def along(self) -> NDArray[np.bool_]:
        """Mask of pixels whose focus along the wall gives an accepted height, bool [row, col].

        The last pixels before the outline are excluded: which side they belong to is least certain.
        """
        uncertain = highest(self.side >= EdgeSide.BRIGHT, 2 * OUTLINE_MARGIN_PX + 1)
        dark = (self.side == EdgeSide.DARK) & ~uncertain
        return dark & (self.fall > self.min_fall) & self.agrees(self.z_um)


@dataclass(frozen=True, slots=True)
class EdgeSearch:
    """Parameters of the edge search: recipe mode, window and gap, camera noise, and axial resolution.

    standing_frames: number of frames through which the silhouette of a wall persists.
    """

    mode: Literal["band", "rims"]
    window: int
    gap: int
    standing_frames: float
    camera: CameraNoise
    resolution_um: float

    @property
    def reach_px(self) -> int:
        """Distance from a wall over which light bleeds visibly and the focus window sees the other side."""
        return max(BAND_REACH_PX, self.window - 1)

    @property
    def tolerance_um(self) -> float:
        """Maximum difference between two heights of the same surface."""
        return AGREEING_STEPS * self.resolution_um


def edge_search_for(recipe: Recipe, search: Search, n_frames: int, resolution_um: float) -> EdgeSearch | None:
    """Return the edge search of a settled recipe; None if edges or gating are disabled, and in short stacks."""
    if recipe.edges == "none" or float(recipe.min_confidence) <= 0 or n_frames < LEAST_FRAMES:
        return None
    gap, standing_frames = max(search.gap, LEAST_GAP), STANDING_GAPS * search.gap
    return EdgeSearch(recipe.edges, _window_along(search), gap, standing_frames, search.camera, resolution_um)


def _window_along(search: Search) -> int:
    """Return the window of the focus along walls: a box applied twice, as wide as that of the search.

    A box applied n times is as wide as a single box sqrt(n) times its size.
    """
    boxes = focus_measures()[search.measure].passes
    return 2 * round((search.window * np.sqrt(boxes / 2) - 1) / 2) + 1


def find_edges(
    frames: Frames,
    how: EdgeSearch,
    peaks: Peaks,
    origin: NDArray[np.uint8],
    threads: int | None = None,
    silhouette: Silhouette | None = None,
) -> BleedingEdges | None:
    """Return the edges of a field, None where there are no walls.

    threads: all cores if omitted; silhouette: that of the frames, where it is known.
    """
    silhouette, passed = silhouette or silhouette_of(frames, threads), origin == Origin.MEASURED
    if not (silhouette.standing >= WALL.faint_frames(how.standing_frames)).any():
        return None
    heights_um = heights_near(silhouette, how.standing_frames, peaks.z_um, passed)
    mirrored = mirrored_light(frames, heights_um, how.gap, how.camera, threads)
    around = surroundings(silhouette, how.standing_frames, heights_um, passed, mirrored, how.tolerance_um, how.reach_px)
    band = find_band(silhouette, how.standing_frames, how.reach_px, around)
    if band is None:
        return None
    dark_counts = DARK_SHARE_OF_WHITE * frames.clipped_counts
    sides = classify_sides(_outline_grey(frames, band, threads), band, dark_counts)
    dark_um, bright_um = side_heights_um(
        peaks.z_um, passed, peaks.all_in_focus, band, sides, dark_counts, how.tolerance_um, around.level
    )
    expected_um = _expected(sides.side, dark_um, bright_um)
    wall_um = doubled(frames.z_um.astype(np.float32)[band.frame], frames.shape)
    below_line = _beside_lines(sides.side, how.reach_px) & (expected_um < wall_um - how.tolerance_um)
    z_um, fall = (np.full(frames.shape, np.nan, np.float32) for _ in range(2))
    near = near_of(how, frames)
    searched = (sides.side == EdgeSide.DARK) & ~below_line & (origin != Origin.CLIPPED) & (how.mode == "rims")
    wanted = np.where(searched, expected_um, np.float32(np.nan))
    _search_along(frames, how, near, wanted, _wall_of(band, sides), z_um, fall, threads)
    return BleedingEdges(sides.side, expected_um, z_um, fall, noise_fall(near), below_line, how.tolerance_um)


def _beside_lines(side: NDArray[np.uint8], reach_px: int) -> NDArray[np.bool_]:
    """Return a mask of the dark pixels that have a bright line near them and nothing wider; bool [row, col].

    Bright pixels at the end of the band belong to a surface that goes on beyond it.
    """
    bright = side >= EdgeSide.BRIGHT
    wide = highest(lowest(bright, LINE_PX), LINE_PX)
    goes_on = bright & highest(side == EdgeSide.AWAY, 3)
    near_wide = highest(wide, 2 * reach_px + 1) | highest(goes_on, 4 * reach_px + 1)
    return (side == EdgeSide.DARK) & highest(bright & ~wide, 2 * reach_px + 1) & ~near_wide


def near_of(how: EdgeSearch, frames: Frames) -> Near:
    """Return the search range: one frame beyond the tolerance, with fall measured over the rival gap."""
    return Near(how.window, int(np.ceil(how.tolerance_um / frames.step_um)) + 1, how.gap)


def judge_edges(
    z_um: NDArray[np.float32], origin: NDArray[np.uint8], edges: BleedingEdges
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Return the heights and origins of a field corrected at its edges.

    Near a wall a measured height is retained where it agrees with its side and the focus along the wall confirms it,
    unless it lies below a line, and is marked as bleeding otherwise; where the focus along the wall gives a height it
    is used, whatever the other gates decided.
    """
    along = edges.along
    near_edge = edges.side != EdgeSide.AWAY
    retained = edges.agrees(z_um) & ~edges.unconfirmed & ~edges.below_line
    bleeding = near_edge & (origin == Origin.MEASURED) & ~retained
    origin = np.where(bleeding, np.uint8(Origin.BLEEDING_EDGE), origin)
    return np.where(along, edges.z_um, z_um), np.where(along, np.uint8(Origin.MEASURED), origin)


def warm_up(frames: Frames, window: int) -> None:
    """Compile the kernels, or load the cached compilation, on a few small frames."""
    silhouette = silhouette_of(frames, threads=1)
    half = tuple(-(-n // 2) for n in frames.shape)
    inside = np.ones(half, np.bool_)
    band = Band(inside, np.zeros(half, np.uint16), np.ones(half, np.float32), BAND_REACH_PX, inside)
    sides = classify_sides(_outline_grey(frames, band, threads=1), band, dark_counts=1.0)
    shape = frames.shape
    z_um, passed = np.zeros(shape, np.float32), np.ones(shape, np.bool_)
    heights_um = heights_near(silhouette, 0.0, z_um, passed)
    mirrored = mirrored_light(frames, heights_um, 1, CameraNoise(0.5, 80.0), threads=1)
    level = surroundings(silhouette, 0.0, heights_um, passed, mirrored, 1.0, BAND_REACH_PX).level
    side_heights_um(z_um, passed, np.zeros(shape, frames.dtype), band, sides, 1.0, 1.0, level)
    blurred(z_um, 1.0)
    expected, wall = np.zeros(shape, np.float32), Wall(*(np.ones(half, np.float32) for _ in range(3)))
    how = EdgeSearch("rims", window, 1, 1.0, CameraNoise(0.5, 80.0), 1.0)
    _search_along(frames, how, Near(window, 1, 1), expected, wall, np.empty(shape, np.float32), expected.copy(), 1)


def _expected(
    side: NDArray[np.uint8], dark_um: NDArray[np.float32], bright_um: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the cell height of each pixel's side; NaN for pixels on neither side."""
    dark, bright = (repeated(cells, COARSE_PX, side.shape) for cells in (dark_um, bright_um))
    return np.where(side == EdgeSide.DARK, dark, np.where(side == EdgeSide.BRIGHT, bright, np.float32(np.nan)))


def _wall_of(band: Band, sides: Sides) -> Wall:
    """Return the direction along the nearest wall at half resolution, from the dark-bright boundary."""
    reliable = lowest(band.inside, 2 * _BORDER + 1)
    down, right = (np.where(reliable, slope, np.float32(0)) for slope in np.gradient(blurred(sides.bright_share, 1.0)))
    xx, xy, yy = (blurred(product, _WALL_SIGMA) for product in (right * right, right * down, down * down))
    across = np.float32(0.5) * np.arctan2(2 * xy, xx - yy)
    return Wall.along(np.cos(across), -np.sin(across))


def _search_along(
    frames: Frames,
    how: EdgeSearch,
    near: Near,
    wanted_um: NDArray[np.float32],
    wall: Wall,
    z_um: NDArray[np.float32],
    fall: NDArray[np.float32],
    threads: int | None,
) -> None:
    """Search tile by tile for peaks of the focus along the wall near the expected heights."""
    is_wanted, expected = np.isfinite(wanted_um), np.full(wanted_um.shape, np.nan, np.float32)
    expected[is_wanted] = np.interp(wanted_um[is_wanted], frames.z_um, np.arange(frames.n_frames))
    stabiliser, margin = Stabiliser.of(how.camera), tangential_margin_px(how.window)

    def search_tiles(todo: Iterator[Window]) -> None:
        for at in todo:
            part = np.ascontiguousarray(expected[at])  # a separate specialisation would be compiled for views
            first = max(0, int(np.fmin.reduce(part, axis=None)) - near.frames)
            stop = min(frames.n_frames, int(np.fmax.reduce(part, axis=None)) + 2 + near.frames)
            tile = Tile.make(stop - first, part.shape, how.window)
            block = read_part(frames, StackWindow(*at, slice(first, stop)), margin)
            tangential_levels(block, how.window, stabiliser, _around(wall, *at, margin - 3), tile)
            found_um, found_fall = np.empty(part.shape, np.float32), np.empty(part.shape, np.float32)
            peaks_near(tile.levels, first, frames.z_um, part, near.reach, near.gap, found_um, found_fall)
            np.copyto(z_um[at], found_um, where=is_wanted[at])
            np.copyto(fall[at], found_fall, where=is_wanted[at])

    on_threads(search_tiles, _tiles(is_wanted), threads)


def _around(wall: Wall, rows: slice, cols: slice, margin: int) -> Wall:
    """Return the wall directions at full resolution for a tile and a margin around it."""
    shape = rows.stop - rows.start + 2 * margin, vectors_px(cols.stop - cols.start + 2 * margin)
    around = Wall(*(np.empty(shape, np.float32) for _ in wall))
    spread_wall(wall, rows.start - margin, cols.start - margin, around)
    return around


def _tiles(wanted: NDArray[np.bool_]) -> Iterator[Window]:
    """Yield the tightest tiles around the wanted pixels of a grid of squares."""
    n_rows, n_cols = wanted.shape
    for top in range(0, n_rows, _TILE_PX):
        band = wanted[top : top + _TILE_PX]
        lefts = np.flatnonzero(np.logical_or.reduceat(band.any(axis=0), range(0, n_cols, _TILE_PX))) * _TILE_PX
        for left in lefts.tolist():
            tile = band[:, left : left + _TILE_PX]
            rows, cols = np.flatnonzero(tile.any(axis=1)), np.flatnonzero(tile.any(axis=0))
            yield slice(top + rows[0], top + rows[-1] + 1), slice(left + cols[0], left + cols[-1] + 1)


def _outline_grey(frames: Frames, band: Band, threads: int | None) -> NDArray[np.float32]:
    """Return the grey image used to classify the sides of walls."""
    grey = np.zeros(frames.shape, np.float32)

    def add_parts(todo: Iterator[StackWindow]) -> None:
        for (rows, *_), block in developed(frames, todo, 1):
            outline_grey(block, rows.start, band.inside, band.frame, grey[rows])

    on_threads(add_parts, stripes(frames.shape, _TILE_PX), threads)
    return grey
