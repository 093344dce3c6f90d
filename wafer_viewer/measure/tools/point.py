"""Point heights, and distances between points on the surface."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wafer_viewer.measure.base.correlated_errors import Scatter
from wafer_viewer.measure.base.error_covariance import ErrorCovariance, WeightedHeights, errors_round
from wafer_viewer.measure.base.height_samples import HeightSamples, Layer, points_in
from wafer_viewer.measure.base.measurement_context import Lines, MeasurementContext, combined, times
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import Distance, PointHeight
from wafer_viewer.model.quantity import Quantity
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic

NEXT_PX = 1.5
"""Radius of the median for a height: nine pixels where none is missing."""
MEDIAN_OF_NORMAL = math.pi / 2
"""Variance of the median of many normal values over that of their mean."""
BY_HAND = "Not in the budget: where the points were set, {distortion}places of the fields."


@dataclass(frozen=True, slots=True)
class Spot:
    """Height at a point, noise around it (None where too little is measured), and number of pixels."""

    x_um: float
    y_um: float
    z_um: float
    noise_um: Scatter | None
    points: int


def point_height(
    surface: Mosaic, place: Region, *, calibration_valid: bool = True, layer: Layer | None = None, name: str = ""
) -> PointHeight:
    """Measure the height at a point over the zero of the surface.

    Parameters
    ----------
    surface : Mosaic
        Height map or mosaic to measure; regions are in its stage coordinates, um.
    place : Region
        Point, in stage um.
    calibration_valid : bool, optional
        Whether the calibration of the surface is valid. Default True. Where it is False, or the surface has no
        calibration, results have status 'uncalibrated' and no uncertainty.
    layer : {'unsmoothed', 'smoothed', 'filled'}, optional
        Height layer. Default None: the layer on which the recipe of the surface measures.
    name : str, optional
        Name of the result. Default ''.

    Returns
    -------
    PointHeight
        Height in um with its expanded uncertainty (k = 2), and the number of pixels of its median. The uncertainty is
        not evaluated where fewer than 100 points are measured around the point and its own is not known.

    Raises
    ------
    MeasureError
        If the region is no point, or lies outside the surface.
    MeasureError
        If nothing is measured at the point.

    Notes
    -----
    The height is the median of the measured pixels within 1.5 pixels, nine where none is missing. Its noise follows
    from the standard deviation about a plane through the points within five focus windows, without outliers, and from
    the correlation of their errors; it is at least the uncertainty of the pixel itself (`HeightMap.u_um`), which alone
    is left where too few points are measured.
    """
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    spot = _spot(reading, place)
    return PointHeight(
        **reading.result_fields(name, 0, *reading.not_in_budget()),
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
    """Measure the distance of two points in space, lateral and along z.

    Parameters
    ----------
    surface : Mosaic
        Height map or mosaic to measure; regions are in its stage coordinates, um.
    start : Region
        First point, in stage um.
    end : Region
        Second point, in stage um.
    calibration_valid : bool, optional
        Whether the calibration of the surface is valid. Default True. Where it is False, or the surface has no
        calibration, results have status 'uncalibrated' and no uncertainty.
    layer : {'unsmoothed', 'smoothed', 'filled'}, optional
        Height layer. Default None: the layer on which the recipe of the surface measures.
    name : str, optional
        Name of the result. Default ''.

    Returns
    -------
    Distance
        Distance in space, lateral distance, and height difference, in um, and slope in degrees, with expanded
        uncertainties (k = 2). The height difference and the slope are positive when `end` is higher. Except for the
        lateral distance, the uncertainty is not evaluated where fewer than 100 points are measured around a point and
        its own is not known.

    Raises
    ------
    MeasureError
        If a region is no point, lies outside the surface, or nothing is measured there, as in `point_height`.
    MeasureError
        If both points have the same lateral position.

    Notes
    -----
    Not in the budget: the placement of the points, the positions of the fields and, before its x-y mapping deviation is
    measured, the distortion of the lens.
    """
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    a, b = _spot(reading, start), _spot(reading, end)
    lateral_um, dz_um = math.hypot(b.x_um - a.x_um, b.y_um - a.y_um), b.z_um - a.z_um
    if lateral_um == 0:
        raise MeasureError(f"Both points are at ({a.x_um:.1f}, {a.y_um:.1f}) um: move one of them.")
    by_hand = BY_HAND.format(distortion="distortion of the lens, " if reading.u_mapping_um is None else "")
    across: Lines = reading.lateral_lines(lateral_um)
    along = _lines_along_z(reading, a, b)
    space_um = math.hypot(lateral_um, dz_um)
    steepest_um = abs(dz_um) + combined((along or {}).values())  # on level ground errors of dz act by their square
    return Distance(
        **reading.result_fields(name, 0, *reading.not_in_budget(by_hand)),
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
    point, pixel_um = place.points[0], reading.surface.pixel_um
    pixel = reading.surface.window(place)
    near = points_in(reading.surface, Region.circle(point.x_um, point.y_um, 2 * NEXT_PX * pixel_um), reading.layer, 0)
    adjacent = near.select(np.hypot(near.x_um - point.x_um, near.y_um - point.y_um) <= NEXT_PX * pixel_um)
    if not len(adjacent):
        raise MeasureError(
            f"No height was measured at ({point.x_um:.1f}, {point.y_um:.1f}) um: "
            "set the point where the surface has no holes."
        )
    errors = errors_round(reading, point.x_um, point.y_um)
    scatter_um = None if errors is None else _of_median(errors, adjacent)
    noise_um = _at_least(scatter_um, _peak_noise_um(reading, pixel))
    return Spot(point.x_um, point.y_um, float(np.median(adjacent.z_um)), noise_um, len(adjacent))


def _peak_noise_um(reading: MeasurementContext, pixel: HeightMap) -> float | None:
    """Return the uncertainty of the pixel without what its frames cause, which has lines of its own; None if unknown.

    Errors of adjacent pixels are alike: their median has that of one.
    """
    u_um = np.nan if pixel.u_um is None or reading.layer != "unsmoothed" else float(pixel.u_um.max(initial=-np.inf))
    if not np.isfinite(u_um):
        return None
    of_frames_um = math.hypot(*reading.frame_lines(math.sqrt(0.5)).values())
    return math.sqrt(max(0.0, u_um**2 - of_frames_um**2))


def _at_least(scatter_um: Scatter | None, peak_um: float | None) -> Scatter | None:
    """Return the larger one: the scatter of a rough area may miss a faint place, and a small area has none."""
    peak = None if peak_um is None else Scatter(peak_um, math.inf)
    known = [scatter for scatter in (scatter_um, peak) if scatter is not None]
    return Scatter.largest(known) if known else None


def _of_median(errors: ErrorCovariance, adjacent: HeightSamples) -> Scatter:
    """Return the uncertainty of the median of adjacent heights."""
    mean = errors.scatter(WeightedHeights.of(adjacent, np.full(len(adjacent), 1 / len(adjacent))))
    single = errors.scatter(WeightedHeights.of(adjacent.select(np.arange(len(adjacent)) == 0), np.ones(1)))
    return min((mean.times(math.sqrt(MEDIAN_OF_NORMAL)), single), key=lambda scatter: scatter.expanded)


def _lines(reading: MeasurementContext, spot: Spot) -> Lines | None:
    if spot.noise_um is None:
        return None
    return {
        "z scale": reading.u_z_scale * abs(spot.z_um),
        "noise and form round the point": spot.noise_um,
        **reading.frame_lines(),
    }


def _lines_along_z(reading: MeasurementContext, a: Spot, b: Spot) -> Lines | None:
    if a.noise_um is None or b.noise_um is None:
        return None
    return {
        "z scale": reading.u_z_scale * abs(b.z_um - a.z_um),
        "noise and form round the points": Scatter.joined(a.noise_um, b.noise_um),
        **reading.frame_lines(),
    }


def _joined(across: Lines, along: Lines | None, per_lateral: float, per_dz: float) -> Lines | None:
    """Return the budget lines of a quantity that depends on both, with its sensitivity coefficients."""
    if along is None:
        return None
    parts = ((per_lateral, across), (per_dz, along))
    return {name: times(u, factor) for factor, lines in parts for name, u in lines.items()}
