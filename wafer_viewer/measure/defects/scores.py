"""Scores of a cell: deviation from its reference in units of the local noise, at several scales. Pure.

A residual is divided by the spread of its position, clipped at `SCORES.loudest` to limit the influence of a single high
peak on its neighbourhood, filtered, and divided by the remaining noise. Heights are smoothed at several scales. Image
defects are detected with matched filters; the smoothed image and its detail determine their pixels and appearance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.defects.die_form import Area, DieForm, flatten, levelled_picture
from wafer_viewer.measure.defects.golden_die import Cell, ReferenceDie
from wafer_viewer.measure.defects.matched_filters import SHARP, SOFT, Spectrum, matched, side_of
from wafer_viewer.measure.defects.noise_model import NoiseModel, Planes
from wafer_viewer.measure.dies.die_cells import Place, Plane
from wafer_viewer.model.inspection.defect import DefectRecipe, Evidence, FalseCounts
from wafer_viewer.numerics.filters.gaussian import gaussian_sums
from wafer_viewer.numerics.filters.regions import region_maxima


@dataclass(frozen=True, slots=True)
class ScoreParameters:
    """Scales and limits of the scores of a cell.

    Parameters
    ----------
    loudest : float
        Deviation at which a residual is clipped, so that a high peak has limited influence on its
        neighbourhood.
    low_share : float
        Lower hysteresis threshold relative to the upper one.
    least_low : float
        Lower limit of the lower threshold, in deviations.
    detail_px : tuple[float, float], px
        Scales of the difference of Gaussians of the detail layer, for the glint at the centre of a dark
        particle. An unfiltered layer would show the subpixel shifts between dies.
    near_holes_px : int, px
        Window for the unmeasured fraction.
    unsure : float
        Weight of the unmeasured fraction in the confidence of heights.
    alone : float
        Factor of the limit for a single layer where both heights and image are inspected.
    rare_at : float
        Deviation that unfiltered noise exceeds about once in ten mm2.
    joint : float
        Factor of the joint score. The root sum of squares of both layers exceeds a limit more often than
        either; the factor makes it equally rare.
    least_joint : float
        Smallest score of each layer for the joint score.

    Notes
    -----
    `tests/bench/bench_defects.py` and `tests/bench/bench_defects_truth.py` count captured and false defects with
    these values.
    """

    loudest: float = 15.0
    low_share: float = 0.6
    least_low: float = 2.5
    detail_px: tuple[float, float] = (0.7, 1.5)
    near_holes_px: int = 15
    unsure: float = 4.0
    alone: float = 1.16
    rare_at: float = 5.5
    joint: float = 0.83
    least_joint: float = 2.0


SCORES = ScoreParameters()


@dataclass(frozen=True, slots=True)
class FalseCountParameters:
    """Limits of the estimate of false counts from a histogram of peaks, in deviations.

    Parameters
    ----------
    step : float
        Width of a bin.
    end : float
        Upper end of the histogram; higher peaks are in its last bin.
    counted_from : float
        Lowest peak that is counted.
    fitted_from : float
        Lower end of the range in which the decay rate is fitted.
    fitted_to : float
        Upper end of that range.
    anchored_to : float
        Upper end of the range, from `fitted_from`, in which the number of peaks is taken.
    least_counted : int
        Smallest number of peaks in a bin for the fit.
    least_bins : int
        Smallest number of bins for the fit; with fewer, the decay rate is that of normal noise.
    normal_fall : float
        Decay rate of the log number of peaks by squared deviation, of normal noise.
    slowest_fall : float
        Lower limit of the decay rate.
    thresholds : tuple[float, float, float]
        First threshold, end and step of the thresholds for which counts are given.

    Notes
    -----
    `tests/bench/bench_defects_truth.py` counts false defects on wafers of the virtual optics.
    """

    step: float = 0.125
    end: float = 12.0
    counted_from: float = 2.25
    fitted_from: float = 2.75
    fitted_to: float = 4.5
    anchored_to: float = 3.75
    least_counted: int = 8
    least_bins: int = 4
    normal_fall: float = 0.5
    slowest_fall: float = 0.15
    thresholds: tuple[float, float, float] = (2.0, 8.01, 0.25)


FALSE_COUNTS = FalseCountParameters()
Mask = NDArray[np.bool_]
SEEKING = "height", SHARP, SOFT, "joint"
SHOWING = "height", "picture", "joint"
PICTURED = "picture", "detail", SHARP, SOFT
"""Layers for detection (SEEKING), for segmentation (SHOWING), and of the image (PICTURED)."""


@dataclass(frozen=True, slots=True, eq=False)
class Residual:
    """A cell less its reference: levelled heights with confidence weights, grey values, and the removed form.

    Excluded pixels are NaN in heights and image, and are not missing.
    """

    place: Place
    z_um: Plane
    sure: Plane
    picture: Plane
    form: DieForm
    missing: Mask


@dataclass(frozen=True, slots=True, eq=False)
class DefectScores:
    """Scores of one cell by layer and scale, each [row, col] of squares of `coarseness` pixels."""

    planes: Planes


def residual_of(
    place: Place, cell: Cell, golden: ReferenceDie, pixel_um: float, die: Area | None, excluded: Mask | None = None
) -> Residual:
    """Subtract the reference from a cell. die: its part without streets, whose form and film are subtracted too."""
    z_um, picture = cell[0] - golden.z_um, cell[1] - golden.picture
    missing = np.isnan(cell[0]) & np.isfinite(golden.z_um)
    sure = _sureness(z_um)
    if excluded is not None:
        missing &= ~excluded
    form = DieForm()
    if die is not None:
        z_um, form = flatten(z_um, die, golden.z_spread_um, pixel_um)
        picture, brightness, u_brightness = levelled_picture(picture, golden.picture, die)
        form = replace(form, brightness=brightness, u_brightness=u_brightness)
    return Residual(place, _less(z_um, excluded), sure, _less(picture, excluded), form, missing)


def _less(plane: Plane, excluded: Mask | None) -> Plane:
    return plane if excluded is None else np.where(excluded, np.float32(np.nan), plane)


def picture_quotient(residual: Residual, golden: ReferenceDie) -> Plane:
    """Return the image residual over its spread, clipped."""
    return np.clip(residual.picture / golden.picture_spread, -SCORES.loudest, SCORES.loudest)


def quotients(residual: Residual, golden: ReferenceDie, recipe: DefectRecipe, spectrum: Spectrum) -> Planes:
    """Return residuals over their spread, filtered, by layer and scale; spectrum: noise spectrum of the image."""
    planes: Planes = {}
    if recipe.evidence in ("height", "both"):
        part = residual.z_um / golden.z_spread_um * residual.sure
        planes |= {("height", scale): plane for scale, plane in _at_scales(part, recipe.scales_px).items()}
    if recipe.evidence in ("picture", "both"):
        fine, wide = SCORES.detail_px
        quotient = picture_quotient(residual, golden)
        of_picture = _at_scales(quotient, (*recipe.scales_px, fine, wide))
        planes |= {("picture", scale): of_picture[scale] for scale in recipe.scales_px}
        planes["detail", fine] = of_picture[fine] - of_picture[wide]
        planes |= matched(quotient, spectrum, recipe.scales_px)
    return planes


def _at_scales(quotient: Plane, scales_px: tuple[float, ...]) -> dict[float, Plane]:
    finite = np.isfinite(quotient)
    filled, weight = (
        np.where(finite, np.clip(quotient, -SCORES.loudest, SCORES.loudest), np.float32(0)),
        finite.astype(np.float32),
    )
    return {s: gaussian_sums(filled, weight, s) if s > 0 else quotient for s in dict.fromkeys(scales_px)}


def _sureness(left: Plane) -> Plane:
    """Return confidence weights: 1 where all neighbours are measured, less near holes."""
    from scipy.ndimage import uniform_filter

    finite = uniform_filter(np.isfinite(left).astype(np.float32), SCORES.near_holes_px)
    return (1 / (1 + np.float32(SCORES.unsure) * (1 - finite))).astype(np.float32)


def scores_of(planes: Planes, noise: NoiseModel) -> DefectScores:
    """Convert quotients to scores in deviations of normal noise, and add the joint layer."""
    scores = noise.scores(planes)
    for scale in {scale for _, scale in planes}:
        both = [scores[layer, scale] for layer in ("height", SOFT) if (layer, scale) in scores]
        if len(both) == 2:
            scores["joint", scale] = _joint(np.abs(np.nan_to_num(both[0])), np.abs(np.nan_to_num(both[1])))
    return DefectScores(scores)


def _joint(first: Plane, second: Plane) -> Plane:
    """Return the joint score where both layers exceed `SCORES.least_joint`, else 0."""
    together = np.float32(SCORES.joint) * np.hypot(first, second)
    return np.where(np.minimum(first, second) >= SCORES.least_joint, together, np.float32(0))


def limit_of(layer: str, scale_px: float, evidence: Evidence, limit: float) -> float:
    """Return the limit for a layer at a scale, higher for a single layer where both are inspected.

    Wide scales have fewer independent positions, so that an equally rare deviation is lower.
    """
    fewer = 1.0 if layer == SHARP else 1 + scale_px**2
    alone = SCORES.alone if evidence == "both" and layer != "joint" else 1.0
    return limit * alone * math.sqrt(1 - 2 * math.log(fewer) / SCORES.rare_at**2)


def lower_threshold(threshold_sigma: float) -> float:
    """Return the lower hysteresis threshold for an upper one."""
    return max(SCORES.least_low, SCORES.low_share * threshold_sigma)


def new_counts() -> NDArray[np.int64]:
    """An empty histogram of peaks."""
    return np.zeros(round(FALSE_COUNTS.end / FALSE_COUNTS.step), np.int64)


def add_to_peak_histogram(
    scores: DefectScores, recipe: DefectRecipe, shape: tuple[int, int], counts: NDArray[np.int64]
) -> None:
    """Add the peaks of a cell over a lower limit to a histogram of the score relative to its layer's limit."""
    highest = np.zeros(shape, np.float32)
    for (layer, scale), plane in scores.planes.items():
        if layer in SEEKING:
            by = np.abs(plane) * np.float32(1 / limit_of(layer, scale, recipe.evidence, 1.0))
            np.fmax(highest, enlarged(by, side_of(layer, scale), shape), out=highest)
    tops = region_maxima(highest, FALSE_COUNTS.counted_from)
    counts += np.bincount(np.minimum(tops / FALSE_COUNTS.step, len(counts) - 1).astype(int), minlength=len(counts))


def false_counts(counts: NDArray[np.int64], inspected_mm2: float) -> FalseCounts:
    """Estimate the false counts per area by threshold from the histogram of peaks.

    Noise peaks fall as exp(-s t2), and defects are few among the lower peaks. The decay rate is fitted where peaks are
    many, taken as that of normal noise where they are too few, and extrapolated to all thresholds.
    """
    if inspected_mm2 <= 0:
        return FalseCounts()
    middles = (np.arange(len(counts)) + 0.5) * FALSE_COUNTS.step
    used = (
        (middles >= FALSE_COUNTS.fitted_from)
        & (middles <= FALSE_COUNTS.fitted_to)
        & (counts >= FALSE_COUNTS.least_counted)
    )
    steep = FALSE_COUNTS.normal_fall
    if np.count_nonzero(used) >= FALSE_COUNTS.least_bins:
        slope = np.polyfit(middles[used] ** 2, np.log(counts[used]), 1, w=np.sqrt(counts[used]))[0]
        steep = float(np.clip(-slope, FALSE_COUNTS.slowest_fall, FALSE_COUNTS.normal_fall))
    anchor = (middles >= FALSE_COUNTS.fitted_from) & (middles <= FALSE_COUNTS.anchored_to)
    scale = max(1.0, float(counts[anchor].sum())) / float(np.exp(-steep * middles[anchor] ** 2).sum())
    wanted = np.arange(*FALSE_COUNTS.thresholds)
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
