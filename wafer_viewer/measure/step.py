"""The height of one region over another, with the budget of its uncertainty.

The model is one plane through both regions and a step between them, z = a x + b y + c + h [upper], fitted with
rejection beyond 3 robust deviations. Where the faces are tilted against each other the definition of h is part of the
result, so what other definitions give is noted with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wafer_viewer.measure.budget import NOT_IN_BUDGET, step_budget
from wafer_viewer.measure.heights import (
    Floats,
    Layer,
    Points,
    layer_of,
    level_for,
    level_note,
    points_in,
    reported,
    require_area,
)
from wafer_viewer.measure.level import Plane, fit_plane, plane_design, robust_fit
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.findings import Length, StepHeight
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface import Mosaic

MIN_POINTS = 200
"""Fewer say too little of their own scatter."""
DEFINITION = "Offset between the regions over one plane fitted to both: z = a x + b y + c + h [upper]."


@dataclass(frozen=True, slots=True, eq=False)
class Face:
    """One of the two regions: its points that were not rejected, the plane through them, and their distance from it."""

    points: Points
    plane: Plane
    residuals_um: Floats

    @property
    def mean_um(self) -> float:
        """Mean height."""
        return float(self.points.z_um.mean())

    @property
    def sq_um(self) -> float:
        """Root mean square distance from its own plane."""
        return float(np.sqrt(np.mean(self.residuals_um**2)))


def step_height(
    surface: Mosaic,
    upper: Region,
    lower: Region,
    *,
    calibration_valid: bool = True,
    layer: Layer | None = None,
    name: str = "",
) -> StepHeight:
    """The height of `upper` over `lower`, negative when it lies below, with its expanded uncertainty (k = 2).

    layer: heights to measure on, as the surface's recipe says when left out. Without a calibration, or with one that
    is said not to be valid, the height reads 'uncalibrated' and has no uncertainty.
    Raises MeasureError when a region is a line, lies outside, has fewer than 200 measured points or overlaps the other.
    """
    require_area(upper, "upper")
    require_area(lower, "lower")
    measured_on, level = layer_of(surface.provenance.recipe, layer), level_for(surface, upper, lower)
    above, below = (_points(surface, r, w, measured_on, level) for r, w in ((upper, "upper"), (lower, "lower")))
    _require_apart(upper, below)
    high, low = _face(above), _face(below)
    height_um = _common_plane_step(above, below)
    return StepHeight(
        name=name,
        surface=measured_on,
        simulated=surface.provenance.simulated,
        notes=(*_other_definitions(high, low), *level_note(surface, level), NOT_IN_BUDGET),
        upper=upper,
        lower=lower,
        height=_length(surface, high, low, height_um, calibration_valid),
        definition=DEFINITION,
        upper_mean_um=high.mean_um,
        lower_mean_um=low.mean_um,
        upper_sq_um=high.sq_um,
        lower_sq_um=low.sq_um,
        upper_points=len(high.points),
        lower_points=len(low.points),
        relative_tilt_mrad=1e3 * math.hypot(*_tilt(high, low)),
    )


def _points(surface: Mosaic, region: Region, which: str, layer: Layer, level: int) -> Points:
    points = points_in(surface, region, layer, level)
    if len(points) < MIN_POINTS:
        raise MeasureError(
            f"The {which} region has {len(points)} measured points and a step height needs at least {MIN_POINTS}: "
            "draw it larger or move it to where heights were measured."
        )
    return points


def _require_apart(upper: Region, below: Points) -> None:
    shared = int(np.count_nonzero(upper.contains(below.x_um, below.y_um)))
    if shared:
        raise MeasureError(f"The two regions share {shared} points: move them apart, each onto one face of the step.")


def _face(points: Points) -> Face:
    plane, fit = fit_plane(points)
    kept = points.kept(fit.kept)
    return Face(kept, plane, kept.z_um - plane.at(kept.x_um, kept.y_um))


def _common_plane_step(above: Points, below: Points) -> float:
    both = above.and_also(below)
    is_upper = np.repeat([1.0, 0.0], [len(above), len(below)])
    center = float(both.x_um.mean()), float(both.y_um.mean())
    fit = robust_fit(np.column_stack([plane_design(both, center), is_upper]), both.z_um - both.z_um.mean())
    return float(fit.coefficients[3])


def _length(surface: Mosaic, high: Face, low: Face, height_um: float, calibration_valid: bool) -> Length:
    bare = reported(height_um, surface.provenance, calibration_valid)
    if bare.status == "uncalibrated":
        return bare
    budget = step_budget(
        (high.points, high.residuals_um),
        (low.points, low.residuals_um),
        height_um,
        _over_lower(high, low) - _over_upper(high, low),
        surface.provenance,
    )
    return bare if budget is None else Length.evaluated(height_um, budget)


def _tilt(high: Face, low: Face) -> tuple[float, float]:
    return high.plane.slope_x - low.plane.slope_x, high.plane.slope_y - low.plane.slope_y


def _over_lower(high: Face, low: Face) -> float:
    """The step when the surface is levelled to the lower face."""
    return float(high.plane.z_um - low.plane.at(high.plane.x_um, high.plane.y_um))


def _over_upper(high: Face, low: Face) -> float:
    """The step when the surface is levelled to the upper face."""
    return float(high.plane.at(low.plane.x_um, low.plane.y_um) - low.plane.z_um)


def _other_definitions(high: Face, low: Face) -> tuple[str, ...]:
    x_um, y_um = _middle_of_gap(high, low)
    place = f"({_tenths(x_um)}, {_tenths(y_um)}) um"
    at_joint = float(high.plane.at(x_um, y_um) - low.plane.at(x_um, y_um))
    return (
        f"Levelled to the upper face: {_over_upper(high, low):.3f} um, to the lower: {_over_lower(high, low):.3f} um.",
        f"Both faces extended to the middle between the regions, {place}: {at_joint:.3f} um.",
    )


def _middle_of_gap(high: Face, low: Face) -> tuple[float, float]:
    """Half-way between the borders that the regions turn to each other, on the line between their centroids."""
    start = np.array([low.plane.x_um, low.plane.y_um])
    way = np.array([high.plane.x_um, high.plane.y_um]) - start
    length = float(np.hypot(*way))
    along = way / length if length > 0 else way
    last_low = float(((low.points.x_um - start[0]) * along[0] + (low.points.y_um - start[1]) * along[1]).max())
    first_high = float(((high.points.x_um - start[0]) * along[0] + (high.points.y_um - start[1]) * along[1]).min())
    x_um, y_um = start + along * (last_low + first_high) / 2
    return float(x_um), float(y_um)


def _tenths(value: float) -> str:
    """One decimal, without a minus before zero."""
    return f"{round(value, 1) + 0.0:.1f}"
