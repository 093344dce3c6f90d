"""Heights of the two sides of a wall, from the surface further from it.

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

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.numerics.filters.sliding_filters import halved, highest, lowest, mean, mean_of_valid, nearest
from wafer_viewer.reconstruct.focus.focus_volume import COARSE_PX
from wafer_viewer.reconstruct.gates.edge_sides import Band, Sides
from wafer_viewer.reconstruct.gates.height_cells import REACH_CELLS, cell_means, cell_medians


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
    anchor_um = _smoothed(heights, anchors)
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
    anchor_um = _smoothed(heights, anchors)[nearest(anchors)[1]]
    agreeing = known & (np.abs(heights - anchor_um) < tolerance_um)
    return mean(agreeing, size) >= ANCHOR.agreeing_share * mean(known, size)


def _large(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    from skimage.morphology import remove_small_objects

    return remove_small_objects(cells, max_size=ANCHOR.enough_cells - 1)


def _smoothed(heights: NDArray[np.float32], anchors: NDArray[np.bool_]) -> NDArray[np.float32]:
    return mean_of_valid(heights, anchors, 3)


def _flat(heights: NDArray[np.float32], tolerance_um: float) -> NDArray[np.bool_]:
    """Return the cells with enough neighbours, all of the same height."""
    finite = np.isfinite(heights)
    return (_ranges(heights) < tolerance_um) & finite & (9 * mean(finite, 3) > ANCHOR.enough_neighbours - 0.5)


def _ranges(heights: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the range of the heights of 3 x 3 cells, -inf where there is none."""
    finite, far = np.isfinite(heights), np.float32(np.inf)
    return highest(np.where(finite, heights, -far), 3) - lowest(np.where(finite, heights, far), 3)
