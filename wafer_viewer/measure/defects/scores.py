"""Scores of a cell: deviation from its reference in units of the local noise, at several scales. Pure.

A residual is divided by the spread of its position, clipped at LOUDEST to limit the influence of a single high peak on
its neighbourhood, filtered, and divided by the remaining noise. Heights are smoothed at several scales. Image defects
are detected with matched filters; the smoothed image and its detail determine their pixels and appearance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.defects.golden_die import Cell, ReferenceDie
from wafer_viewer.measure.defects.matched_filters import SHARP, SOFT, Spectrum, matched, side_of
from wafer_viewer.measure.defects.noise_model import NoiseModel, Planes
from wafer_viewer.measure.dies.die_cells import DiePlane, Place, Plane
from wafer_viewer.model.inspection.defect import DefectRecipe, Evidence, FalseCounts
from wafer_viewer.numerics.filters.gaussian import gaussian_sums
from wafer_viewer.numerics.filters.regions import region_maxima

LOUDEST = 15.0
LOW_SHARE, LEAST_LOW = 0.6, 2.5
"""Lower hysteresis threshold: fraction of the upper threshold, and its lower limit in deviations."""
HISTOGRAM_STEP, HISTOGRAM_END = 0.125, 12.0
COUNTED_FROM, FITTED_FROM, ANCHORED_TO, FITTED_TO, LEAST_COUNTED = 2.25, 2.75, 3.75, 4.5, 8
NORMAL_FALL, SLOWEST_FALL = 0.5, 0.15
"""Decay rate of the log number of peaks by squared deviation: of normal noise, and the lower limit accepted."""
DETAIL_PX = 0.7, 1.5
"""Scales of the difference of Gaussians of the detail layer, for the glint at the centre of a dark particle.

An unfiltered layer would show the subpixel shifts between dies.
"""
Mask = NDArray[np.bool_]
NEAR_HOLES_PX, UNSURE = 15, 4.0
"""Window for the unmeasured fraction, and the weight of that fraction in the confidence of heights."""
SEEKING = "height", SHARP, SOFT, "joint"
SHOWING = "height", "picture", "joint"
PICTURED = "picture", "detail", SHARP, SOFT
"""Layers for detection (SEEKING), for segmentation (SHOWING), and of the image (PICTURED)."""
ALONE = 1.16
"""Factor of the limit for a single layer where both heights and image are inspected."""
RARE_AT = 5.5
"""Deviation that unfiltered noise exceeds about once in ten mm2."""
JOINT, LEAST_JOINT = 0.83, 2.0
"""Factor of the joint score, and the smallest score of each layer for it.

The root sum of squares of both layers exceeds a limit more often than either; the factor makes it equally rare.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Residual:
    """A cell less its reference: levelled heights with confidence weights, grey values, and the removed plane.

    Excluded pixels are NaN in heights and image, and are not missing.
    """

    place: Place
    z_um: Plane
    sure: Plane
    picture: Plane
    tilt: tuple[float, float]
    offset_um: float
    missing: Mask


@dataclass(frozen=True, slots=True, eq=False)
class DefectScores:
    """Scores of one cell by layer and scale, each [row, col] of squares of `coarseness` pixels."""

    planes: Planes


def residual_of(
    place: Place, cell: Cell, golden: ReferenceDie, pixel_um: float, flatten: bool, excluded: Mask | None = None
) -> Residual:
    """Subtract the reference from a cell. flatten: also subtract the residual plane and the grey offset."""
    z_um, picture = cell[0] - golden.z_um, cell[1] - golden.picture
    missing = np.isnan(cell[0]) & np.isfinite(golden.z_um)
    sure = _sureness(z_um)
    if excluded is not None:
        missing &= ~excluded
    if not flatten:
        return Residual(place, _less(z_um, excluded), sure, _less(picture, excluded), (0.0, 0.0), 0.0, missing)
    tilted = DiePlane.of(z_um)
    rows, cols = z_um.shape
    grey = picture[::4, ::4]
    grey = grey[np.isfinite(grey)]
    level = np.float32(np.median(grey)) if grey.size else np.float32(0)
    tilt = -tilted.down / pixel_um, tilted.right / pixel_um
    z_um, picture = (_less(plane, excluded) for plane in (tilted.off(z_um), picture - level))
    return Residual(place, z_um, sure, picture, tilt, tilted.at(rows / 2, cols / 2), missing)


def _less(plane: Plane, excluded: Mask | None) -> Plane:
    return plane if excluded is None else np.where(excluded, np.float32(np.nan), plane)


def picture_quotient(residual: Residual, golden: ReferenceDie) -> Plane:
    """Return the image residual over its spread, clipped."""
    return np.clip(residual.picture / golden.picture_spread, -LOUDEST, LOUDEST)


def quotients(residual: Residual, golden: ReferenceDie, recipe: DefectRecipe, spectrum: Spectrum) -> Planes:
    """Return residuals over their spread, filtered, by layer and scale; spectrum: noise spectrum of the image."""
    planes: Planes = {}
    if recipe.evidence in ("height", "both"):
        part = residual.z_um / golden.z_spread_um * residual.sure
        planes |= {("height", scale): plane for scale, plane in _at_scales(part, recipe.scales_px).items()}
    if recipe.evidence in ("picture", "both"):
        fine, wide = DETAIL_PX
        quotient = picture_quotient(residual, golden)
        of_picture = _at_scales(quotient, (*recipe.scales_px, fine, wide))
        planes |= {("picture", scale): of_picture[scale] for scale in recipe.scales_px}
        planes["detail", fine] = of_picture[fine] - of_picture[wide]
        planes |= matched(quotient, spectrum, recipe.scales_px)
    return planes


def _at_scales(quotient: Plane, scales_px: tuple[float, ...]) -> dict[float, Plane]:
    known = np.isfinite(quotient)
    filled, weight = np.where(known, np.clip(quotient, -LOUDEST, LOUDEST), np.float32(0)), known.astype(np.float32)
    return {s: gaussian_sums(filled, weight, s) if s > 0 else quotient for s in dict.fromkeys(scales_px)}


def _sureness(left: Plane) -> Plane:
    """Return confidence weights: 1 where all neighbours are measured, less near holes."""
    from scipy.ndimage import uniform_filter

    known = uniform_filter(np.isfinite(left).astype(np.float32), NEAR_HOLES_PX)
    return (1 / (1 + np.float32(UNSURE) * (1 - known))).astype(np.float32)


def scores_of(planes: Planes, noise: NoiseModel) -> DefectScores:
    """Convert quotients to scores in deviations of normal noise, and add the joint layer."""
    scores = noise.scores(planes)
    for scale in {scale for _, scale in planes}:
        both = [scores[layer, scale] for layer in ("height", SOFT) if (layer, scale) in scores]
        if len(both) == 2:
            scores["joint", scale] = _joint(np.abs(np.nan_to_num(both[0])), np.abs(np.nan_to_num(both[1])))
    return DefectScores(scores)


def _joint(first: Plane, second: Plane) -> Plane:
    """Return the joint score where both layers exceed LEAST_JOINT, else 0."""
    together = np.float32(JOINT) * np.hypot(first, second)
    return np.where(np.minimum(first, second) >= LEAST_JOINT, together, np.float32(0))


def limit_of(layer: str, scale_px: float, evidence: Evidence, limit: float) -> float:
    """Return the limit for a layer at a scale, higher for a single layer where both are inspected.

    Wide scales have fewer independent positions, so that an equally rare deviation is lower.
    """
    fewer = 1.0 if layer == SHARP else 1 + scale_px**2
    alone = ALONE if evidence == "both" and layer != "joint" else 1.0
    return limit * alone * math.sqrt(1 - 2 * math.log(fewer) / RARE_AT**2)


def lower_threshold(threshold_sigma: float) -> float:
    """Return the lower hysteresis threshold for an upper one."""
    return max(LEAST_LOW, LOW_SHARE * threshold_sigma)


def new_counts() -> NDArray[np.int64]:
    """An empty histogram of peaks."""
    return np.zeros(round(HISTOGRAM_END / HISTOGRAM_STEP), np.int64)


def add_to_peak_histogram(
    scores: DefectScores, recipe: DefectRecipe, shape: tuple[int, int], counts: NDArray[np.int64]
) -> None:
    """Add the peaks of a cell over COUNTED_FROM to a histogram of the score relative to its layer's limit."""
    highest = np.zeros(shape, np.float32)
    for (layer, scale), plane in scores.planes.items():
        if layer in SEEKING:
            by = np.abs(plane) * np.float32(1 / limit_of(layer, scale, recipe.evidence, 1.0))
            np.fmax(highest, enlarged(by, side_of(layer, scale), shape), out=highest)
    tops = region_maxima(highest, COUNTED_FROM)
    counts += np.bincount(np.minimum(tops / HISTOGRAM_STEP, len(counts) - 1).astype(int), minlength=len(counts))


def false_counts(counts: NDArray[np.int64], inspected_mm2: float) -> FalseCounts:
    """Estimate the false counts per area by threshold from the histogram of peaks.

    Noise peaks fall as exp(-s t2), and defects are few among the lower peaks. The decay rate is fitted where peaks are
    many, taken as that of normal noise where they are too few, and extrapolated to all thresholds.
    """
    if inspected_mm2 <= 0:
        return FalseCounts()
    middles = (np.arange(len(counts)) + 0.5) * HISTOGRAM_STEP
    used = (middles >= FITTED_FROM) & (middles <= FITTED_TO) & (counts >= LEAST_COUNTED)
    steep = NORMAL_FALL
    if np.count_nonzero(used) >= 4:
        slope = np.polyfit(middles[used] ** 2, np.log(counts[used]), 1, w=np.sqrt(counts[used]))[0]
        steep = float(np.clip(-slope, SLOWEST_FALL, NORMAL_FALL))
    anchor = (middles >= FITTED_FROM) & (middles <= ANCHORED_TO)
    scale = max(1.0, float(counts[anchor].sum())) / float(np.exp(-steep * middles[anchor] ** 2).sum())
    wanted = np.arange(2.0, 8.01, 0.25)
    rates = [scale * float(np.exp(-steep * (t + middles) ** 2).sum()) / inspected_mm2 for t in wanted]
    return FalseCounts(threshold_sigma=tuple(wanted.tolist()), per_mm2=tuple(rates))


def enlarged(mask: NDArray[Any], side: int, shape: tuple[int, int]) -> NDArray[Any]:
    """Expand each square to its pixels; pixels beyond the last square are 0."""
    if side == 1:
        return mask
    out = np.zeros(shape, mask.dtype)
    big = mask.repeat(side, axis=0).repeat(side, axis=1)[: shape[0], : shape[1]]
    out[: big.shape[0], : big.shape[1]] = big
    return out
