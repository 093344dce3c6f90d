"""Bumps and balls that stand on a face: where they are, how high their tops lie, how wide they are. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_fill_holes, find_objects, label

from wafer_viewer.measure.base.height_samples import Floats, HeightSamples
from wafer_viewer.measure.base.robust_plane import LevelPlane, plane_design, robust_fit
from wafer_viewer.measure.base.sphere_fit import fit_cap
from wafer_viewer.measure.base.tile_statistics import parameter_u
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.surface.height_map import Heights

STANDS_OUT = 6.0
"""Deviations of the ground by which a bump stands out of it."""
HALF_WAY, CAP_FROM = 0.5, 0.7
"""Of a bump's height: where its width is taken, and from where up its top is fitted."""
ALIKE = 4.0
"""How much larger or smaller in area than most of what stands out a bump may be."""
LEAST_PX = 12
"""A bump has at least so many pixels over half of its height."""
LEAST_MEASURED = 0.5
"""Of a bump's outline: with less of it measured its top is not known."""
RING = (1.3, 2.2)
"""The surroundings of a bump lie between these shares of its radius."""
LEAST_ROUND = 20
MIN_TOP_POINTS = 12
_ROUNDS = 12
Mask = NDArray[np.bool_]
Box = tuple[slice, slice]


@dataclass(frozen=True, slots=True, eq=False)
class Top:
    """One bump: the place and height of its top with what it is unsure by (k = 1; None: not known), its height over its
    surroundings, its diameter at half of that."""

    x_um: float
    y_um: float
    z_um: float
    u_um: float | None
    height_um: float
    u_round_um: float | None
    diameter_um: float


@dataclass(frozen=True, slots=True, eq=False)
class Bumps:
    """The bumps of a part of a surface, and how many were left out: cut by its border, or with a top not measured."""

    tops: tuple[Top, ...]
    left_out: int


def find_bumps(part: Heights, within: Mask) -> Bumps:
    """The bumps within a part of a surface, from top to bottom.

    Bumps are alike: what is less than half or more than twice as wide as most of what stands out is none of them.
    within: bool [row, col], what of the part is looked at. Raises MeasureError when nothing stands out of the ground.
    """
    z_um = np.where(within, part.z_um, np.nan).astype(np.float64)
    over, noise_um = _over_ground(part, z_um)
    numbers, boxes = _outlines(over, noise_um)
    outlines = [numbers[box] == number for number, box in enumerate(boxes, 1)]
    usual_px = _usual([(float(outline.sum()), int(outline.sum())) for outline in outlines])
    found, left_out = list[Top](), 0
    for box, outline in zip(boxes, outlines, strict=True):
        if max(usual_px / ALIKE, LEAST_PX) <= outline.sum() <= ALIKE * usual_px:
            top = _top(part, z_um, over, box, outline) if _whole(outline, box, within, z_um) else None
            found, left_out = (found, left_out + 1) if top is None else ([*found, top], left_out)
    return Bumps(tuple(found), left_out)


def _over_ground(part: Heights, z_um: Floats) -> tuple[Floats, float]:
    """Heights over the plane of the ground, and how much the ground itself scatters about it.

    What stands out is left out again and again, so that the plane sinks to what lies lowest.
    """
    rows, cols = np.nonzero(np.isfinite(z_um))
    points = HeightSamples(part.x_um[cols], part.y_um[rows], z_um[rows, cols])
    if len(points) < LEAST_ROUND:
        raise MeasureError("Nothing is measured in the region: move it to where the surface has heights.")
    every = max(1, len(points) // 200_000)
    some = points.kept(np.arange(len(points)) % every == 0)
    plane, noise_um = _ground(some)
    return z_um - np.asarray(plane.at(part.x_um[None, :], part.y_um[:, None])), noise_um


def _ground(points: HeightSamples) -> tuple[LevelPlane, float]:
    center = float(points.x_um.mean()), float(points.y_um.mean())
    design = plane_design(points, center)
    kept, below = np.ones(len(points), bool), 0.0
    slope_x = slope_y = z_um = 0.0
    for _ in range(_ROUNDS):
        slope_x, slope_y, z_um = robust_fit(design[kept], points.z_um[kept]).coefficients.tolist()
        left = points.z_um - design @ np.array([slope_x, slope_y, z_um])
        below = float(np.sqrt(np.mean(left[left < 0] ** 2))) if (left < 0).any() else 0.0
        lower = left <= 2 * max(below, 1e-9)
        if np.array_equal(lower, kept) or np.count_nonzero(lower) < LEAST_ROUND:
            break
        kept = lower
    return LevelPlane(*center, z_um, slope_x, slope_y), below


def _outlines(over: Floats, noise_um: float) -> tuple[NDArray[np.int32], list[Box]]:
    """Numbers of what stands out over half of the usual height, [row, col], and the box round each."""
    numbers, boxes = _labelled(over > STANDS_OUT * max(noise_um, 1e-6))
    inside = [over[box][numbers[box] == k] for k, box in enumerate(boxes, 1)]
    tops = [(float(np.nanmax(heights)), len(heights)) for heights in inside if len(heights) >= LEAST_PX]
    if not tops:
        raise MeasureError(
            f"No bump stands out of the ground by {STANDS_OUT:g} of its deviations ({STANDS_OUT * noise_um:.2f} um): "
            "draw the region over bumps that are measured."
        )
    return _labelled(over > max(HALF_WAY * _usual(tops), STANDS_OUT * noise_um))


def _usual(values: list[tuple[float, int]]) -> float:
    """The median of values, each counted as often as it has pixels: specks do not weigh."""
    ordered = sorted(values)
    weights = np.cumsum([weight for _, weight in ordered])
    return ordered[int(np.searchsorted(weights, weights[-1] / 2))][0]


def _labelled(mask: Mask) -> tuple[NDArray[np.int32], list[Box]]:
    numbers = np.zeros(mask.shape, np.int32)
    label(binary_fill_holes(mask), output=numbers)
    return numbers, find_objects(numbers)


def _whole(outline: Mask, box: Box, within: Mask, z_um: Floats) -> bool:
    """Whether a bump lies all within what is looked at, and enough of it is measured."""
    rows, cols = (slice(max(0, side.start - 1), side.stop + 1) for side in box)
    at_border = box[0].start == 0 or box[1].start == 0 or box[0].stop == len(within) or box[1].stop == within.shape[1]
    measured = np.isfinite(z_um[box])[outline].mean()
    return not at_border and bool(within[rows, cols].all()) and measured >= LEAST_MEASURED


def _top(part: Heights, z_um: Floats, over: Floats, box: Box, outline: Mask) -> Top | None:
    """The top by a sphere fitted to it; None where none fits."""
    highest = float(np.nanquantile(over[box][outline], 0.98))
    points = _points(part, z_um, box, outline & (over[box] >= CAP_FROM * highest))
    if len(points) < MIN_TOP_POINTS:
        return None
    try:
        cap, kept = fit_cap(points)
    except MeasureError:
        return None
    radius_um = math.sqrt(np.count_nonzero(outline) / math.pi) * part.pixel_um
    if math.hypot(cap.x_um - points.x_um.mean(), cap.y_um - points.y_um.mean()) > radius_um:
        return None
    ground = _round(part, z_um, over, (cap.x_um, cap.y_um), radius_um)
    if ground is None:
        return None
    u_um = parameter_u(kept, cap.slopes(kept), kept.z_um - cap.at(kept), np.array([0.0, 0.0, 1.0, 0.0]))
    return Top(cap.x_um, cap.y_um, cap.z_um, u_um, cap.z_um - ground[0], ground[1], 2 * radius_um)


def _round(
    part: Heights, z_um: Floats, over: Floats, at: tuple[float, float], radius_um: float
) -> tuple[float, float | None] | None:
    """The height of the surroundings of a bump under its top, and its standard uncertainty; None: not measured."""
    reach = RING[1] * radius_um
    col, row = (at[0] - part.x0_um) / part.pixel_um, (part.y0_um - at[1]) / part.pixel_um
    px = reach / part.pixel_um
    box = slice(max(0, round(row - px)), round(row + px) + 1), slice(max(0, round(col - px)), round(col + px) + 1)
    ring = _points(part, z_um, box, over[box] < 0.25 * np.nanmax(over[box]))
    away = np.hypot(ring.x_um - at[0], ring.y_um - at[1]) / radius_um
    ring = ring.kept((away >= RING[0]) & (away <= RING[1]))
    if len(ring) < LEAST_ROUND:
        return None
    design = plane_design(ring, at)
    fit = robust_fit(design, ring.z_um)
    kept, left = ring.kept(fit.kept), fit.residuals[fit.kept]
    return float(fit.coefficients[2]), parameter_u(kept, design[fit.kept], left, np.array([0.0, 0.0, 1.0]))


def _points(part: Heights, z_um: Floats, box: Box, mask: Mask) -> HeightSamples:
    """The measured points of a box where a mask holds."""
    rows, cols = np.nonzero(mask & np.isfinite(z_um[box]))
    return HeightSamples(part.x_um[box[1]][cols], part.y_um[box[0]][rows], z_um[box][rows, cols])
