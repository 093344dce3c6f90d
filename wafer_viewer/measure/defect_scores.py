"""How far each place of a cell lies from its reference, in deviations of its own noise, at several scales. Pure.

A residual is divided by the spread of its position, held at LOUDEST so that one tall thing does not shine over all that
is near it, smoothed, and divided by the noise that is left at that scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.die_cells import Place, Plane
from wafer_viewer.measure.golden import Cell, Golden, robust_sigma
from wafer_viewer.measure.level import robust_fit
from wafer_viewer.model.defects import DefectRecipe, Evidence, FalseCounts
from wafer_viewer.numerics.cells import typical
from wafer_viewer.numerics.smoothing import coarseness, gaussian_sums

LOUDEST = 15.0
LOW_SHARE, LEAST_LOW = 0.6, 2.5
"""A defect reaches as far as it is over this share of the threshold, and over so many deviations."""
HISTOGRAM_STEP, HISTOGRAM_END = 0.125, 12.0
COUNTED_FROM, FITTED_FROM, ANCHORED_TO, FITTED_TO, LEAST_COUNTED = 2.25, 2.75, 3.75, 4.5, 8
NORMAL_FALL, SLOWEST_FALL = 0.5, 0.15
"""Of the logarithm of how many places reach a deviation, by its square: of normal noise, and the slowest believed."""
TILT_POINTS = 6_000
LAYERS = ("height", "picture")
Mask = NDArray[np.bool_]
Noise = dict[tuple[str, float], float | Plane]
"""Of the smoothed quotients, by layer and scale; of wide scales for each place."""
LOCAL_FROM_CELLS = 5
TAIL_PX, TAIL_SHARE = 32, 0.75
"""Noise with longer tails than normal is measured by the highest in blocks of so many pixels, in so many of the blocks:
defects are in the others."""
NEAR_HOLES_PX, UNSURE = 15, 4.0
"""Heights near unmeasured pixels are so much less sure: by the share that is unmeasured of so many pixels."""
ALONE, UNFILTERED_ALONE = 1.25, 2.6
"""What shows in heights or in the picture alone must lie so many times further out."""
JOINT, LEAST_JOINT = 0.93, 2.0
"""The root sum of squares of both is over a limit more often than either: so much of it is as rare."""


@dataclass(frozen=True, slots=True, eq=False)
class Residual:
    """A cell less its reference: heights with their plane taken off, grey values; the slopes of that plane."""

    place: Place
    z_um: Plane
    picture: Plane
    tilt: tuple[float, float]
    offset_um: float
    missing: Mask


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """Quotients of one cell by layer and scale, each [row, col] of squares of `coarseness` pixels."""

    planes: dict[tuple[str, float], Plane]


def residual_of(place: Place, cell: Cell, golden: Golden, pixel_um: float, flatten: bool) -> Residual:
    """A cell less its reference. flatten: the plane of what is left is taken off, and the grey offset."""
    z_um, picture = cell[0] - golden.z_um, cell[1] - golden.picture
    missing = np.isnan(cell[0]) & np.isfinite(golden.z_um)
    if not flatten:
        return Residual(place, z_um, picture, (0.0, 0.0), 0.0, missing)
    a, b, c = _plane(z_um)
    rows, cols = z_um.shape
    plane = (a * np.arange(rows)[:, None] + b * np.arange(cols)[None, :] + c).astype(np.float32)
    grey = picture[::4, ::4]
    grey = grey[np.isfinite(grey)]
    level = np.float32(np.median(grey)) if grey.size else np.float32(0)
    middle = a * rows / 2 + b * cols / 2 + c
    return Residual(place, z_um - plane, picture - level, (-a / pixel_um, b / pixel_um), middle, missing)


def quotients(residual: Residual, golden: Golden, recipe: DefectRecipe) -> dict[tuple[str, float], Plane]:
    """Residuals over their spread, smoothed at each scale, by layer and scale."""
    pairs = (("height", residual.z_um, golden.z_spread_um), ("picture", residual.picture, golden.picture_spread))
    planes: dict[tuple[str, float], Plane] = {}
    for layer, left, spread in pairs:
        if recipe.evidence in (layer, "both"):
            sure = _sureness(left) if layer == "height" else np.float32(1)
            part = np.clip(left / spread * sure, -LOUDEST, LOUDEST)
            known = np.isfinite(part)
            filled, weight = np.where(known, part, np.float32(0)), known.astype(np.float32)
            planes |= {(layer, scale): gaussian_sums(filled, weight, scale) for scale in recipe.scales_px}
    return planes


def _sureness(left: Plane) -> Plane:
    """1 where all is measured, less near holes; few lone pixels take little."""
    from scipy.ndimage import uniform_filter

    known = uniform_filter(np.isfinite(left).astype(np.float32), NEAR_HOLES_PX)
    return (1 / (1 + np.float32(UNSURE) * (1 - known))).astype(np.float32)


def noise_of(many: Sequence[dict[tuple[str, float], Plane]]) -> Noise:
    """The usual noise of quotients over some cells, by layer and scale.

    What is alike along edges adds up at wide scales: there the noise is that of each place, where cells are enough.
    """
    found: Noise = {}
    for key in many[0] if many else ():
        usual = _usual([planes[key] for planes in many], key[1])
        local = coarseness(key[1]) > 1 and len(many) >= LOCAL_FROM_CELLS
        found[key] = _local_noise([planes[key] for planes in many], usual) if local else usual
    return found


def _usual(planes: list[Plane], scale_px: float) -> float:
    """The deviation of normal noise that would reach as far."""
    sigmas = [sigma for plane in planes if (sigma := robust_sigma(plane)) > 0]
    highest = np.concatenate([_block_tops(plane, TAIL_PX // coarseness(scale_px)) for plane in planes])
    if not sigmas or not highest.size:
        return float(np.median(sigmas)) if sigmas else 1.0
    return max(float(np.median(sigmas)), float(np.quantile(highest, TAIL_SHARE)) / _reach_of_normal(scale_px))


def _block_tops(plane: Plane, side: int) -> NDArray[np.float32]:
    """The highest of each block that is known at all."""
    rows, cols = (n // side * side for n in plane.shape)
    blocks = np.abs(plane[:rows, :cols]).reshape(rows // side, side, cols // side, side)
    tops = np.nan_to_num(blocks).max(axis=(1, 3))
    return tops[tops > 0]


def _reach_of_normal(scale_px: float) -> float:
    """Below which the highest of a block of normal noise stays in TAIL_SHARE of the blocks."""
    from scipy.special import ndtri

    n = max(1.0, TAIL_PX**2 / (1 + 4 * np.pi * scale_px**2))
    return float(-ndtri((1 - TAIL_SHARE ** (1 / n)) / 2))


def _local_noise(planes: list[Plane], usual: float) -> Plane:
    """From cell to cell at each place and its neighbours, never less than the usual."""
    from scipy.ndimage import uniform_filter

    stack = np.stack(planes)
    middle, spread = np.empty(stack.shape[1:], np.float32), np.empty(stack.shape[1:], np.float32)
    typical(stack, 3, middle, spread)
    off = np.where(np.isfinite(spread), spread**2 + middle**2, usual**2)
    return np.maximum(usual, np.sqrt(uniform_filter(off, 3))).astype(np.float32)


def scores_of(planes: dict[tuple[str, float], Plane], noise: Noise) -> Scores:
    """Quotients in deviations of their noise."""
    scores = {key: plane / np.asarray(noise[key], np.float32) for key, plane in planes.items()}
    for scale in {scale for _, scale in planes}:
        both = [scores[layer, scale] for layer in LAYERS if (layer, scale) in scores]
        if len(both) == 2:
            scores["joint", scale] = _joint(np.abs(np.nan_to_num(both[0])), np.abs(np.nan_to_num(both[1])))
    return Scores(scores)


def _joint(first: Plane, second: Plane) -> Plane:
    """Both together where each says something."""
    together = np.float32(JOINT) * np.hypot(first, second)
    return np.where(np.minimum(first, second) >= LEAST_JOINT, together, np.float32(0))


def limit_of(layer: str, scale_px: float, evidence: Evidence, limit: float) -> float:
    """The limit for a layer at a scale: a single layer must lie further out where both are looked at.

    Unfiltered heights alone are never enough then: focus errs in patches of a few pixels.
    """
    if evidence != "both" or layer == "joint":
        return limit
    return limit * (UNFILTERED_ALONE if scale_px == 0 and layer == "height" else ALONE)


def low_of(threshold_sigma: float) -> float:
    """How far down a defect reaches whose peak is over the threshold."""
    return max(LEAST_LOW, LOW_SHARE * threshold_sigma)


def new_counts() -> NDArray[np.int64]:
    """An empty histogram of peaks."""
    return np.zeros(round(HISTOGRAM_END / HISTOGRAM_STEP), np.int64)


def count(scores: Scores, recipe: DefectRecipe, counts: NDArray[np.int64]) -> None:
    """Add the places of a cell over COUNTED_FROM to a histogram of how far over each reaches, by its layer's limit."""
    for (layer, scale), plane in scores.planes.items():
        by = (np.abs(plane) / limit_of(layer, scale, recipe.evidence, 1.0)).astype(np.float32)
        least = recipe.min_area_px if scale == 0 else 1
        tops = _tops(by, least)
        counts += np.bincount(np.minimum(tops / HISTOGRAM_STEP, len(counts) - 1).astype(int), minlength=len(counts))


def _tops(plane: Plane, least_px: int) -> NDArray[np.float32]:
    """The highest value of each place over COUNTED_FROM that has so many pixels."""
    from scipy.ndimage import label

    labels = np.zeros(plane.shape, np.int32)
    over = plane >= COUNTED_FROM
    label(over, np.ones((3, 3), int), output=labels)
    numbers = labels[over]
    tops = np.zeros(int(numbers.max(initial=0)) + 1, np.float32)
    np.maximum.at(tops, numbers, plane[over])
    large = np.bincount(numbers, minlength=len(tops)) >= least_px
    return tops[large & (tops > 0)]


def false_counts(counts: NDArray[np.int64], inspected_mm2: float) -> FalseCounts:
    """From the histogram of places: those of noise fall as exp(-s t2), and defects are few of the lower ones.

    The fall is fitted where places are many, taken as that of normal noise where they are too few for that, and
    followed to all thresholds.
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


def enlarged(mask: Mask, side: int, shape: tuple[int, int]) -> Mask:
    """Each square as its pixels; what is left over at the end holds nothing."""
    if side == 1:
        return mask
    out = np.zeros(shape, bool)
    big = mask.repeat(side, axis=0).repeat(side, axis=1)[: shape[0], : shape[1]]
    out[: big.shape[0], : big.shape[1]] = big
    return out


def _plane(z_um: Plane) -> tuple[float, float, float]:
    """Slopes down and right and the height at pixel (0, 0) of a plane through what is left of a cell."""
    step = max(1, round((z_um.size / TILT_POINTS) ** 0.5))
    some = z_um[::step, ::step]
    rows, cols = np.nonzero(np.isfinite(some))
    if len(rows) < 50:
        return 0.0, 0.0, 0.0
    design = np.stack([rows * float(step), cols * float(step), np.ones(len(rows))], axis=1).astype(np.float64)
    a, b, c = robust_fit(design, some[rows, cols].astype(np.float64)).coefficients.tolist()
    return a, b, c
