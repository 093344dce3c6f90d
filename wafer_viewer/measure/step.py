"""The height of one region over another, with the budget of its uncertainty.

The model is one plane through both regions and a step between them, z = a x + b y + c + h [upper], fitted with
rejection beyond 3 robust deviations. Where the faces are tilted against each other the definition of h is part of the
result, so what other definitions give is noted with it.
"""

from __future__ import annotations

import math

import numpy as np

from wafer_viewer.measure.budget import step_budget
from wafer_viewer.measure.faces import Face, enough_points, face_of
from wafer_viewer.measure.heights import Layer, Points, level_for, require_area
from wafer_viewer.measure.level import plane_design, robust_fit
from wafer_viewer.measure.reading import Reading
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.findings import StepHeight
from wafer_viewer.model.quantities import Length
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface import Mosaic

DEFINITION = "Offset between the regions over one plane fitted to both: z = a x + b y + c + h [upper]."


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
    reading, level = Reading.of(surface, layer, calibration_valid), level_for(surface, upper, lower)
    above, below = (
        enough_points(surface, region, reading.layer, level, f"{which} region", "a step height")
        for region, which in ((upper, "upper"), (lower, "lower"))
    )
    _require_apart(upper, below)
    high, low = face_of(above), face_of(below)
    height_um = _common_plane_step(above, below)
    return StepHeight(
        **reading.told(name, level, *_other_definitions(high, low), *reading.not_in_budget()),
        upper=upper,
        lower=lower,
        height=_length(reading, high, low, height_um),
        definition=DEFINITION,
        upper_mean_um=high.mean_um,
        lower_mean_um=low.mean_um,
        upper_sq_um=high.sq_um,
        lower_sq_um=low.sq_um,
        upper_points=len(high.points),
        lower_points=len(low.points),
        relative_tilt_mrad=1e3 * math.hypot(*_tilt(high, low)),
    )


def _require_apart(upper: Region, below: Points) -> None:
    shared = int(np.count_nonzero(upper.contains(below.x_um, below.y_um)))
    if shared:
        raise MeasureError(f"The two regions share {shared} points: move them apart, each onto one face of the step.")


def _common_plane_step(above: Points, below: Points) -> float:
    both = above.and_also(below)
    is_upper = np.repeat([1.0, 0.0], [len(above), len(below)])
    center = float(both.x_um.mean()), float(both.y_um.mean())
    fit = robust_fit(np.column_stack([plane_design(both, center), is_upper]), both.z_um - both.z_um.mean())
    return float(fit.coefficients[3])


def _length(reading: Reading, high: Face, low: Face, height_um: float) -> Length:
    if not reading.calibrated:
        return Length(value_um=height_um, status="uncalibrated")
    budget = step_budget(
        (high.points, high.residuals_um),
        (low.points, low.residuals_um),
        height_um,
        _over_lower(high, low) - _over_upper(high, low),
        reading.surface.provenance,
    )
    return Length(value_um=height_um) if budget is None else Length.evaluated(height_um, budget)


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
