"""The height at a place, and the way from one place on the surface to another."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wafer_viewer.measure.base.height_samples import HeightSamples, Layer, points_in
from wafer_viewer.measure.base.measurement_context import Lines, MeasurementContext
from wafer_viewer.measure.base.robust_plane import fit_plane
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import Distance, PointHeight
from wafer_viewer.model.quantity import Quantity
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Mosaic

NEXT_PX = 1.5
"""A height is the median of the measured pixels up to so far away: of nine where none is missing."""
NOISE_WINDOWS = 5
"""The noise of a height is the scatter of those up to so many focus windows away, about a plane: errors are alike over
one window, so that a smaller part would not show them."""
UNKNOWN_WINDOW = 15
"""What is taken for a focus window that a surface does not tell of."""
MIN_NOISE_POINTS = 100
BY_HAND = "Not in the budget: where the points were set, distortion of the lens, places of the fields."


@dataclass(frozen=True, slots=True)
class Spot:
    """The height at a place with the noise round it, None where too little is measured to tell; how many pixels."""

    x_um: float
    y_um: float
    z_um: float
    noise_um: float | None
    points: int


def point_height(
    surface: Mosaic, place: Region, *, calibration_valid: bool = True, layer: Layer | None = None, name: str = ""
) -> PointHeight:
    """The height at a point over the zero of the surface, with its expanded uncertainty (k = 2).

    layer: heights to measure on, as the surface's recipe says when left out. Without a valid calibration the height
    reads 'uncalibrated'. Raises MeasureError when the region is no point, lies outside or where nothing is measured.
    """
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    spot = _spot(reading, place)
    return PointHeight(
        **reading.told(name, 0, *reading.not_in_budget()),
        place=place,
        height=reading.length(spot.z_um, _lines(reading, spot)),
        points=spot.points,
    )


def distance(
    surface: Mosaic,
    start: Region,
    end: Region,
    *,
    calibration_valid: bool = True,
    layer: Layer | None = None,
    name: str = "",
) -> Distance:
    """The way between two points: in space, lateral, along z (positive when `end` is higher), its slope in degrees.

    Raises MeasureError as `point_height` does, and where both points are the same.
    """
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    a, b = _spot(reading, start), _spot(reading, end)
    lateral_um, dz_um = math.hypot(b.x_um - a.x_um, b.y_um - a.y_um), b.z_um - a.z_um
    if lateral_um == 0:
        raise MeasureError(f"Both points are at ({a.x_um:.1f}, {a.y_um:.1f}) um: move one of them.")
    across: Lines = {"pixel scale": reading.u_pixel_scale * lateral_um}
    along = _lines_along_z(reading, a, b)
    space_um = math.hypot(lateral_um, dz_um)
    steepest_um = abs(dz_um) + math.hypot(*(along or {}).values())  # on level ground errors of dz count by their square
    return Distance(
        **reading.told(name, 0, *reading.not_in_budget(BY_HAND)),
        start=start,
        end=end,
        distance=reading.length(space_um, _joined(across, along, lateral_um / space_um, steepest_um / space_um)),
        lateral=reading.length(lateral_um, across),
        dz=reading.length(dz_um, along),
        slope=_slope(reading, lateral_um, dz_um, across, along),
    )


def _slope(
    reading: MeasurementContext, lateral_um: float, dz_um: float, across: Lines, along: Lines | None
) -> Quantity:
    space2 = lateral_um**2 + dz_um**2
    lines = _joined(across, along, math.degrees(dz_um / space2), math.degrees(lateral_um / space2))
    return reading.quantity(math.degrees(math.atan2(dz_um, lateral_um)), "deg", lines)


def _spot(reading: MeasurementContext, place: Region) -> Spot:
    if place.kind != "point":
        raise MeasureError(f"A height is measured at a point, this region is a {place.kind}: set a point.")
    at, pixel_um = place.points[0], reading.surface.pixel_um
    reading.surface.window(place)
    near = points_in(reading.surface, Region.circle(at.x_um, at.y_um, _reach_px(reading) * pixel_um), reading.layer, 0)
    beside = np.hypot(near.x_um - at.x_um, near.y_um - at.y_um) <= NEXT_PX * pixel_um
    if not beside.any():
        raise MeasureError(
            f"No height was measured at ({at.x_um:.1f}, {at.y_um:.1f}) um: "
            "set the point where the surface has no holes."
        )
    return Spot(at.x_um, at.y_um, float(np.median(near.z_um[beside])), _noise_um(near), int(beside.sum()))


def _reach_px(reading: MeasurementContext) -> int:
    window = reading.surface.provenance.recipe.window
    return NOISE_WINDOWS * (UNKNOWN_WINDOW if window == "auto" else window)


def _noise_um(near: HeightSamples) -> float | None:
    """Standard deviation of heights about a plane through them, outliers apart."""
    if len(near) < MIN_NOISE_POINTS:
        return None
    plane, fit = fit_plane(near)
    kept = near.kept(fit.kept)
    return float(np.sqrt(np.mean((kept.z_um - plane.at(kept.x_um, kept.y_um)) ** 2)))


def _lines(reading: MeasurementContext, spot: Spot) -> Lines | None:
    if spot.noise_um is None:
        return None
    return {
        "z scale": reading.u_z_scale * abs(spot.z_um),
        "noise and form round the point": spot.noise_um,
        "interpolation between frames": reading.u_interpolation_um,
    }


def _lines_along_z(reading: MeasurementContext, a: Spot, b: Spot) -> Lines | None:
    if a.noise_um is None or b.noise_um is None:
        return None
    return {
        "z scale": reading.u_z_scale * abs(b.z_um - a.z_um),
        "noise and form round the points": math.hypot(a.noise_um, b.noise_um),
        "interpolation between frames": reading.u_interpolation_um,
    }


def _joined(across: Lines, along: Lines | None, per_lateral: float, per_dz: float) -> Lines | None:
    """The lines of what depends on both, by how much it changes with each."""
    if along is None:
        return None
    return {n: abs(per_lateral) * u for n, u in across.items()} | {n: abs(per_dz) * u for n, u in along.items()}
