"""Detection and correction of false heights near walls, caused by light that bleeds over them.

Light of a defocused bright surface falls on the adjacent dark one and ends in a contour that runs along the wall
between them; so do the wall's own outline and the reflection of a polished rim. The second derivative along the wall
is insensitive to all three, and responds to the texture of the surface nearly as well as a Laplacian does:

L = t H t, with H the Hessian of the stabilised grey under a binomial of 5 x 5 pixels and t the direction of the wall;
l = log2(noise + mean3x3(L^2)), F = box_w(box_w(l)) as for the log-Laplacian.

A nearby height limits the search to about a dozen frames, in tiles of a few thousand pixels that stay in cache.

Walls are silhouettes that persist through many frames. Near them a height is accepted only where it agrees with the
surface on the same side further from the wall. On the dark side the focus is also measured along the wall, which is
insensitive to light that bleeds across it; this recovers the rims of dies, and a height that it does not confirm is
that of the wall's outline, which the focus window sees on both sides.

A polished rim shows as a bright line. Between the line and the wall lies the dark slope of the die, without texture,
and the focus window there sees the texture of the lower ground beyond. On ground below a line a height is therefore
accepted only where the focus along the wall confirms it in a small window.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.numerics.filters.sliding_filters import blurred, doubled, highest, lowest, repeated
from wafer_viewer.numerics.intrinsics import quick_log2
from wafer_viewer.numerics.jit import (
    Float32s,
    Float64s,
    Greys,
    Int,
    Real,
    aligned,
    inlined_part,
    lean_kernel,
    lean_part,
)
from wafer_viewer.reconstruct.focus.focus_volume import COARSE_PX, on_threads, read_part, row_parts, source_of_rows
from wafer_viewer.reconstruct.focus.log_laplacian import Stabiliser
from wafer_viewer.reconstruct.focus.peak import Peaks
from wafer_viewer.reconstruct.focus.peak_search import Search
from wafer_viewer.reconstruct.gates.edge_sides import (
    BAND_REACH_PX,
    STANDING_GAPS,
    Band,
    EdgeSide,
    Sides,
    classify_sides,
    find_band,
    outline_grey,
    side_heights_um,
    smooth_surroundings,
)
from wafer_viewer.reconstruct.gates.gate import LEAST_FRAMES
from wafer_viewer.reconstruct.gates.silhouettes import DARK_SHARE_OF_WHITE, Silhouette, silhouette_of
from wafer_viewer.reconstruct.preprocess.camera_noise import CameraNoise
from wafer_viewer.reconstruct.preprocess.frames import Frames

NOISE_ENERGY = 0.0239
"""E[L^2] on white noise of unit variance, averaged over all directions; it varies by a seventh with direction."""

_TAPS_PX = 4
"""The binomial reaches two pixels, the Hessian and the mean of the energy one each."""


class Wall(NamedTuple):
    """Direction along the wall as weights of the Hessian's xx, xy and yy, float32 [row, col] of a block."""

    xx: Float32s
    xy: Float32s
    yy: Float32s

    @classmethod
    def along(cls, tangent_rows: NDArray[np.float32], tangent_cols: NDArray[np.float32]) -> Wall:
        """Return the weights for the components of unit vectors along the wall."""
        return cls(tangent_cols**2, 2 * tangent_cols * tangent_rows, tangent_rows**2)


class Tile(NamedTuple):
    """Work arrays of the kernels: planes and rows with margins, and the output levels [k, row, col]."""

    stable: Float32s
    smooth: Float32s
    second: Float32s
    energy: Float32s
    logs: Float32s
    rows: Float32s
    levels: Float32s

    @classmethod
    def make(cls, n_frames: int, shape: tuple[int, int], window: int) -> Tile:
        """Allocate a tile of `n_frames` frames."""
        margin = tangential_margin_px(window)
        rows, cols = shape[0] + 2 * margin, shape[1] + 2 * margin
        smooth, second, energy, logs = (aligned((rows, cols), np.float32) for _ in range(4))
        stable, lines = aligned((cols,), np.float32), aligned((4, cols), np.float32)
        return cls(stable, smooth, second, energy, logs, lines, aligned((n_frames, *shape), np.float32))


@dataclass(frozen=True, slots=True)
class Near:
    """Parameters of the search for a peak near an expected height.

    window: focus window; reach: frames on either side of the expected one; gap: frames from the peak to its flanks.
    """

    window: int
    reach: int
    gap: int

    @property
    def frames(self) -> int:
        """Number of frames read on either side of the expected one."""
        return self.reach + max(self.gap, 3)


def tangential_margin_px(window: int) -> int:
    """Return the margin of a block beyond its pixels."""
    return window - 1 + _TAPS_PX


@lean_kernel
def tangential_levels(block: Greys, window: Int, stabiliser: Stabiliser, wall: Wall, tile: Tile) -> None:
    """Compute the levels of a block [k, row, col], which extends `tangential_margin_px` beyond the tile.

    wall: at the pixels of the block less three at each border, where the Hessian is defined.
    """
    n_rows = block.shape[1]
    scale, offset = np.float32(stabiliser.scale), np.float32(stabiliser.offset)
    for k in range(block.shape[0]):
        for r in range(n_rows):
            _stabilised(block[k, r], scale, offset, tile.stable)
            _binomial(tile.stable, tile.smooth[r])
        for r in range(n_rows - 4):
            _binomial_down(tile.smooth, r, tile.second[r])
        for r in range(n_rows - 6):
            _energy_row(tile.second, r, tile.rows, wall.xx[r], wall.xy[r], wall.yy[r], tile.energy[r])
        for r in range(n_rows - 8):
            _log_row(tile.energy, r, tile.rows[0], tile.logs[r])
        _double_box(tile.logs, n_rows - 8, window, tile.rows, tile.smooth, tile.levels[k])


@inlined_part
def _stabilised(grey: Greys, scale: Real, offset: Real, stable: Float32s) -> None:
    for x in range(stable.size):
        stable[x] = np.sqrt(np.float32(grey[x]) * scale + offset)


@inlined_part
def _binomial(values: Float32s, out: Float32s) -> None:
    """Apply [1 4 6 4 1] / 16 along a row; the last four pixels are undefined."""
    a, b, c, d = values[1:], values[2:], values[3:], values[4:]
    part = np.float32(1 / 16)
    for x in range(values.size - 4):
        out[x] = part * (values[x] + d[x] + np.float32(4) * (a[x] + c[x]) + np.float32(6) * b[x])


@inlined_part
def _binomial_down(plane: Float32s, r: Int, out: Float32s) -> None:
    v, a, b, c, d = plane[r], plane[r + 1], plane[r + 2], plane[r + 3], plane[r + 4]
    part = np.float32(1 / 16)
    for x in range(out.size):
        out[x] = part * (v[x] + d[x] + np.float32(4) * (a[x] + c[x]) + np.float32(6) * b[x])


@lean_part
def _energy_row(
    plane: Float32s, r: Int, rows: Float32s, w_xx: Float32s, w_xy: Float32s, w_yy: Float32s, energy: Float32s
) -> None:
    """Compute the squared second derivative along the wall, with the Hessian from rows r to r + 2."""
    a, b, c = plane[r], plane[r + 1], plane[r + 2]
    mean, bend, slope = rows[0], rows[1], rows[2]
    quarter, half, two = np.float32(0.25), np.float32(0.5), np.float32(2)
    for x in range(mean.size):
        outer = a[x] + c[x]
        mean[x] = quarter * outer + half * b[x]
        bend[x] = outer - two * b[x]
        slope[x] = c[x] - a[x]
    mean_1, mean_2, bend_1, bend_2, slope_2 = mean[1:], mean[2:], bend[1:], bend[2:], slope[2:]
    for x in range(w_xx.size):
        xx = mean[x] + mean_2[x] - two * mean_1[x]
        yy = quarter * (bend[x] + bend_2[x]) + half * bend_1[x]
        xy = quarter * (slope_2[x] - slope[x])
        along = w_xx[x] * xx + w_xy[x] * xy + w_yy[x] * yy
        energy[x] = along * along


@lean_part
def _log_row(energy: Float32s, r: Int, columns: Float32s, out: Float32s) -> None:
    a, b, c = energy[r], energy[r + 1], energy[r + 2]
    part, floor = np.float32(1 / 9), np.float32(NOISE_ENERGY)
    for x in range(columns.size):
        columns[x] = a[x] + b[x] + c[x]
    one, two = columns[1:], columns[2:]
    for x in range(columns.size - 8):
        out[x] = quick_log2(floor + part * (columns[x] + one[x] + two[x]))


@lean_part
def _double_box(logs: Float32s, n_logs: Int, window: Int, rows: Float32s, sums: Float32s, levels: Float32s) -> None:
    """Apply the mean of `window` pixels twice, along columns and rows."""
    twice, spread, again = rows[0], rows[1], rows[2]
    twice[:] = 0
    part = np.float32(1 / window**4)
    for r in range(n_logs):
        _slide(
            sums[max(r - 1, 0)], np.float32(r > 0), logs[r], logs[max(r - window, 0)], np.float32(r >= window), sums[r]
        )
        if r >= window - 1:
            leaving = np.float32(r >= 2 * window - 1)
            _slide(twice, np.float32(1), sums[r], sums[max(r - window, 0)], leaving, twice)
        if r >= 2 * window - 2:
            _along(twice, window, spread)
            _along(spread, window, again)
            _scaled(again, part, levels[r - 2 * window + 2])


@lean_part
def _slide(before: Float32s, held: Real, new: Float32s, old: Float32s, full: Real, total: Float32s) -> None:
    """Update a running sum: add the new row and subtract the old one; held and full: 0 or 1."""
    for x in range(total.size):
        total[x] = held * before[x] + new[x] - full * old[x]


@lean_part
def _along(values: Float32s, window: Int, out: Float32s) -> None:
    n = values.size - window + 1
    for x in range(n):
        out[x] = values[x]
    for j in range(1, window):
        ahead = values[j:]
        for x in range(n):
            out[x] += ahead[x]


@inlined_part
def _scaled(values: Float32s, part: Real, level: Float32s) -> None:
    for x in range(level.size):
        level[x] = part * values[x]


@lean_kernel
def peaks_near(
    levels: Float32s,
    first: Int,
    z_um: Float64s,
    expected: Float32s,
    reach: Int,
    gap: Int,
    height: Float32s,
    fall: Float32s,
) -> None:
    """Find the focus peak within `reach` frames of the expected one, and its fall on both sides.

    levels: [k, row, col] of the frames from `first` on; expected: frames [row, col], NaN where nothing is expected;
    height: um, NaN where there is no peak; fall: in powers of two.
    """
    last = levels.shape[0] - 1
    for y in range(expected.shape[0]):
        for x in range(expected.shape[1]):
            height[y, x], fall[y, x] = np.nan, 0.0
            if not expected[y, x] >= 0:
                continue
            middle = np.int64(expected[y, x] + 0.5) - first
            best = max(middle - reach, 0)
            for k in range(best + 1, min(middle + reach, last) + 1):
                if levels[k, y, x] > levels[best, y, x]:
                    best = k
            if best - gap < 0 or best + gap > last:
                continue
            top = levels[best, y, x]
            if levels[best - 1, y, x] <= top >= levels[best + 1, y, x]:
                fall[y, x] = top - max(levels[best - gap, y, x], levels[best + gap, y, x])
                height[y, x] = _height(levels, best, first, z_um, y, x)


@lean_part
def _height(levels: Float32s, best: Int, first: Int, z_um: Float64s, y: Int, x: Int) -> Real:
    """Interpolate with a symmetric tent on levels smoothed by [1 2 1] / 4 along z.

    Specular grains produce peaks with two maxima.
    """
    last = levels.shape[0] - 1
    if best < 3 or best > last - 3:
        return z_um[first + best]
    at, left, top, right = best, np.float32(0), np.float32(-1e9), np.float32(0)
    for k in range(best - 1, best + 2):
        here = _smoothed(levels, k, y, x)
        if here > top:
            at, left, top, right = k, _smoothed(levels, k - 1, y, x), here, _smoothed(levels, k + 1, y, x)
    steep = max(top - left, top - right)
    offset = 0.5 * (right - left) / steep if steep > 0 else 0.0
    offset = min(max(offset, -0.5), 0.5)
    k = first + at
    step = z_um[k + 1] - z_um[k] if offset > 0 else z_um[k] - z_um[k - 1]
    return z_um[k] + offset * step


@lean_part
def _smoothed(levels: Float32s, k: Int, y: Int, x: Int) -> Real:
    return np.float32(0.25) * (levels[k - 1, y, x] + levels[k + 1, y, x]) + np.float32(0.5) * levels[k, y, x]


AGREEING_STEPS = 0.75
"""Tolerance for heights of the same surface, in steps of the resolution: tests/truth/unseen.py."""

LEAST_GAP = 4
"""Minimum rival gap in frames: focus along a wall is smoothed over three frames and placed by three more."""

OUTLINE_MARGIN_PX = 2
"""Distance from the outline of a wall over which sides are least certain, in pixels: tests/truth/unseen.py."""

LINE_PX = 11
"""Side of the largest square that a bright line cannot hold, in pixels: tests/truth/unseen.py."""

LINE_WINDOW_PX = 7
"""Largest focus window along a wall below a line, in pixels: tests/truth/unseen.py."""

_TILE_PX = 96
"""Side of the tiles that are searched along walls, and rows that are read together, in pixels."""
_WALL_SIGMA = 3.0
"""Standard deviation of the Gaussian that smooths wall directions, in pixels of half resolution."""
_BORDER = 3
"""Margin at the border of the band, beyond which values are unknown."""
_NOISE_SIDE_PX = 320
"""Side of the patch of simulated noise, in pixels."""
_PERCENTILE = 99.0
"""Percentile of the fall on noise: 1 % of the pixels exceed it."""
_SEED = 20240301
"""Seed of the simulated noise."""


@dataclass(frozen=True, slots=True, eq=False)
class BleedingEdges:
    """Wall side, expected height and wall-parallel focus of the pixels near walls, all arrays [row, col].

    side: codes of `EdgeSide`; expected_um: the height of the pixel's side further from the wall, NaN where none is
    near; z_um: where the focus along the wall peaks near that height, NaN where it does not or was not looked for;
    fall: how far it falls from there, in powers of two, min_fall what noise reaches once in a hundred pixels;
    below_line: whether a bright line above the expected height is near, bool; tolerance_um: how far from the expected
    height a height may be.
    """

    side: NDArray[np.uint8]
    expected_um: NDArray[np.float32]
    z_um: NDArray[np.float32]
    fall: NDArray[np.float32]
    min_fall: NDArray[np.float32]
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
    if not (silhouette.standing >= how.standing_frames).any():
        return None
    smooth = smooth_surroundings(silhouette, how.standing_frames, peaks.z_um, passed, how.tolerance_um)
    band = find_band(silhouette, how.standing_frames, how.reach_px, smooth)
    if band is None:
        return None
    dark_counts = DARK_SHARE_OF_WHITE * frames.clipped_counts
    sides = classify_sides(_outline_grey(frames, band, threads), band, dark_counts)
    dark_um, bright_um = side_heights_um(
        peaks.z_um, passed, peaks.all_in_focus, band, sides, dark_counts, how.tolerance_um
    )
    expected_um = _expected(sides.side, dark_um, bright_um)
    wall_um = doubled(frames.z_um.astype(np.float32)[band.frame], frames.shape)
    below_line = _beside_lines(sides.side, how.reach_px) & (expected_um < wall_um - how.tolerance_um)
    z_um, fall = (np.full(frames.shape, np.nan, np.float32) for _ in range(2))
    min_fall = np.zeros(frames.shape, np.float32)
    fine = replace(how, window=min(how.window, LINE_WINDOW_PX))
    searched = (sides.side == EdgeSide.DARK) & (origin != Origin.CLIPPED) & (how.mode == "rims")
    wall = _wall_of(band, sides)
    for search, where in ((how, ~below_line), (fine, below_line)):
        if not where.any():
            continue
        near = near_of(search, frames)
        min_fall[where] = noise_fall(near)
        wanted = np.where(searched & where, expected_um, np.float32(np.nan))
        _search_along(frames, search, near, wanted, wall, z_um, fall, threads)
    return BleedingEdges(sides.side, expected_um, z_um, fall, min_fall, below_line, how.tolerance_um)


def _beside_lines(side: NDArray[np.uint8], reach_px: int) -> NDArray[np.bool_]:
    """Return a mask of the dark pixels that have a bright line near them and nothing wider; bool [row, col]."""
    bright = side >= EdgeSide.BRIGHT
    wide = highest(lowest(bright, LINE_PX), LINE_PX)
    return (side == EdgeSide.DARK) & highest(bright & ~wide, 2 * reach_px + 1) & ~highest(wide, 2 * reach_px + 1)


def near_of(how: EdgeSearch, frames: Frames) -> Near:
    """Return the search range: one frame beyond the tolerance, with fall measured over the rival gap."""
    return Near(how.window, int(np.ceil(how.tolerance_um / frames.step_um)) + 1, how.gap)


def judge_edges(
    z_um: NDArray[np.float32], origin: NDArray[np.uint8], edges: BleedingEdges
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Return the heights and origins of a field corrected at its edges.

    Near a wall a measured height is retained where it agrees with its side and the focus along the wall confirms it,
    unless it lies below a line, and is marked as bleeding otherwise; where the focus along the wall gives a height it
    is used, whatever the gates decided.
    """
    along = edges.along
    near_edge = edges.side != EdgeSide.AWAY
    retained = edges.agrees(z_um) & ~edges.unconfirmed & ~edges.below_line
    bleeding = near_edge & (origin == Origin.MEASURED) & ~retained
    origin = np.where(bleeding, np.uint8(Origin.BLEEDING_EDGE), origin)
    return np.where(along, edges.z_um, z_um), np.where(along, np.uint8(Origin.MEASURED), origin)


def warm_up(frames: Frames, window: int) -> None:
    """Compile the kernels, or load the cached compilation, on a few small frames."""
    silhouette_of(frames, threads=1)
    half = tuple(-(-n // 2) for n in frames.shape)
    band = Band(np.ones(half, np.bool_), np.zeros(half, np.uint16), np.ones(half, np.float32), BAND_REACH_PX)
    classify_sides(_outline_grey(frames, band, threads=1), band, dark_counts=1.0)
    shape = frames.shape
    expected, wall = np.zeros(shape, np.float32), Wall(*(np.ones(half, np.float32) for _ in range(3)))
    how = EdgeSearch("rims", window, 1, 1.0, CameraNoise(0.5, 80.0), 1.0)
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

    def one(at: tuple[slice, slice]) -> None:
        part, (rows, cols) = (
            np.ascontiguousarray(expected[at]),
            at,
        )  # a separate specialisation would be compiled for views
        first = max(0, int(np.nanmin(part)) - near.frames)
        stop = min(frames.n_frames, int(np.nanmax(part)) + 2 + near.frames)
        tile = Tile.make(stop - first, part.shape, how.window)
        block = read_part(frames, slice(first, stop), rows, cols, margin)
        tangential_levels(block, how.window, stabiliser, _around(wall, rows, cols, margin - 3), tile)
        found_um, found_fall = np.empty(part.shape, np.float32), np.empty(part.shape, np.float32)
        peaks_near(tile.levels, first, frames.z_um, part, near.reach, near.gap, found_um, found_fall)
        np.copyto(z_um[at], found_um, where=is_wanted[at])
        np.copyto(fall[at], found_fall, where=is_wanted[at])

    on_threads(one, _tiles(is_wanted), threads)


def _around(wall: Wall, rows: slice, cols: slice, margin: int) -> Wall:
    """Return the wall directions at full resolution for a tile and a margin around it."""
    limits = wall.xx.shape
    at = [
        np.clip(np.arange(part.start - margin, part.stop + margin) // 2, 0, n - 1)
        for part, n in zip((rows, cols), limits, strict=True)
    ]
    return Wall(*(plane.take(at[0], axis=0).take(at[1], axis=1) for plane in wall))


def _tiles(wanted: NDArray[np.bool_]) -> Iterator[tuple[slice, slice]]:
    """Yield the tightest tiles around the wanted pixels of a grid of squares."""
    n_rows, n_cols = wanted.shape
    for top in range(0, n_rows, _TILE_PX):
        for left in range(0, n_cols, _TILE_PX):
            tile = wanted[top : top + _TILE_PX, left : left + _TILE_PX]
            rows, cols = np.flatnonzero(tile.any(axis=1)), np.flatnonzero(tile.any(axis=0))
            if rows.size:
                yield slice(top + rows[0], top + rows[-1] + 1), slice(left + cols[0], left + cols[-1] + 1)


def _outline_grey(frames: Frames, band: Band, threads: int | None) -> NDArray[np.float32]:
    """Return the grey image used to classify the sides of walls."""
    grey = np.zeros(frames.shape, np.float32)

    def one(rows: slice) -> None:
        outline_grey(source_of_rows(frames, rows, 1), rows.start, band.inside, band.frame, grey[rows])

    on_threads(one, row_parts(frames.shape[0], _TILE_PX), threads)
    return grey
