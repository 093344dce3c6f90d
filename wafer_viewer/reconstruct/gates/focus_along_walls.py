"""Focus measured along walls, and the peak of it nearest to an expected height.

Light of a defocused bright surface falls on the adjacent dark one and ends in a contour that runs along the wall
between them; so do the wall's own outline and the reflection of a polished rim. The second derivative along the wall
is insensitive to all three, and responds to the texture of the surface nearly as well as a Laplacian does:

L = t H t, with H the Hessian of the stabilised grey under a binomial of 5 x 5 pixels and t the direction of the wall;
l = log2(noise + mean3x3(L^2)), F = box_w(box_w(l)) as for the log-Laplacian.

A nearby height limits the search to about a dozen frames, in tiles of a few thousand pixels that stay in cache.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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
from wafer_viewer.reconstruct.focus.log_laplacian import Stabiliser
from wafer_viewer.reconstruct.preprocess.camera_noise import CameraNoise

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
