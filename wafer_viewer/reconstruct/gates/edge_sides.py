"""Sides of a wall: classification of the pixels near its silhouette.

A wall is a long silhouette that persists, unless heights or the light around it show that it is a pattern on a surface.
One between sides that are nearly as bright, or seen by a narrow cone of light, persists for few frames: it is a wall
all the same where the heights jump beside it or are few. Such a faint wall judges its dark side only, on which light
bleeds.

The frame in which the wall is sharpest is used: there, at the foot or the top of the wall, light does not bleed over
it. A pixel next to the outline that is neither clearly dark nor clearly bright is assigned to no side.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.numerics.filters.interpolation import local_planes
from wafer_viewer.numerics.filters.sliding_filters import doubled, halved, highest, lowest, mean, mean_of_valid
from wafer_viewer.numerics.jit import Bools, Float32s, Greys, Int, Int64s, UInt8s, UInt16s, lean_kernel
from wafer_viewer.reconstruct.focus.focus_volume import COARSE_PX
from wafer_viewer.reconstruct.frame_blocks import StackSource
from wafer_viewer.reconstruct.gates.silhouettes import Silhouette

# --------------------------------------------------------------------------------------------------------- height cells


REACH_PX = 48
"""Distance over which heights tell of a wall beside them."""

REACH_CELLS = REACH_PX // COARSE_PX
"""The same distance in cells."""

ENOUGH_PIXELS = 6
"""Smallest number of pixels of a cell that passed the gate, for a cell that has a height."""


def cell_means(image: Image, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return the means of cells of an image, whose border pixels repeat."""
    means = np.empty(shape, np.float32)
    _average_cells(np.ascontiguousarray(image), means)
    return means


@lean_kernel
def _average_cells(image: Greys, means: Float32s) -> None:
    last_row, last_col = image.shape[0] - 1, image.shape[1] - 1
    for i in range(means.shape[0]):
        for j in range(means.shape[1]):
            total = np.int64(0)
            for r in range(COARSE_PX * i, COARSE_PX * (i + 1)):
                for c in range(COARSE_PX * j, COARSE_PX * (j + 1)):
                    total += np.int64(image[min(r, last_row), min(c, last_col)])
            means[i, j] = total / COARSE_PX**2


def cell_medians(z_um: NDArray[np.float32], passed: NDArray[np.bool_], near: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the median height of the accepted pixels of each cell; NaN where they are few or the cell is far."""
    n_cells = int(np.count_nonzero(near))
    values, count = np.empty((n_cells, COARSE_PX**2), np.float32), np.empty(n_cells, np.int64)
    _take_cells(z_um, passed, near, values, count)
    values.sort(axis=1)
    middle = values[np.arange(n_cells), np.maximum(count - 1, 0) // 2]
    out = np.full(near.shape, np.nan, np.float32)
    out[near] = np.where(count >= ENOUGH_PIXELS, middle, np.float32(np.nan))
    return out


@lean_kernel
def _take_cells(z_um: Float32s, passed: Bools, near: Bools, values: Float32s, count: Int64s) -> None:
    """Take the accepted pixels of the cells that are near, one cell a row, and inf for the others; count: accepted."""
    n_rows, n_cols = z_um.shape
    n, far = 0, np.float32(np.inf)
    for i in range(near.shape[0]):
        for j in range(near.shape[1]):
            if not near[i, j]:
                continue
            m, accepted = 0, 0
            for r in range(COARSE_PX * i, COARSE_PX * (i + 1)):
                for c in range(COARSE_PX * j, COARSE_PX * (j + 1)):
                    inside = (r < n_rows) & (c < n_cols)
                    z = z_um[r, c] if inside and passed[r, c] else far
                    values[n, m] = z
                    m += 1
                    accepted += np.int64(z < far)
            count[n] = accepted
            n += 1


# ----------------------------------------------------------------------------------------------------------- edge sides


STANDING_GAPS = 1.0
"""Frames through which a silhouette persists that may be a wall, in rival gaps; coarse texture may reach twice that."""


@dataclass(frozen=True, slots=True)
class WallParameters:
    """Limits that distinguish the silhouettes of walls from those of coarse texture: tests/truth/unseen.py.

    Parameters
    ----------
    least_length_px : int, px
        Smallest length of a wall along rows or columns; texture forms patches.
    short_gaps : float
        Persistence beyond which a shorter silhouette is a wall too, relative to that of a long one.
    measured_share : float
        Share of measured pixels around texture that looks like a wall.
    jump_tolerances : float
        Smallest jump that is none of one surface, in tolerances for equal heights.
    jump_residual : float
        Root mean square distance from a plane that a jump in the middle of `plane_cells` leaves, in jumps.
    plane_cells : int, cells
        Side of the square of cells that one plane describes on a surface, however steep: tests/truth/relief.py.
    faint_share : float
        Persistence of a long silhouette that is a faint wall where heights say so, relative to that of a wall.
    faint_apart_px : int, px
        Smallest distance of a faint wall from others.
    faint_gap_px : int, px
        Largest gap between two pieces of a faint wall, which texture beside it breaks.
    uneven_cells : int, cells
        Distance of a jump from a faint wall.
    few_share : float
        Share of measured pixels around a faint wall below which they are few.
    level_cells : int, cells
        Distance around a bright line within which one measured surface shows that the line parts none: a seal ring.
    """

    least_length_px: int = 48
    short_gaps: float = 3.0
    measured_share: float = 0.97
    jump_tolerances: float = 2.0
    jump_residual: float = 0.25
    plane_cells: int = 5
    faint_share: float = 0.34
    faint_apart_px: int = 16
    faint_gap_px: int = 16
    uneven_cells: int = 3
    few_share: float = 0.8
    level_cells: int = 3

    def faint_frames(self, standing_frames: float) -> float:
        """Return the number of frames through which a faint wall persists; standing_frames: of a wall."""
        return max(1.0, self.faint_share * standing_frames)


WALL = WallParameters()

BAND_REACH_PX = 8
"""Distance beyond the silhouette, which is about 8 pixels wide, over which light bleeds visibly."""


@dataclass(frozen=True, slots=True)
class SideParameters:
    """Thresholds of the classification of pixels near a wall.

    Parameters
    ----------
    surely_dark : float
        Threshold for certainly dark pixels at the outline, from the local minimum (0) to maximum (1) of log grey.
    surely_bright : float
        Threshold for certainly bright pixels on the same scale.
    deep_share : float
        Fraction of neighbours on one side that classifies an uncertain pixel; single grains may differ from their side.
    levels_px : int, pixels of half resolution
        Side of the square in which the extremes of log grey and of contrast are taken.
    ridge_share : float
        Smallest contrast along the middle of a wall, relative to the largest nearby.
    """

    surely_dark: float = 0.35
    surely_bright: float = 0.78
    deep_share: float = 0.9
    levels_px: int = 5
    ridge_share: float = 0.8


SIDE = SideParameters()
_NEARER_FIRST = (0.25, 1.0)
"""Distances at which walls are searched for, one after the other, as shares of the reach of a band."""
_CONTRAST_UNIT = 16384.0
"""Integer steps per unit of contrast, in the upper 16 bits of a key."""
_LOG_UNIT = 4096.0
"""Integer steps per unit of a logarithm, in the lower 16 bits of a key."""


class EdgeSide(IntEnum):
    """Position of a pixel: away from walls, on the dark or the bright side of one, or on its outline."""

    AWAY = 0
    DARK = 1
    BRIGHT = 2
    OUTLINE = 3


class Band(NamedTuple):
    """Surroundings of walls at half resolution: mask, frame for the side classification, and wall contrast.

    inside: bool; frame: index of the frame; contrast: of the silhouette along the middle of a wall, 0 elsewhere;
    reach_px: how far the band extends beyond a silhouette, in pixels of the field; sure: bool, the part near walls that
    are not faint.
    """

    inside: Bools
    frame: UInt16s
    contrast: Float32s
    reach_px: int
    sure: Bools


class Surroundings(NamedTuple):
    """Evidence of the heights around silhouettes for and against walls, bool [row / 4, col / 4].

    smooth: one measured surface without jumps, or print, where no wall is; uneven: few heights, or jumps and some not
    measured, where even a faint silhouette is a wall; level: one measured surface without jumps on both sides of a
    line.
    """

    smooth: NDArray[np.bool_]
    uneven: NDArray[np.bool_]
    level: NDArray[np.bool_]


class Sides(NamedTuple):
    """Side classification of a field.

    side: codes of `EdgeSide` [row, col]; bright_share: fraction of 2 x 2 pixels that are brighter than the threshold;
    threshold: ln(grey + dark) that separates dark from bright; both [row / 2, col / 2], 0 outside the band.
    """

    side: UInt8s
    bright_share: Float32s
    threshold: Float32s


def find_band(
    silhouette: Silhouette,
    standing_frames: float,
    reach_px: int = BAND_REACH_PX,
    around: Surroundings | None = None,
) -> Band | None:
    """Return the surroundings of all walls, None if there are none.

    standing_frames: number of frames through which a wall persists; reach_px: of the band beyond a silhouette; around:
    from `surroundings`; without it no wall is faint.
    """
    sure = _walls(silhouette.standing, standing_frames)
    wall = sure
    if around is not None:
        faint = _faint_walls(silhouette.standing, standing_frames, around.uneven, sure)
        sure = sure & ~doubled(around.smooth, sure.shape)
        wall = sure | faint
    if not wall.any():
        return None
    contrast = np.where(wall, silhouette.contrast, np.float32(0))
    ridge = np.where(
        contrast >= np.float32(SIDE.ridge_share) * highest(contrast, SIDE.levels_px), contrast, np.float32(0)
    )
    frame = (_strongest(ridge, silhouette.frame, reach_px) & np.uint32(0xFFFF)).astype(np.uint16)
    inside, near_sure = (highest(mask, 2 * (reach_px // 2) + 1) for mask in (wall, sure))
    return Band(inside, frame, ridge, reach_px, near_sure)


def _walls(standing: NDArray[np.uint16], least_frames: float) -> NDArray[np.bool_]:
    """Return the silhouettes that are walls: long ones, and short ones that persist far longer than a pattern does."""
    parts, is_long = _parts(standing >= least_frames)
    longest = np.zeros(len(is_long), standing.dtype)
    np.maximum.at(longest, parts.ravel(), standing.ravel())
    is_wall = is_long | (longest >= WALL.short_gaps * least_frames)
    is_wall[0] = False
    return is_wall[parts]


def _faint_walls(
    standing: NDArray[np.uint16], least_frames: float, uneven: NDArray[np.bool_], sure: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return the long silhouettes that persist for fewer frames, where heights are uneven, away from sure walls."""
    faint = standing >= WALL.faint_frames(least_frames)
    parts, is_long = _parts(faint, WALL.faint_gap_px // 2)
    return is_long[parts] & doubled(uneven, faint.shape) & ~highest(sure, WALL.faint_apart_px + 1)


def _parts(silhouettes: NDArray[np.bool_], gap: int = 0) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the number of each silhouette, 0 where there is none, and which numbers are of long ones.

    gap: distance over which pieces belong together, in pixels of half resolution.
    """
    from scipy.ndimage import find_objects
    from skimage.measure import label

    parts: NDArray[np.int64] = np.asarray(label(highest(silhouettes, gap + 1), connectivity=2)) * silhouettes
    extents = [max(side.stop - side.start for side in part) if part else 0 for part in find_objects(parts)]
    return parts, np.array([0, *extents]) >= WALL.least_length_px // 2


def heights_near(
    silhouette: Silhouette, standing_frames: float, z_um: NDArray[np.float32], passed: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Return the heights of the cells around silhouettes that may be walls; NaN elsewhere and where they are few."""
    return cell_medians(z_um, passed, _cells_near(silhouette.standing >= WALL.faint_frames(standing_frames)))


def _cells_near(silhouettes: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return highest(halved(silhouettes) > 0, 2 * REACH_CELLS + 3)


def surroundings(
    silhouette: Silhouette,
    standing_frames: float,
    heights_um: NDArray[np.float32],
    passed: NDArray[np.bool_],
    mirrored: NDArray[np.bool_],
    tolerance_um: float,
    reach_px: int,
) -> Surroundings:
    """Return what the heights around silhouettes say about walls.

    Jumps are looked for around silhouettes that may be walls only. heights_um: from `heights_near`; passed: the gate
    mask, [row, col]; mirrored: from `mirrored_light`; tolerance_um: tolerance for equal heights. A wall separates two
    heights, or a surface from one that is too weakly textured to be measured as far as an anchor reaches. Within
    `reach_px` of the border of the frame the window sees one side of a silhouette only: no surface goes on beyond it
    for sure.
    """
    size = 2 * REACH_CELLS + 1
    sure = _cells_near(silhouette.standing >= standing_frames)
    planes = local_planes(heights_um, WALL.plane_cells)
    jumps = planes.residual > WALL.jump_residual * WALL.jump_tolerances * tolerance_um
    passed_share = cell_means(passed.view(np.uint8), heights_um.shape)
    measured_share = mean(passed_share, size)
    complete = measured_share >= WALL.measured_share
    smooth = complete & ~highest(jumps & sure, size)
    border = -(-reach_px // COARSE_PX)
    smooth[:border] = smooth[-border:] = smooth[:, :border] = smooth[:, -border:] = False
    few = measured_share < WALL.few_share
    uneven = ~complete & (few | highest(jumps, 2 * WALL.uneven_cells + 1)) & ~mirrored
    beside = 2 * WALL.level_cells + 1
    level = (mean(passed_share, beside) >= WALL.measured_share) & ~highest(jumps, beside)
    return Surroundings(smooth | mirrored, uneven, level)


def classify_sides(grey: NDArray[np.float32], band: Band, dark_counts: float) -> Sides:
    """Classify the sides of a field; grey: from `outline_grey`, [row, col]."""
    halves = halved(grey)
    log = np.log(halves + np.float32(dark_counts))
    low, high = _extremes(log, band.inside)
    threshold = _spread(band, np.float32(0.5) * (low + high))
    surely_dark, middle, surely_bright = (
        np.exp(level) - np.float32(dark_counts)
        for level in (
            low + np.float32(SIDE.surely_dark) * (high - low),
            threshold,
            low + np.float32(SIDE.surely_bright) * (high - low),
        )
    )
    bright, side = np.empty(grey.shape, np.bool_), np.empty(grey.shape, np.uint8)
    _mark_bright(grey, middle, bright)
    share = np.where(band.inside, halved(bright), np.float32(0))
    around = mean_of_valid(share, band.inside, 3)
    deep = around <= 1 - SIDE.deep_share, around >= SIDE.deep_share
    _mark_sides(grey, bright, band.inside, (surely_dark, surely_bright), deep, side)
    side[(side >= EdgeSide.BRIGHT) & ~doubled(band.sure, side.shape)] = EdgeSide.AWAY
    return Sides(side, share, np.where(band.inside, threshold, np.float32(0)))


@lean_kernel
def _mark_bright(grey: Float32s, middle: Float32s, bright: Bools) -> None:
    """Mark the pixels of a field at or above a grey at half resolution."""
    for y in range(grey.shape[0]):
        for x in range(grey.shape[1]):
            bright[y, x] = grey[y, x] >= middle[y // 2, x // 2]


@lean_kernel
def _mark_sides(
    grey: Float32s,
    bright: Bools,
    inside: Bools,
    surely: tuple[Float32s, Float32s],
    deep: tuple[Bools, Bools],
    side: UInt8s,
) -> None:
    """Write the side of each pixel of a field, which is the outline inside the band unless it is sure.

    surely: grey of certainly dark and certainly bright pixels; deep: whether all around is dark, is bright; inside,
    surely and deep: at half resolution.
    """
    for y in range(grey.shape[0]):
        for x in range(grey.shape[1]):
            i, j, found = y // 2, x // 2, EdgeSide.AWAY
            if inside[i, j]:
                found = EdgeSide.OUTLINE
                if bright[y, x]:
                    if grey[y, x] > surely[1][i, j] or deep[1][i, j]:
                        found = EdgeSide.BRIGHT
                elif grey[y, x] < surely[0][i, j] or deep[0][i, j]:
                    found = EdgeSide.DARK
            side[y, x] = found


@lean_kernel
def outline_grey(source: StackSource, first: Int, inside: Bools, frame: UInt16s, grey: Float32s) -> None:
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


def _strongest(contrast: NDArray[np.float32], carried: NDArray[np.uint16], reach_px: int) -> NDArray[np.uint32]:
    """Return `carried` of the wall next to each pixel in the lower 16 bits; 0 where there is no wall.

    Of walls at about the same distance the strongest is used: a bright line near a wall affects itself only.
    """
    strength = np.minimum(contrast * np.float32(_CONTRAST_UNIT), np.float32(65535)).astype(np.uint32)
    keyed = np.where(contrast > 0, (strength << np.uint32(16)) | carried.astype(np.uint32), np.uint32(0))
    found = np.zeros_like(keyed)
    for share in _NEARER_FIRST:
        found = np.where(found > 0, found, highest(keyed, 2 * round(share * reach_px) + 1))
    return found


def _spread(band: Band, log: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return a logarithm propagated from the nearest wall, slightly smoothed."""
    found = _strongest(band.contrast, (np.clip(log, 0, 15) * np.float32(_LOG_UNIT)).astype(np.uint16), band.reach_px)
    return mean_of_valid(found & np.uint32(0xFFFF), found > 0, 3) / np.float32(_LOG_UNIT)


def _extremes(log: NDArray[np.float32], inside: NDArray[np.bool_]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the local minimum and maximum of the logarithm; 0 outside."""
    far, none = np.float32(1e3), np.float32(0)
    low, high = lowest(np.where(inside, log, far), SIDE.levels_px), highest(np.where(inside, log, -far), SIDE.levels_px)
    return np.where(inside, low, none), np.where(inside, high, none)
