"""Height of the surface on each side of a wall, from reliable measurements further from it.

Cells of 4 x 4 pixels, as in the coarse focus volume. A cell is an anchor of a side when it lies entirely on it, its
pixels passed the gate, and it is flat together with its neighbours: false heights by bleeding light are not flat, they
rise with the distance from the wall divided by the aperture. Small groups of cells are not accepted.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.numerics.filters.sliding_filters import halved, highest, lowest, mean, mean_of_known, nearest, pieces
from wafer_viewer.reconstruct.focus.focus_volume import COARSE_PX
from wafer_viewer.reconstruct.gates.edge_sides import Band, Sides

ANCHOR_REACH_PX = 48
"""Distance over which an anchor height is extrapolated towards the wall."""

_REACH = ANCHOR_REACH_PX // COARSE_PX
_ENOUGH_PIXELS = 6
_ENOUGH_NEIGHBOURS = 5
_ENOUGH_CELLS = 10
_PURE_SHARE = 0.95
_PURE_CELLS = 2
"""A focus window of 9, applied twice, reaches over two cells: all cells within this distance must lie on one side."""


def side_heights_um(
    z_um: NDArray[np.float32],
    passed: NDArray[np.bool_],
    all_in_focus: Image,
    band: Band,
    sides: Sides,
    dark_counts: float,
    tolerance_um: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the heights of the dark and the bright side, float32 [row / 4, col / 4]; NaN without an anchor nearby.

    z_um, passed, all_in_focus: [row, col], passed is the gate mask; tolerance_um: tolerance for equal heights.
    """
    near = highest(halved(band.inside) > 0, 2 * (_REACH + 1) + 1)
    heights = _cell_medians(z_um, passed, near)
    dark, bright = _cell_sides(all_in_focus, band.inside, sides, dark_counts)
    nothing = np.float32(np.nan)
    return (
        _from_anchors(np.where(dark, heights, nothing), tolerance_um),
        _from_anchors(np.where(bright, heights, nothing), tolerance_um),
    )


def _cell_sides(
    all_in_focus: Image, inside: NDArray[np.bool_], sides: Sides, dark_counts: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks of the cells entirely on the dark and on the bright side.

    Beyond the band, cells are classified by their grey against the threshold at the nearest wall.
    """
    known = halved(inside)
    in_band = known > 0
    per_known = 1 / np.maximum(known, np.float32(1e-6))
    grey = _cell_means(all_in_focus, in_band.shape)
    _, at = nearest(in_band)
    threshold = (halved(sides.threshold) * per_known)[at]
    brighter = np.log(grey + np.float32(dark_counts)) >= threshold
    bright = mean(np.where(in_band, halved(sides.bright_share) * per_known, brighter), 2 * _PURE_CELLS + 1)
    return bright <= 1 - _PURE_SHARE, bright >= _PURE_SHARE


def _from_anchors(heights: NDArray[np.float32], tolerance_um: float) -> NDArray[np.float32]:
    """Return the height of the nearest anchor, NaN beyond its reach."""
    anchors = _large_pieces(_flat(heights, tolerance_um))
    if not anchors.any():
        return np.full_like(heights, np.nan)
    smooth = mean_of_known(heights, anchors, 3)
    distance, at = nearest(anchors)
    return np.where(distance <= _REACH, smooth[at], np.float32(np.nan))


def _flat(heights: NDArray[np.float32], tolerance_um: float) -> NDArray[np.bool_]:
    """Return the cells with enough neighbours, all of the same height."""
    known, far = np.isfinite(heights), np.float32(np.inf)
    high, low = highest(np.where(known, heights, -far), 3), lowest(np.where(known, heights, far), 3)
    return known & (high - low < tolerance_um) & (9 * mean(known, 3) > _ENOUGH_NEIGHBOURS - 0.5)


def _large_pieces(anchors: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the anchors in connected components of sufficient size."""
    numbers = pieces(anchors)
    sizes = np.bincount(numbers.ravel())
    sizes[0] = 0
    return sizes[numbers] >= _ENOUGH_CELLS


def _cell_means(image: Image, shape: tuple[int, int]) -> NDArray[np.float32]:
    rows, cols = (COARSE_PX * n for n in shape)
    padded = np.pad(image, ((0, rows - image.shape[0]), (0, cols - image.shape[1])), mode="edge")
    return padded.reshape(shape[0], COARSE_PX, shape[1], COARSE_PX).mean(axis=(1, 3), dtype=np.float32)


def _cell_medians(z_um: NDArray[np.float32], passed: NDArray[np.bool_], near: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the median height of the accepted pixels of each cell; NaN where they are few or the cell is far."""
    values = _pixels_of_cells(np.where(passed, z_um, np.float32(np.inf)), near, np.float32(np.inf))
    values.sort(axis=1)
    count = np.count_nonzero(values < np.inf, axis=1)
    middle = values[np.arange(len(values)), np.maximum(count - 1, 0) // 2]
    out = np.full(near.shape, np.nan, np.float32)
    out[near] = np.where(count >= _ENOUGH_PIXELS, middle, np.float32(np.nan))
    return out


def _pixels_of_cells(plane: NDArray[np.float32], cells: NDArray[np.bool_], beyond: np.float32) -> NDArray[np.float32]:
    """Return the 16 pixels of each selected cell."""
    rows, cols = (COARSE_PX * n for n in cells.shape)
    padded = np.pad(plane, ((0, rows - plane.shape[0]), (0, cols - plane.shape[1])), constant_values=beyond)
    blocks = padded.reshape(cells.shape[0], COARSE_PX, cells.shape[1], COARSE_PX)
    return blocks.transpose(0, 2, 1, 3)[cells].reshape(-1, COARSE_PX * COARSE_PX)
