"""Detection of bumps and balls on a face: position, top height and width. Pure."""

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
"""Smallest prominence of a bump over the ground, in deviations of the ground."""
HALF_WAY, CAP_FROM = 0.5, 0.7
"""Fractions of a bump's height: for its width, and the lower bound of the top fit."""
ALIKE = 4.0
"""Largest ratio of a bump's area to the typical area, either way."""
LEAST_PX = 12
"""Smallest number of pixels of a bump above half of its height."""
LEAST_MEASURED = 0.5
"""Smallest measured fraction of a bump's outline for a top height."""
RING = (1.3, 2.2)
"""Inner and outer radius of the surroundings, in radii of the bump."""
LEAST_ROUND = 20
MIN_TOP_POINTS = 12
_ROUNDS = 12
Mask = NDArray[np.bool_]
Box = tuple[slice, slice]


@dataclass(frozen=True, slots=True, eq=False)
class Top:
    """One bump: position and height of its top, height over its surroundings, and diameter at half of that.

    u_um, u_round_um: standard uncertainties (k = 1) of the top and of the surroundings; None: not known.
    """

    x_um: float
    y_um: float
    z_um: float
    u_um: float | None
    height_um: float
    u_round_um: float | None
    diameter_um: float


@dataclass(frozen=True, slots=True, eq=False)
class Bumps:
    """The bumps of a part of a surface, and the number omitted: cut by the border, or with an unmeasured top."""

    tops: tuple[Top, ...]
    left_out: int


def find_bumps(part: Heights, within: Mask) -> Bumps:
    """Find the bumps within a part of a surface, from top to bottom.

    Bumps are assumed alike: objects of less than half or more than twice the typical width are not bumps. within: mask
    bool [row, col] of the searched pixels. Raises MeasureError when nothing stands out of the ground.
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
    """Return the heights over the ground plane, and the scatter of the ground about it.

    Prominent points are rejected iteratively, so that the plane converges to the lowest level.
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
    """Return labels [row, col] of objects above half of the typical height, and their bounding boxes."""
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
    """Return the median of values weighted by their number of pixels, so that specks do not count."""
    ordered = sorted(values)
    weights = np.cumsum([weight for _, weight in ordered])
    return ordered[int(np.searchsorted(weights, weights[-1] / 2))][0]


def _labelled(mask: Mask) -> tuple[NDArray[np.int32], list[Box]]:
    numbers = np.zeros(mask.shape, np.int32)
    label(binary_fill_holes(mask), output=numbers)
    return numbers, find_objects(numbers)


def _whole(outline: Mask, box: Box, within: Mask, z_um: Floats) -> bool:
    """Return whether a bump lies completely within the searched area, and enough of it is measured."""
    rows, cols = (slice(max(0, side.start - 1), side.stop + 1) for side in box)
    at_border = box[0].start == 0 or box[1].start == 0 or box[0].stop == len(within) or box[1].stop == within.shape[1]
    measured = np.isfinite(z_um[box])[outline].mean()
    return not at_border and bool(within[rows, cols].all()) and measured >= LEAST_MEASURED


def _top(part: Heights, z_um: Floats, over: Floats, box: Box, outline: Mask) -> Top | None:
    """Return the top from a sphere fit; None where none fits."""
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
    """Return the height of the surroundings under a bump's top, and its standard uncertainty; None if unmeasured."""
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
    """Return the measured points of a box within a mask."""
    rows, cols = np.nonzero(mask & np.isfinite(z_um[box]))
    return HeightSamples(part.x_um[box[1]][cols], part.y_um[box[0]][rows], z_um[box][rows, cols])
