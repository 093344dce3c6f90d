"""Segmentation of cells by hysteresis thresholding of their scores, merged across cell borders. Pure.

A piece stores its pixels in stage um, so that pieces of one defect on several dies can be merged.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.defects.matched_filters import side_of
from wafer_viewer.measure.defects.scores import (
    PICTURED,
    SEEKING,
    SHOWING,
    DefectScores,
    Mask,
    Residual,
    enlarged,
    limit_of,
    lower_threshold,
)
from wafer_viewer.measure.dies.die_cells import CellGrid, Place, Plane, Shift
from wafer_viewer.model.inspection.defect import DefectRecipe, Evidence
from wafer_viewer.numerics.filters.gaussian import coarseness, smooth
from wafer_viewer.numerics.filters.regions import dilated, regions_with_peaks
from wafer_viewer.numerics.jit import Float32s

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SegmentationParameters:
    """Limits of the segmentation of cells.

    Parameters
    ----------
    spare_px : int, px
        Margin around a piece in which its heights are smoothed.
    bridge_px : int, px
        Widest gap bridged within a defect.
    border_px : int, px
        Distance from the border of a cell within which a pixel lies at it.
    near_px : float, px
        Distance of their pixels within which pieces at a border are merged.
    shown_from : float
        Threshold in deviations for pixels connected to a detection.
    clear_from : float
        Lower threshold of the image score that contributes to a shape, in deviations.
    clear_most : float
        Upper limit of a pixel's weight, in deviations over that.
    smoothing : float
        Standard deviation of the smoothing of a piece, relative to its width.
    smoothing_px : tuple[float, float], px
        Limits of that standard deviation.
    least_weight : float
        Known share of a Gaussian mean above which it is taken.

    Notes
    -----
    `tests/bench/bench_defects.py` and `tests/bench/bench_defects_truth.py` count captured and false defects with
    these values.
    """

    spare_px: int = 8
    bridge_px: int = 4
    border_px: int = 4
    near_px: float = 8.0
    shown_from: float = 3.5
    clear_from: float = 2.5
    clear_most: float = 6.0
    smoothing: float = 0.125
    smoothing_px: tuple[float, float] = (0.6, 4.0)
    least_weight: float = 0.2


SEGMENTATION = SegmentationParameters()


@dataclass(frozen=True, slots=True, eq=False)
class DefectPixels:
    """Pixels that differ, float64 [n] each: stage and die coordinates, and values.

    z_um: residual, NaN where unmeasured; smooth_um: the residual smoothed to the size of the defect; slope: gradient
    magnitude of that; clear: image score in excess of `SEGMENTATION.clear_from` in deviations, 0 below it.
    """

    x_um: Floats
    y_um: Floats
    u_um: Floats
    v_um: Floats
    z_um: Floats
    smooth_um: Floats
    slope: Floats
    clear: Floats


@dataclass(frozen=True, slots=True, eq=False)
class DefectPiece(DefectPixels):
    """A connected set of pixels of one cell that differ.

    border: whether a pixel lies at the cell's border; peaks: highest score by layer; noise_um: local noise of heights.
    """

    place: Place
    border: Mask
    peaks: dict[str, float]
    scale_px: float
    noise_um: float = 0.0

    @property
    def score(self) -> float:
        """Highest score of the detection layers."""
        return max((self.peaks.get(layer, 0.0) for layer in SEEKING), default=0.0)


@dataclass(frozen=True, slots=True)
class Where:
    """The lattice of cells, and the shift of this cell from its place."""

    cells: CellGrid
    shift: Shift


def pieces_of(
    residual: Residual, scores: DefectScores, spread_um: Plane, recipe: DefectRecipe, where: Where
) -> list[DefectPiece]:
    """Return the pieces of a cell over the recipe's threshold; spread_um: die-to-die spread of its heights."""
    from scipy.ndimage import find_objects, label

    shape = residual.z_um.shape
    sought, shown = _over(scores, recipe, (shape[0], shape[1]))
    if not sought.any():
        return []
    labels = np.zeros(shape, np.int32)
    label(dilated(sought | shown, SEGMENTATION.bridge_px), np.ones((3, 3), int), output=labels)
    boxes = enumerate(find_objects(labels), 1)
    found = (_piece(residual, scores, spread_um, labels, n, box, (shown, sought), where, recipe) for n, box in boxes)
    return [piece for piece in found if piece is not None and len(piece.x_um) >= recipe.min_area_px]


def _over(scores: DefectScores, recipe: DefectRecipe, shape: tuple[int, int]) -> tuple[Mask, Mask]:
    """Return the mask of detected pixels and the mask of pixels that show their extent.

    Detected: above the lower threshold and connected to a pixel above the upper one, in the same layer with the same
    sign. Unfiltered pixels need enough neighbours above the threshold.
    """
    found, peaks = np.zeros(shape, bool), np.zeros(shape, bool)
    for (layer, scale), plane in scores.planes.items():
        if layer in SEEKING:
            high = limit_of(layer, scale, recipe.evidence, recipe.threshold_sigma)
            for signed in (plane,) if layer == "joint" else (plane, -plane):
                tops, low, side = signed >= high, signed >= lower_threshold(high), side_of(layer, scale)
                if tops.any():
                    tops = _crowded(tops, low, recipe) if scale == 0 else tops
                    peaks |= enlarged(tops, side, shape)
                    found |= enlarged(regions_with_peaks(low, tops), side, shape)
    return found, _showing(scores, peaks) if peaks.any() else peaks


def _crowded(tops: Mask, low: Mask, recipe: DefectRecipe) -> Mask:
    from scipy.ndimage import uniform_filter

    return tops & (uniform_filter(low.astype(np.float32), 3) * 9 >= min(9, recipe.min_area_px) - 0.5)


def _showing(scores: DefectScores, peaks: Mask) -> Mask:
    """Return the pixels above `SEGMENTATION.shown_from` connected to peaks of any layer, whatever the threshold."""
    shown = np.zeros(peaks.shape, bool)
    for (layer, scale), plane in scores.planes.items():
        if layer in SHOWING:
            for signed in (plane,) if layer == "joint" else (plane, -plane):
                over = enlarged(signed >= SEGMENTATION.shown_from, coarseness(scale), peaks.shape)
                shown |= regions_with_peaks(over, peaks & over)
    return shown


def _piece(
    residual: Residual,
    scores: DefectScores,
    spread_um: Plane,
    labels: NDArray[np.int32],
    number: int,
    box: tuple[slice, slice],
    masks: tuple[Mask, Mask],
    where: Where,
    recipe: DefectRecipe,
) -> DefectPiece | None:
    rows, cols = (
        slice(max(0, side.start - SEGMENTATION.spare_px), min(n, side.stop + SEGMENTATION.spare_px))
        for side, n in zip(box, labels.shape, strict=True)
    )
    inside, sought = ((labels[rows, cols] == number) & mask[rows, cols] for mask in masks)
    if np.count_nonzero(inside) < recipe.min_area_px:
        inside = sought
    if not inside.any():
        return None
    peaks, scale = _best(scores, inside | sought, rows, cols)
    own = (labels[rows, cols] == number) | (labels[rows, cols] == 0)
    z_um = np.where(own, residual.z_um[rows, cols], np.float32(np.nan))
    width = np.count_nonzero(inside) / math.hypot(*inside.shape)
    sigma = float(np.clip(width * SEGMENTATION.smoothing, *SEGMENTATION.smoothing_px))
    r, c = np.nonzero(inside)
    pixels = (r + rows.start).astype(float), (c + cols.start).astype(float)
    x_um, y_um = where.cells.to_stage(residual.place, *pixels, where.shift)
    u_um, v_um = where.cells.in_die(*pixels)
    smoothed = smoothed_valid(z_um, sigma)
    down, right = np.gradient(smoothed)
    slope = np.hypot(down, right) / where.cells.pixel_um
    planes = z_um, smoothed, slope, _clear(scores, rows, cols)
    values, smooth_um, steep, clear = (plane[r, c].astype(float) for plane in planes)
    border, noise_um = _at_border(*pixels, residual.z_um.shape), _median(spread_um[rows, cols][r, c])
    return DefectPiece(
        x_um, y_um, u_um, v_um, values, smooth_um, steep, clear, residual.place, border, peaks, scale, noise_um
    )


def _clear(scores: DefectScores, rows: slice, cols: slice) -> Plane:
    """Return the image score over `SEGMENTATION.clear_from` at the finest scale; 0 if the image is not inspected."""
    shape = rows.stop - rows.start, cols.stop - cols.start
    scales = [scale for layer, scale in scores.planes if layer == "picture" and coarseness(scale) == 1]
    if not scales:
        return np.zeros(shape, np.float32)
    score = np.nan_to_num(scores.planes["picture", min(scales)][rows, cols])
    return np.clip(np.abs(score) - np.float32(SEGMENTATION.clear_from), 0, np.float32(SEGMENTATION.clear_most))


def _median(values: Float32s) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else 0.0


def _best(scores: DefectScores, inside: Mask, rows: slice, cols: slice) -> tuple[dict[str, float], float]:
    """Return the highest score of each layer within a piece, and the scale of the best detection layer."""
    best: dict[str, tuple[float, float]] = {}
    for (layer, scale), plane in scores.planes.items():
        side = side_of(layer, scale)
        part = plane[rows.start // side : -(-rows.stop // side), cols.start // side : -(-cols.stop // side)]
        if side == 1:
            part = part[inside]
        top = float(np.nanmax(np.abs(part), initial=0.0))
        if top > best.get(layer, (0.0, 0.0))[0]:
            best[layer] = top, scale
    peaks = {layer: top for layer, (top, _) in best.items()}
    return peaks, max((best[layer] for layer in SEEKING if layer in best), default=(0.0, 0.0))[1]


def smoothed_valid(plane: Float32s, sigma_px: float) -> Float32s:
    """Return the Gaussian mean of the known pixels, NaN where too few are near."""
    finite = np.isfinite(plane)
    weight = smooth(finite.astype(np.float32), sigma_px)
    value = smooth(np.where(finite, plane, np.float32(0)), sigma_px)
    return np.divide(
        value, weight, out=np.full(plane.shape, np.nan, np.float32), where=weight > SEGMENTATION.least_weight
    )


def evidence_of(peaks: dict[str, float], threshold_sigma: float) -> Evidence:
    """Return the layers that show a defect, each on its own."""
    limit = lower_threshold(threshold_sigma)
    height, picture = peaks.get("height", 0.0), max(peaks.get(layer, 0.0) for layer in PICTURED)
    if min(height, picture) >= limit:
        return "both"
    return "picture" if picture > height else "height"


def _at_border(rows: Floats, cols: Floats, shape: tuple[int, ...]) -> Mask:
    return (
        (rows < SEGMENTATION.border_px)
        | (cols < SEGMENTATION.border_px)
        | (rows >= shape[0] - SEGMENTATION.border_px)
        | (cols >= shape[1] - SEGMENTATION.border_px)
    )


def merge_border_pieces(pieces: Sequence[DefectPiece], pixel_um: float) -> list[list[DefectPiece]]:
    """Return the pieces in groups, one per defect."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    if not pieces:
        return []
    owner = np.concatenate([np.full(int(piece.border.sum()), k) for k, piece in enumerate(pieces)])
    border_um = np.concatenate([np.stack([p.x_um[p.border], p.y_um[p.border]], axis=1) for p in pieces])
    pairs = (
        np.asarray(KDTree(border_um).query_pairs(SEGMENTATION.near_px * pixel_um, output_type="ndarray"))
        if len(border_um)
        else np.zeros((0, 2), int)
    )
    first, second = owner[pairs[:, 0]], owner[pairs[:, 1]]
    links = coo_array((np.ones(len(first)), (first, second)), shape=(len(pieces),) * 2)
    n, group = connected_components(links, directed=False)
    out: list[list[DefectPiece]] = [[] for _ in range(int(n))]
    for piece, k in zip(pieces, group, strict=True):
        out[int(k)].append(piece)
    return out
