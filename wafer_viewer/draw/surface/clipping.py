"""Clipping codes of the pixels of a height map, and depth shading for point clouds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.clipping import LEFT_OUT, Clip, LeftOut
from wafer_viewer.model.surface.height_map import HeightMap

Floats = NDArray[np.float64]

DRAWN = 0
CODES: dict[LeftOut, int] = {reason: code for code, reason in enumerate(LEFT_OUT, 1)}

_RADII_PX = (1, 3, 9)
_DIRECTIONS = (
    *((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)),
    *((0.7, 0.7), (-0.7, 0.7), (0.7, -0.7), (-0.7, -0.7)),
)
_DARKEST, _PER_SLOPE = 0.28, 0.55
"""Darkest shade and its rate, chosen so that baked shading resembles eye-dome lighting."""


def clip_codes(part: HeightMap, clip: Clip) -> NDArray[np.uint8]:
    """Return the reason why each pixel is clipped as a code of `CODES`, or `DRAWN`; uint8 [row, col]."""
    return point_codes(part.x_um[None, :], part.y_um[:, None], part.z_um, part.confidence, clip)


def point_codes(
    x_um: Floats, y_um: Floats, z_um: NDArray[np.float32], confidence: NDArray[np.float32], clip: Clip
) -> NDArray[np.uint8]:
    """Return the reason why each point is not drawn.

    Parameters
    ----------
    x_um, y_um
        Positions in um; they broadcast to the shape of `z_um`.
    z_um, confidence
        Height in um and confidence from 0 to 1 of each point.
    clip
        Clipping limits.

    Returns
    -------
    NDArray[np.uint8]
        A code of `CODES`, or `DRAWN`, in the shape of `z_um`.
    """
    codes = np.zeros(z_um.shape, np.uint8)
    if clip.box_um is not None:
        x0, y0, x1, y1 = clip.box_um
        inside = ((y_um >= y0) & (y_um <= y1)) & ((x_um >= x0) & (x_um <= x1))
        _mark(codes, ~inside, "box")
    if clip.heights_um is not None:
        low, high = clip.heights_um
        _mark(codes, (z_um < low) | (z_um > high), "height")
    if clip.least_confidence > 0:
        _mark(codes, confidence < clip.least_confidence, "confidence")
    if clip.slab is not None and clip.slab.before != "show":
        line = clip.slab.line
        _mark(codes, line.along_and_across_um(x_um, y_um)[1] < -line.width_um / 2, "slab")
    return codes


def depth_shade(z_um: NDArray[np.float32], pixel_um: float, gain: float) -> NDArray[np.float32]:
    """Return the brightness of each pixel under occlusion by its surroundings, 0.28 ... 1; `gain` scales slopes.

    z_um: heights without gaps. It does not depend on the camera, so it is baked into a tile once.
    """
    steepness = np.zeros_like(z_um)
    for radius in _RADII_PX:
        for dx, dy in _DIRECTIONS:
            higher = _shifted(z_um, round(dy * radius), round(dx * radius)) - z_um
            steepness += np.maximum(0, higher) / np.float32(radius * pixel_um * len(_DIRECTIONS))
    return np.maximum(_DARKEST, np.exp(-_PER_SLOPE * gain * steepness)).astype(np.float32)


def _mark(codes: NDArray[np.uint8], out: NDArray[np.bool_], why: LeftOut) -> None:
    codes[(codes == DRAWN) & out] = CODES[why]


def _shifted(z_um: NDArray[np.float32], down: int, right: int) -> NDArray[np.float32]:
    """Return the heights shifted by some pixels, with edge values repeated."""
    rows = np.clip(np.arange(z_um.shape[0]) + down, 0, z_um.shape[0] - 1)
    cols = np.clip(np.arange(z_um.shape[1]) + right, 0, z_um.shape[1] - 1)
    return z_um[rows[:, None], cols[None, :]]
