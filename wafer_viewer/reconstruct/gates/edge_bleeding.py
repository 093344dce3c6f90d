"""Detection and correction of false heights near walls, caused by light that bleeds from the bright side.

Walls are silhouettes that persist through many frames. Near them a height is accepted only where it agrees with the
surface of its own side further from the wall. On the dark side the focus is also measured along the wall, which is
insensitive to light that bleeds across it; this recovers the rims of dies.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.numerics.filters.sliding_filters import blurred, lowest
from wafer_viewer.reconstruct.focus.field_blocks import on_threads, read_part, row_parts, source_of_rows
from wafer_viewer.reconstruct.focus.focus_volume import COARSE_PX
from wafer_viewer.reconstruct.focus.log_laplacian import Stabiliser
from wafer_viewer.reconstruct.focus.peak import Peaks
from wafer_viewer.reconstruct.gates.edge_sides import Band, EdgeSide, Sides, classify_sides, find_band, outline_grey
from wafer_viewer.reconstruct.gates.edge_silhouettes import DARK_SHARE_OF_WHITE, silhouette_of
from wafer_viewer.reconstruct.gates.side_heights import side_heights_um
from wafer_viewer.reconstruct.gates.tangential_focus import (
    Near,
    Tile,
    Wall,
    peaks_near,
    tangential_levels,
    tangential_margin_px,
)
from wafer_viewer.reconstruct.preprocess.camera_noise import CameraNoise
from wafer_viewer.reconstruct.preprocess.frames import Frames

AGREEING_STEPS = 1.25
"""Tolerance for heights of the same surface, in steps of the resolution."""

_TILE_PX = 96
_WALL_SIGMA = 3.0
_BORDER = 3
"""Margin at the border of the band, beyond which values are unknown."""
_NOISE_SIDE_PX = 320
_PERCENTILE = 99.0
_SEED = 20240301


@dataclass(frozen=True, slots=True, eq=False)
class BleedingEdges:
    """Wall side, expected height and wall-parallel focus of the pixels near walls, all arrays [row, col].

    side: codes of `EdgeSide`; expected_um: the height of the pixel's side further from the wall, NaN where none is
    near; z_um: where the focus along the wall peaks near that height, NaN where it does not or was not looked for;
    fall: how far it falls from there, in powers of two, min_fall what noise reaches once in a hundred pixels;
    tolerance_um: how far from the expected height a height may be.
    """

    side: NDArray[np.uint8]
    expected_um: NDArray[np.float32]
    z_um: NDArray[np.float32]
    fall: NDArray[np.float32]
    min_fall: float
    tolerance_um: float

    def agrees(self, z_um: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Return whether heights agree with those of their side further from the wall, bool [row, col]."""
        return np.abs(z_um - self.expected_um) < self.tolerance_um

    @property
    def along(self) -> NDArray[np.bool_]:
        """Mask of pixels whose focus along the wall gives an accepted height, bool [row, col]."""
        return (self.side == EdgeSide.DARK) & (self.fall > self.min_fall) & self.agrees(self.z_um)


@dataclass(frozen=True, slots=True)
class EdgeSearch:
    """Parameters of the edge search: recipe mode, window and gap, camera noise, and axial resolution."""

    mode: Literal["band", "rims"]
    window: int
    gap: int
    camera: CameraNoise
    resolution_um: float

    @property
    def tolerance_um(self) -> float:
        """Maximum difference between two heights of the same surface."""
        return AGREEING_STEPS * self.resolution_um


def find_edges(
    frames: Frames, how: EdgeSearch, peaks: Peaks, origin: NDArray[np.uint8], threads: int | None = None
) -> BleedingEdges | None:
    """Return the edges of a field, None where there are no walls. threads: all cores if omitted."""
    band = find_band(silhouette_of(frames, threads), how.gap)
    if band is None:
        return None
    dark_counts = DARK_SHARE_OF_WHITE * frames.clipped_counts
    sides = classify_sides(_outline_grey(frames, band, threads), band, dark_counts)
    passed = origin == Origin.MEASURED
    dark_um, bright_um = side_heights_um(
        peaks.z_um, passed, peaks.all_in_focus, band, sides, dark_counts, how.tolerance_um
    )
    expected_um = _expected(sides.side, dark_um, bright_um)
    z_um, fall = np.full(frames.shape, np.nan, np.float32), np.zeros(frames.shape, np.float32)
    near = near_of(how, frames)
    if how.mode == "rims":
        wanted = np.where((sides.side == EdgeSide.DARK) & (origin != Origin.CLIPPED), expected_um, np.float32(np.nan))
        _search_along(frames, how, near, wanted, _wall_of(band, sides), z_um, fall, threads)
    return BleedingEdges(sides.side, expected_um, z_um, fall, noise_fall(near), how.tolerance_um)


def near_of(how: EdgeSearch, frames: Frames) -> Near:
    """Return the search range: one frame beyond the tolerance, with fall measured over the rival gap."""
    return Near(how.window, int(np.ceil(how.tolerance_um / frames.step_um)) + 1, how.gap)


def judge_edges(
    z_um: NDArray[np.float32], origin: NDArray[np.uint8], edges: BleedingEdges
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Return the heights and origins of a field corrected at its edges.

    Near a wall a measured height is retained where it agrees with its side and is marked as bleeding otherwise; where
    the focus along the wall gives a height it is used, whatever the gates decided.
    """
    along = edges.along
    beside = edges.side != EdgeSide.AWAY
    agrees = edges.agrees(z_um) & (edges.side != EdgeSide.OUTLINE)
    bleeding = beside & (origin == Origin.MEASURED) & ~agrees
    origin = np.where(bleeding, np.uint8(Origin.BLEEDING_EDGE), origin)
    return np.where(along, edges.z_um, z_um), np.where(along, np.uint8(Origin.MEASURED), origin)


def warm_up(frames: Frames, window: int) -> None:
    """Compile the kernels, or load the cached compilation, on a few small frames."""
    silhouette_of(frames, threads=1)
    half = tuple(-(-n // 2) for n in frames.shape)
    band = Band(np.ones(half, np.bool_), np.zeros(half, np.uint16), np.ones(half, np.float32))
    _outline_grey(frames, band, threads=1)
    shape = frames.shape
    expected, wall = np.zeros(shape, np.float32), Wall(*(np.ones(half, np.float32) for _ in range(3)))
    how = EdgeSearch("rims", window, 1, CameraNoise(0.5, 80.0), 1.0)
    _search_along(frames, how, Near(window, 1, 1), expected, wall, np.empty(shape, np.float32), expected.copy(), 1)


@lru_cache(maxsize=32)
def noise_fall(near: Near) -> float:
    """Return the 99th percentile of the fall on pure noise, for any expected peak position."""
    n_frames, margin = 2 * near.frames + 1, tangential_margin_px(near.window)
    side = _NOISE_SIDE_PX + 2 * margin
    noise = np.random.default_rng(_SEED).standard_normal((n_frames, side, side), dtype=np.float32)
    camera = CameraNoise(0.5, 80.0)
    grey = np.clip(noise * np.float32(camera.variance_counts2(128.0) ** 0.5) + np.float32(128.5), 0, 255)
    shape = _NOISE_SIDE_PX, _NOISE_SIDE_PX
    tile = Tile.make(n_frames, shape, near.window)
    turned = np.full((side - 6, side - 6), np.sqrt(0.5), np.float32)
    tangential_levels(grey.astype(np.uint8), near.window, Stabiliser.of(camera), Wall.along(turned, turned), tile)
    height, fall = np.empty(shape, np.float32), np.empty(shape, np.float32)
    expected = np.full(shape, near.frames, np.float32)
    peaks_near(tile.levels, 0, np.arange(n_frames, dtype=np.float64), expected, near.reach, near.gap, height, fall)
    return float(np.percentile(fall, _PERCENTILE))


def _expected(
    side: NDArray[np.uint8], dark_um: NDArray[np.float32], bright_um: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the cell height of each pixel's side; NaN for pixels on neither side."""
    rows, cols = (np.arange(n) // COARSE_PX for n in side.shape)
    dark, bright = (cells[rows[:, None], cols] for cells in (dark_um, bright_um))
    return np.where(side == EdgeSide.DARK, dark, np.where(side == EdgeSide.BRIGHT, bright, np.float32(np.nan)))


def _wall_of(band: Band, sides: Sides) -> Wall:
    """Return the direction along the nearest wall at half resolution, from the dark-bright boundary."""
    known = lowest(band.inside, 2 * _BORDER + 1)
    down, right = (np.where(known, slope, np.float32(0)) for slope in np.gradient(blurred(sides.bright_share, 1.0)))
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
    expected = np.interp(wanted_um, frames.z_um, np.arange(frames.n_frames)).astype(np.float32)
    stabiliser, margin = Stabiliser.of(how.camera), tangential_margin_px(how.window)

    def one(at: tuple[slice, slice]) -> None:
        part, (rows, cols) = np.ascontiguousarray(expected[at]), at  # views would be compiled for once more
        first = max(0, int(np.nanmin(part)) - near.frames)
        stop = min(frames.n_frames, int(np.nanmax(part)) + 2 + near.frames)
        tile = Tile.make(stop - first, part.shape, how.window)
        block = read_part(frames, slice(first, stop), rows, cols, margin)
        tangential_levels(block, how.window, stabiliser, _around(wall, rows, cols, margin - 3), tile)
        found_um, found_fall = np.empty(part.shape, np.float32), np.empty(part.shape, np.float32)
        peaks_near(tile.levels, first, frames.z_um, part, near.reach, near.gap, found_um, found_fall)
        z_um[at], fall[at] = found_um, found_fall

    on_threads(one, _tiles(np.isfinite(wanted_um)), threads)


def _around(wall: Wall, rows: slice, cols: slice, margin: int) -> Wall:
    """Return the wall directions at full resolution for a tile and a margin around it."""
    limits = wall.xx.shape
    at = [
        np.clip(np.arange(part.start - margin, part.stop + margin) // 2, 0, n - 1)
        for part, n in zip((rows, cols), limits, strict=True)
    ]
    return Wall(*(plane[at[0][:, None], at[1]] for plane in wall))


def _tiles(wanted: NDArray[np.bool_]) -> Iterator[tuple[slice, slice]]:
    """Yield the tightest tiles around the wanted pixels of a grid of squares."""
    n_rows, n_cols = wanted.shape
    for top in range(0, n_rows, _TILE_PX):
        for left in range(0, n_cols, _TILE_PX):
            here = wanted[top : top + _TILE_PX, left : left + _TILE_PX]
            rows, cols = np.flatnonzero(here.any(axis=1)), np.flatnonzero(here.any(axis=0))
            if rows.size:
                yield slice(top + rows[0], top + rows[-1] + 1), slice(left + cols[0], left + cols[-1] + 1)


def _outline_grey(frames: Frames, band: Band, threads: int | None) -> NDArray[np.float32]:
    """Return the grey image used to classify the sides of walls."""
    grey = np.zeros(frames.shape, np.float32)

    def one(rows: slice) -> None:
        outline_grey(source_of_rows(frames, rows, 1), rows.start, band.inside, band.frame, grey[rows])

    on_threads(one, row_parts(frames.shape[0], _TILE_PX), threads)
    return grey
