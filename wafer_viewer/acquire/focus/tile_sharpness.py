"""Sharpness over z of the tiles of a field, and the z at which each tile is in focus.

The sharpness of a tile is the mean square of its grey slope along a row, divided by its mean grey. Photon noise grows
as the grey itself, so without texture the sharpness does not depend on z, whatever the light does out of focus. Every
fourth row is read: a frame of 1440 x 1080 px takes a few ms, less than the period of a camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SharpnessParameters:
    """Size of a tile, and what counts as focus. Set by tests/bench/bench_follow_focus.py on seeds below 1000.

    Parameters
    ----------
    tile_px : int, px
        Side of a tile.
    tiles_across : int
        Number of tiles across a small frame, whose tiles are smaller.
    least_px : int, px
        Smallest side of a tile; of larger ones as many pixels are read, in rows at equal distances.
    contrast : float
        Sharpness of a tile in focus over that out of focus, its second lowest value over z.
    ignored : float
        Share of the tiles in focus at either end of the heights that is ignored as stray.
    least_tiles : int
        Smallest number of tiles in focus of a field that has a focus.
    """

    tile_px: int = 48
    tiles_across: int = 8
    least_px: int = 24
    contrast: float = 1.8
    ignored: float = 0.02
    least_tiles: int = 4


SHARPNESS = SharpnessParameters()


def sharpness(image: Image, parameters: SharpnessParameters = SHARPNESS) -> Floats:
    """Return the sharpness of the tiles of a frame.

    Parameters
    ----------
    image : uint8 or uint16 [row, col]
        Frame.
    parameters : SharpnessParameters
        Size of a tile.

    Returns
    -------
    float64 [tile row, tile col]
        Mean square slope over mean grey, in counts.
    """
    least, few = parameters.least_px, min(image.shape)
    side = min(parameters.tile_px, max(least, few // parameters.tiles_across), few)
    step = max(1, side**2 // least**2)
    n_rows, n_cols = image.shape[0] // side, image.shape[1] // side
    grey = image[: n_rows * side, : n_cols * side].reshape(n_rows, side, n_cols * side)[:, ::step].astype(np.float32)
    slope = np.zeros_like(grey)
    np.subtract(grey[:, :, 2:], grey[:, :, :-2], out=slope[:, :, 1:-1])
    shape = n_rows, grey.shape[1], n_cols, side
    energy = np.square(slope).reshape(shape).mean((1, 3), dtype=np.float64)
    return energy / (grey.reshape(shape).mean((1, 3), dtype=np.float64) + 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class TilePeaks:
    """Focus of the tiles of a field [tile row, tile col].

    z_um: NaN where a tile has no focus; at_low, at_high: the sharpness is greatest at that end of the frames.
    """

    z_um: Floats
    at_low: NDArray[np.bool_]
    at_high: NDArray[np.bool_]

    @property
    def n_in_focus(self) -> int:
        """Number of tiles in focus."""
        return int(np.count_nonzero(np.isfinite(self.z_um)))


def tile_peaks(
    z_um: Floats, curves: Floats, parameters: SharpnessParameters = SHARPNESS, fall_um: float = np.inf
) -> TilePeaks:
    """Return the z of greatest sharpness of each tile, interpolated between frames.

    Parameters
    ----------
    z_um : float64 [k]
        Heights of the frames, in any order.
    curves : float64 [k, tile row, tile col]
        Their sharpness.
    parameters : SharpnessParameters
        What counts as focus.
    fall_um : float
        Distance from the focus at which the sharpness has fallen, on one side at least, by the contrast of a focus.
        Over a wall, where no surface is, it hardly does.

    Returns
    -------
    TilePeaks
        Focus of each tile. A tile that is sharpest in the first or last frame has the z of that frame.
    """
    order = np.argsort(z_um)
    z_um, levels = z_um[order], np.log(np.maximum(curves[order], 1e-9))
    top = levels.argmax(axis=0)
    highest = np.take_along_axis(levels, top[None], 0)[0]
    floor = np.partition(levels, min(1, len(levels) - 1), axis=0)[min(1, len(levels) - 1)]
    focused = highest - np.maximum(floor, _beside(z_um, levels, top, fall_um)) > np.log(parameters.contrast)
    inner = np.clip(top, 1, max(1, len(z_um) - 2))
    before, at, after = (
        np.take_along_axis(levels, np.clip(inner + i, 0, len(z_um) - 1)[None], 0)[0] for i in (-1, 0, 1)
    )
    bend = np.minimum(before - 2 * at + after, -1e-9)
    shift = np.where(top == inner, np.clip(0.5 * (before - after) / bend, -0.5, 0.5), 0.0)
    found = np.interp(top + shift, np.arange(len(z_um)), z_um)
    last = len(z_um) - 1
    return TilePeaks(np.where(focused, found, np.nan), focused & (top == 0), focused & (top == last))


def _beside(z_um: Floats, levels: Floats, top: NDArray[np.intp], fall_um: float) -> Floats:
    """Return the lower one of the levels fall_um under and over the top of each tile; -inf where both are outside."""
    at = np.full(top.shape, np.inf)
    for side_um in (z_um[top] - fall_um, z_um[top] + fall_um):
        inside = (side_um >= z_um[0]) & (side_um <= z_um[-1])
        k = np.abs(z_um[:, None, None] - np.where(inside, side_um, 0.0)).argmin(0)
        at = np.where(inside, np.minimum(at, np.take_along_axis(levels, k[None], 0)[0]), at)
    return np.where(np.isfinite(at), at, -np.inf)


def touched_ends(peaks: TilePeaks, parameters: SharpnessParameters = SHARPNESS) -> tuple[bool, bool]:
    """Return whether heights in focus reach the lowest and the highest frame, by more tiles than are ignored as stray.

    Without focus, it may lie beyond either end.

    Parameters
    ----------
    peaks : TilePeaks
        Focus of the tiles.
    parameters : SharpnessParameters
        Number of tiles that is ignored.

    Returns
    -------
    tuple of bool
        For the lowest and the highest frame.
    """
    stray = max(parameters.least_tiles - 1, parameters.ignored * peaks.n_in_focus)
    if peaks.n_in_focus < parameters.least_tiles:
        return True, True
    return int(peaks.at_low.sum()) > stray, int(peaks.at_high.sum()) > stray
