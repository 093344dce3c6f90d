"""On which side of a wall a pixel lies: the dark or the bright one, told from the frame where the wall is sharpest.

In that frame, at the foot of the wall or at its top, light does not bleed over it. A pixel next to the outline that is
neither clearly dark nor clearly bright belongs to no side. Maps at half resolution are those of `silhouette`.
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
"""A silhouette that stands through twice the frames to a rival is a wall; patterns in one plane reach half of that."""

BAND_REACH_PX = 8
"""How far beyond the silhouette itself, which is some 8 pixels wide, light bleeds visibly."""

SURELY_DARK, SURELY_BRIGHT = 0.35, 0.78
"""Where between the darkest (0) and the brightest (1) grey near by a pixel at the outline is sure, in logarithms."""

DEEP_SHARE = 0.9
"""A grain here and there may be brighter or darker than its side."""

_LEVELS_PX = 5
_REACH = BAND_REACH_PX // 2
_NEARER_FIRST = (_REACH // 2, 2 * _REACH)
_RIDGE_SHARE = 0.8
_CONTRAST_UNIT = 16384.0
_LOG_UNIT = 4096.0


class EdgeSide(IntEnum):
    """Where a pixel lies: away from walls, on the dark or the bright side of one, or on its outline."""

    AWAY = 0
    DARK = 1
    BRIGHT = 2
    OUTLINE = 3


class Band(NamedTuple):
    """The surroundings of walls at half resolution: bool inside, the frame to tell sides from, the walls themselves.

    contrast: of the silhouette along the middle of a wall, 0 elsewhere.
    """

    inside: Bools
    frame: UInt16s
    contrast: Float32s


class Sides(NamedTuple):
    """side: codes of `EdgeSide` [row, col]; bright_share: how many of 2 x 2 pixels are brighter than the threshold, and
    threshold: ln(grey + dark) that parts dark from bright, both [row / 2, col / 2], 0 where the band is not.
    """

    side: UInt8s
    bright_share: Float32s
    threshold: Float32s


def find_band(silhouette: Silhouette, gap: int) -> Band | None:
    """The surroundings of all walls, None without any; gap: frames from a peak to a rival."""
    wall = silhouette.standing >= STANDING_GAPS * gap
    if not wall.any():
        return None
    contrast = np.where(wall, silhouette.contrast, np.float32(0))
    ridge = np.where(contrast >= np.float32(_RIDGE_SHARE) * highest(contrast, _LEVELS_PX), contrast, np.float32(0))
    frame = (_strongest(ridge, silhouette.frame) & np.uint32(0xFFFF)).astype(np.uint16)
    return Band(highest(wall, 2 * _REACH + 1), frame, ridge)


def tell_sides(grey: NDArray[np.float32], band: Band, dark_counts: float) -> Sides:
    """The sides of a field; grey: of `outline_grey`, [row, col]."""
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
    """The mean of 3 x 3 pixels in the frame of the band, where the band is, for the rows of `grey` [row, col].

    source: frames that begin at row `first` of the field, which is even; inside, frame: of the whole field.
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
    """What the wall next to each pixel carries, in the lower 16 bits; 0 where there is no wall.

    Of the walls that are about as near the strongest one speaks: a bright line beside a wall speaks for itself only.
    """
    strength = np.minimum(contrast * np.float32(_CONTRAST_UNIT), np.float32(65535)).astype(np.uint32)
    keyed = np.where(contrast > 0, (strength << np.uint32(16)) | carried.astype(np.uint32), np.uint32(0))
    found = np.zeros_like(keyed)
    for reach in _NEARER_FIRST:
        found = np.where(found > 0, found, highest(keyed, 2 * reach + 1))
    return found


def _spread(contrast: NDArray[np.float32], log: NDArray[np.float32]) -> NDArray[np.float32]:
    """A logarithm as it is at the wall next to each pixel, smoothed a little."""
    found = _strongest(contrast, (np.clip(log, 0, 15) * np.float32(_LOG_UNIT)).astype(np.uint16))
    return mean_of_known(found & np.uint32(0xFFFF), found > 0, 3) / np.float32(_LOG_UNIT)


def _extremes(log: NDArray[np.float32], inside: NDArray[np.bool_]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The least and the greatest logarithm near by; 0 outside."""
    far, none = np.float32(1e3), np.float32(0)
    low, high = lowest(np.where(inside, log, far), _LEVELS_PX), highest(np.where(inside, log, -far), _LEVELS_PX)
    return np.where(inside, low, none), np.where(inside, high, none)
