"""Focus measured along walls, and the peak of it nearest to an expected height.

Light of a defocused bright surface falls on the adjacent dark one and ends in a contour that runs along the wall
between them; so do the wall's own outline and the reflection of a polished rim. The second derivative along the wall
is insensitive to all three, and responds to the texture of the surface nearly as well as a Laplacian does:

L = t H t, with H the Hessian of the stabilised grey under a binomial of 5 x 5 pixels and t the direction of the wall;
l = log2(noise + mean3x3(L^2)), F = box_w(box_w(l)) as for the log-Laplacian.

A nearby height limits the search to about a dozen frames, in tiles of a few thousand pixels that stay in cache.

A cell of 4 x 4 pixels is an anchor of a side when it lies entirely on it, its pixels passed the gate, and it is flat
together with its neighbours: false heights by bleeding light are not flat, they rise with the distance from the wall
divided by the aperture. Within a focus window of the wall a dark die without texture shows the texture of the bright
trench, in focus and flat: there an anchor of the dark side has another height than the bright side. Small groups of
cells are not accepted.

The bright line of a polished rim parts two heights, and no anchor counts beyond it; a bright line on one surface, such
as a seal ring, parts none.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.numerics.filters.sliding_filters import halved, highest, lowest, mean, mean_of_valid, nearest
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
    quick_log2,
)
from wafer_viewer.reconstruct.focus.focus_volume import COARSE_PX
from wafer_viewer.reconstruct.focus.log_laplacian import Stabiliser
from wafer_viewer.reconstruct.gates.edge_sides import REACH_CELLS, Band, Sides, cell_means, cell_medians
from wafer_viewer.reconstruct.preprocess.camera_noise import CameraNoise

# --------------------------------------------------------------------------------------------------------- side heights


@dataclass(frozen=True, slots=True)
class AnchorParameters:
    """Limits of the cells of 4 x 4 pixels that give the height of a side of a wall.

    Parameters
    ----------
    enough_neighbours : int
        Smallest number of cells with a height among 3 x 3 cells around an anchor.
    enough_cells : int
        Smallest number of connected anchors.
    solid_cells : int, cells
        Side of the square that anchors fill: the outline of a polished rim is a strip of one height.
    around_cells : int, cells
        Distance within which the heights of a side are compared with those of its anchors.
    agreeing_share : float
        Smallest share of these heights that agrees with an anchor.
    pure_share : float
        Smallest fraction of the pixels around an anchor that lie on its side.
    bright_cells : int, cells
        Distance within which these pixels lie on the bright side.
    dark_cells : int, cells
        Distance within which they lie on the dark side.
    apart : float
        Smallest difference from the bright side, in tolerances, of an anchor of the dark side nearer to the wall than
        the focus window reaches.
    barrier_share : float
        Bright fraction of a cell that parts dark cells: the bright line of a polished rim is between two heights.
    """

    enough_neighbours: int = 5
    enough_cells: int = 10
    solid_cells: int = 2
    around_cells: int = 6
    agreeing_share: float = 0.5
    pure_share: float = 0.95
    bright_cells: int = 1
    dark_cells: int = 2
    apart: float = 2.0
    barrier_share: float = 0.4


ANCHOR = AnchorParameters()


def side_heights_um(
    z_um: NDArray[np.float32],
    passed: NDArray[np.bool_],
    all_in_focus: Image,
    band: Band,
    sides: Sides,
    dark_counts: float,
    tolerance_um: float,
    level: NDArray[np.bool_],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the heights of the dark and the bright side, float32 [row / 4, col / 4]; NaN without an anchor nearby.

    z_um, passed, all_in_focus: [row, col], passed is the gate mask; tolerance_um: tolerance for equal heights; level:
    from `surroundings`, cells in which a bright line parts no heights.
    """
    near = highest(halved(band.inside) > 0, 2 * (REACH_CELLS + 1) + 1)
    heights = cell_medians(z_um, passed, near)
    far_dark, near_dark, bright = _cell_sides(all_in_focus, band, sides, dark_counts)
    nothing = np.float32(np.nan)
    bright_um = _from_anchors(np.where(bright, heights, nothing), tolerance_um)
    apart = np.abs(heights - bright_um) > ANCHOR.apart * tolerance_um
    lines = (halved(sides.bright_share) >= ANCHOR.barrier_share) & ~level
    dark_um = _from_anchors(np.where(far_dark | (near_dark & apart), heights, nothing), tolerance_um, lines)
    return dark_um, bright_um


def _cell_sides(
    all_in_focus: Image, band: Band, sides: Sides, dark_counts: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks of the cells on the dark side beyond the window, entirely on the dark, and on the bright side.

    Beyond the band, cells are classified by their grey against the threshold at the nearest wall.
    """
    coverage = halved(band.inside)
    in_band = coverage > 0
    per_coverage = 1 / np.maximum(coverage, np.float32(1e-6))
    grey = cell_means(all_in_focus, in_band.shape)
    _, nearest_cell = nearest(in_band)
    threshold = (halved(sides.threshold) * per_coverage)[nearest_cell]
    brighter = np.log(grey + np.float32(dark_counts)) >= threshold
    bright = np.where(in_band, halved(sides.bright_share) * per_coverage, brighter)
    around = (-(-band.reach_px // COARSE_PX), ANCHOR.dark_cells, ANCHOR.bright_cells)
    beyond, beside, bright = (mean(bright, 2 * cells + 1) for cells in around)
    return beyond <= 1 - ANCHOR.pure_share, beside <= 1 - ANCHOR.pure_share, bright >= ANCHOR.pure_share


def _from_anchors(
    heights: NDArray[np.float32], tolerance_um: float, barriers: NDArray[np.bool_] | None = None
) -> NDArray[np.float32]:
    """Return the height of the nearest anchor that no cell of `barriers` parts from here; NaN beyond its reach."""
    from skimage.morphology import opening

    square = np.ones((ANCHOR.solid_cells, ANCHOR.solid_cells), np.bool_)
    anchors = _large(opening(_flat(heights, tolerance_um), square))
    anchors = _large(anchors & _agreed(heights, anchors, tolerance_um))
    found = np.full_like(heights, np.nan)
    if not anchors.any():
        return found
    anchor_um = _smoothed_side(heights, anchors)
    for box, own in _parted(barriers, anchors):
        distance, at = nearest(anchors[box] & own)
        reached = own & (distance <= REACH_CELLS)
        found[box][reached] = anchor_um[box][at][reached]
    return found


def _parted(
    barriers: NDArray[np.bool_] | None, anchors: NDArray[np.bool_]
) -> Iterator[tuple[tuple[slice, slice], NDArray[np.bool_]]]:
    """Yield the parts between barriers that hold anchors: the box around each, and its mask in the box.

    A cell of a barrier belongs to the nearest part.
    """
    from scipy.ndimage import find_objects
    from skimage.measure import label

    if barriers is None:
        yield (slice(None), slice(None)), np.ones(anchors.shape, np.bool_)
        return
    parts: NDArray[np.int64] = np.asarray(label(~barriers, connectivity=1))
    if not parts.any():
        return
    parts = parts[nearest(parts > 0)[1]]
    boxes = find_objects(parts)
    for number in np.unique(parts[anchors]):
        box = boxes[number - 1]
        yield box, parts[box] == number


def _agreed(heights: NDArray[np.float32], anchors: NDArray[np.bool_], tolerance_um: float) -> NDArray[np.bool_]:
    """Return the cells around which enough heights agree with that of their nearest anchor."""
    if not anchors.any():
        return anchors
    size, known = 2 * ANCHOR.around_cells + 1, np.isfinite(heights)
    anchor_um = _smoothed_side(heights, anchors)[nearest(anchors)[1]]
    agreeing = known & (np.abs(heights - anchor_um) < tolerance_um)
    return mean(agreeing, size) >= ANCHOR.agreeing_share * mean(known, size)


def _large(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    from skimage.morphology import remove_small_objects

    return remove_small_objects(cells, max_size=ANCHOR.enough_cells - 1)


def _smoothed_side(heights: NDArray[np.float32], anchors: NDArray[np.bool_]) -> NDArray[np.float32]:
    return mean_of_valid(heights, anchors, 3)


def _flat(heights: NDArray[np.float32], tolerance_um: float) -> NDArray[np.bool_]:
    """Return the cells with enough neighbours, all of the same height."""
    finite = np.isfinite(heights)
    return (_ranges(heights) < tolerance_um) & finite & (9 * mean(finite, 3) > ANCHOR.enough_neighbours - 0.5)


def _ranges(heights: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the range of the heights of 3 x 3 cells, -inf where there is none."""
    finite, far = np.isfinite(heights), np.float32(np.inf)
    return highest(np.where(finite, heights, -far), 3) - lowest(np.where(finite, heights, far), 3)


# ---------------------------------------------------------------------------------------------------- focus along walls


NOISE_ENERGY = 0.0239
"""E[L^2] on white noise of unit variance, averaged over all directions; it varies by a seventh with direction."""

LANES = 16
"""Rows are processed in full vectors of so many pixels, and are as much longer, because loops read ahead."""

_TAPS_PX = 4
"""The binomial reaches two pixels, the Hessian and the mean of the energy one each."""
_NOISE_SIDE_PX = 320
"""Side of the patch of simulated noise, in pixels."""
_PERCENTILE = 99.0
"""Percentile of the fall on noise: 1 % of the pixels exceed it."""
_SEED = 20240301
"""Seed of the simulated noise."""


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
        rows, cols = shape[0] + 2 * margin, vectors_px(shape[1] + 2 * margin) + max(LANES, window)
        smooth, second, energy, logs = (aligned((rows, cols), np.float32) for _ in range(4))
        stable, lines = aligned((cols,), np.float32), aligned((4, cols), np.float32)
        return cls(stable, smooth, second, energy, logs, lines, np.empty((n_frames, *shape), np.float32))


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


def vectors_px(cols: int) -> int:
    """Return a number of pixels rounded up to full vectors."""
    return -(-cols // LANES) * LANES


def tangential_margin_px(window: int) -> int:
    """Return the margin of a block beyond its pixels."""
    return window - 1 + _TAPS_PX


@lean_kernel
def spread_wall(half: Wall, top: Int, left: Int, wall: Wall) -> None:
    """Write the directions of a field, known at half resolution, to a part that begins at row `top`, column `left`."""
    last_row, last_col = half.xx.shape[0] - 1, half.xx.shape[1] - 1
    for y in range(wall.xx.shape[0]):
        i = min(max((top + y) // 2, 0), last_row)
        for x in range(wall.xx.shape[1]):
            j = min(max((left + x) // 2, 0), last_col)
            wall.xx[y, x], wall.xy[y, x], wall.yy[y, x] = half.xx[i, j], half.xy[i, j], half.yy[i, j]


@lean_kernel
def tangential_levels(block: Greys, window: Int, stabiliser: Stabiliser, wall: Wall, tile: Tile) -> None:
    """Compute the levels of a block [k, row, col], which extends `tangential_margin_px` beyond the tile.

    wall: at the pixels of the block less three at each border, where the Hessian is defined, or in longer rows. Columns
    beyond the block are undefined.
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
    for x in range(grey.size):
        stable[x] = np.sqrt(np.float32(grey[x]) * scale + offset)


@inlined_part
def _binomial(values: Float32s, out: Float32s) -> None:
    """Apply [1 4 6 4 1] / 16 along a row."""
    a, b, c, d = values[1:], values[2:], values[3:], values[4:]
    part = np.float32(1 / 16)
    for x in range(values.size - LANES):
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
    for x in range(min(w_xx.size, energy.size - LANES)):
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
    for x in range(out.size - LANES):
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
    """Sum `window` pixels along a row, four in a pass."""
    n = values.size - max(window, LANES)
    for x in range(n):
        out[x] = values[x]
    for j in range(1, window - 3, 4):
        a, b, c, d = values[j:], values[j + 1 :], values[j + 2 :], values[j + 3 :]
        for x in range(n):
            out[x] = out[x] + a[x] + b[x] + c[x] + d[x]
    for j in range(window - (window - 1) % 4, window):
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
    height: um, NaN where there is no peak; fall: in powers of two, NaN where the sweep ends within `gap` of the peak,
    so that it cannot be told.
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
                fall[y, x] = np.nan
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
