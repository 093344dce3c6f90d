"""Classification of pixels near a wall into dark side, bright side and outline.

The frame in which the wall is sharpest is used: there, at the foot or the top of the wall, light does not bleed over
it. A pixel next to the outline that is neither clearly dark nor clearly bright is assigned to no side. Maps at half
resolution are those of `edge_silhouettes`.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.array_types import Bools, Float32s, UInt8s, UInt16s, Whole
from wafer_viewer.numerics.filters.sliding_filters import doubled, halved, highest, lowest, mean_of_known
from wafer_viewer.numerics.jit import lean_kernel
from wafer_viewer.reconstruct.focus.focus_volume import StackSource
from wafer_viewer.reconstruct.gates.edge_silhouettes import Silhouette

STANDING_GAPS = 2.0
"""A silhouette is a wall if it persists for twice the rival gap; patterns in one plane reach half of that."""

BAND_REACH_PX = 8
"""Distance beyond the silhouette, which is about 8 pixels wide, over which light bleeds visibly."""

SURELY_DARK, SURELY_BRIGHT = 0.35, 0.78
"""Thresholds for certain pixels at the outline, from the local minimum (0) to maximum (1) of log grey."""

DEEP_SHARE = 0.9
"""Fraction of neighbours on one side that classifies an uncertain pixel; single grains may differ from their side."""

_LEVELS_PX = 5
_REACH = BAND_REACH_PX // 2
_NEARER_FIRST = (_REACH // 2, 2 * _REACH)
_RIDGE_SHARE = 0.8
_CONTRAST_UNIT = 16384.0
_LOG_UNIT = 4096.0


class EdgeSide(IntEnum):
    """Position of a pixel: away from walls, on the dark or the bright side of one, or on its outline."""

    AWAY = 0
    DARK = 1
    BRIGHT = 2
    OUTLINE = 3


class Band(NamedTuple):
    """Surroundings of walls at half resolution: mask, frame for the side classification, and wall contrast.

    inside: bool; frame: index of the frame; contrast: of the silhouette along the middle of a wall, 0 elsewhere.
    """

    inside: Bools
    frame: UInt16s
    contrast: Float32s


class Sides(NamedTuple):
    """Side classification of a field.

    side: codes of `EdgeSide` [row, col]; bright_share: fraction of 2 x 2 pixels that are brighter than the threshold;
    threshold: ln(grey + dark) that separates dark from bright; both [row / 2, col / 2], 0 outside the band.
    """

    side: UInt8s
    bright_share: Float32s
    threshold: Float32s


def find_band(silhouette: Silhouette, gap: int) -> Band | None:
    """Return the surroundings of all walls, None if there are none; gap: frames from a peak to a rival."""
    wall = silhouette.standing >= STANDING_GAPS * gap
    if not wall.any():
        return None
    contrast = np.where(wall, silhouette.contrast, np.float32(0))
    ridge = np.where(contrast >= np.float32(_RIDGE_SHARE) * highest(contrast, _LEVELS_PX), contrast, np.float32(0))
    frame = (_strongest(ridge, silhouette.frame) & np.uint32(0xFFFF)).astype(np.uint16)
    return Band(highest(wall, 2 * _REACH + 1), frame, ridge)


def classify_sides(grey: NDArray[np.float32], band: Band, dark_counts: float) -> Sides:
    """Classify the sides of a field; grey: from `outline_grey`, [row, col]."""
    halves = halved(grey)
    log = np.log(halves + np.float32(dark_counts))
    low, high = _extremes(log, band.inside)
    threshold = _spread(band.contrast, np.float32(0.5) * (low + high))
    surely_dark, middle, surely_bright = (
        doubled(np.exp(level) - np.float32(dark_counts), grey.shape)
        for level in (
            low + np.float32(SURELY_DARK) * (high - low),
            threshold,
            low + np.float32(SURELY_BRIGHT) * (high - low),
        )
    )
    inside, bright = doubled(band.inside, grey.shape), grey >= middle
    share = np.where(band.inside, halved(bright), np.float32(0))
    around = doubled(mean_of_known(share, band.inside, 3), grey.shape)
    side = np.where(inside, np.uint8(EdgeSide.OUTLINE), np.uint8(EdgeSide.AWAY))
    side[inside & ~bright & ((grey < surely_dark) | (around <= 1 - DEEP_SHARE))] = EdgeSide.DARK
    side[inside & bright & ((grey > surely_bright) | (around >= DEEP_SHARE))] = EdgeSide.BRIGHT
    return Sides(side, share, np.where(band.inside, threshold, np.float32(0)))


@lean_kernel
def outline_grey(source: StackSource, first: Whole, inside: Bools, frame: UInt16s, grey: Float32s) -> None:
    """Compute 3 x 3 means in the band's frame, inside the band, for the rows of `grey` [row, col].

    source: frames that begin at row `first` of the field, which is even; inside, frame: of the entire field.
    """
    images = source.images
    rows, cols = images.shape[1] - 1, images.shape[2] - 1
    for y in range(grey.shape[0]):
        for x in range(grey.shape[1]):
            i, j = (first + y) // 2, x // 2
            if not inside[i, j]:
                continue
            slot, total = source.slots[frame[i, j]], 0
            for r in range(source.top + y - 1, source.top + y + 2):
                for c in range(source.left + x - 1, source.left + x + 2):
                    total += np.int64(images[slot, min(max(r, 0), rows), min(max(c, 0), cols)])
            grey[y, x] = total / 9.0


def _strongest(contrast: NDArray[np.float32], carried: NDArray[np.uint16]) -> NDArray[np.uint32]:
    """Return `carried` of the wall next to each pixel in the lower 16 bits; 0 where there is no wall.

    Of walls at about the same distance the strongest is used: a bright line near a wall affects itself only.
    """
    strength = np.minimum(contrast * np.float32(_CONTRAST_UNIT), np.float32(65535)).astype(np.uint32)
    keyed = np.where(contrast > 0, (strength << np.uint32(16)) | carried.astype(np.uint32), np.uint32(0))
    found = np.zeros_like(keyed)
    for reach in _NEARER_FIRST:
        found = np.where(found > 0, found, highest(keyed, 2 * reach + 1))
    return found


def _spread(contrast: NDArray[np.float32], log: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return a logarithm propagated from the nearest wall, slightly smoothed."""
    found = _strongest(contrast, (np.clip(log, 0, 15) * np.float32(_LOG_UNIT)).astype(np.uint16))
    return mean_of_known(found & np.uint32(0xFFFF), found > 0, 3) / np.float32(_LOG_UNIT)


def _extremes(log: NDArray[np.float32], inside: NDArray[np.bool_]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the local minimum and maximum of the logarithm; 0 outside."""
    far, none = np.float32(1e3), np.float32(0)
    low, high = lowest(np.where(inside, log, far), _LEVELS_PX), highest(np.where(inside, log, -far), _LEVELS_PX)
    return np.where(inside, low, none), np.where(inside, high, none)
