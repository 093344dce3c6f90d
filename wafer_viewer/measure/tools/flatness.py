"""Flatness of a face by ISO 12781: what is left of it about the plane of least squares, and its minimum zone."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from wafer_viewer.measure.base.area_samples import area_of, least_squares_plane
from wafer_viewer.measure.base.height_samples import Floats, HeightSamples, Layer
from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.model.measurement.measurements import Flatness
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Mosaic

BAND = (0.135, 99.865)
"""Per cent: between them lie 99.73 % of the heights, as within three deviations of normal ones."""
ROUNDING = 1e-9
"""Of the extent of a face: what is left of a plane is no more than rounding."""
EXTREMES = "FLTt is between the two most extreme points: noise and single false heights make it larger."


def flatness(
    surface: Mosaic, region: Region, *, calibration_valid: bool = True, layer: Layer | None = None, name: str = ""
) -> Flatness:
    """FLTt (highest over lowest) and FLTq (root mean square) about the least-squares plane, and the 99.73 % band.

    Beside them FLTt of the minimum zone: the lowest layer between two parallel planes that holds every point.

    No uncertainty: how far noise pulls the extremes apart is not evaluated. Raises MeasureError when the region is a
    line, lies outside, or has fewer than 200 measured points or less than half of its area measured.
    """
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    area = area_of(reading, region, "face", "flatness")
    _, left = least_squares_plane(area.points)
    low, high = np.percentile(left, BAND)
    return Flatness(
        **reading.told(name, area.level, EXTREMES),
        region=region,
        reference="least_squares",
        flt_t=reading.length(float(np.ptp(left)), None),
        flt_t_minimum_zone=reading.length(minimum_zone(area.points, left), None),
        flt_q=reading.length(float(np.sqrt(np.mean(left**2))), None),
        band_9973_um=float(high - low),
        points=len(area.points),
        measured_fraction=area.measured_fraction,
    )


def minimum_zone(points: HeightSamples, left_um: Floats) -> float:
    """Height in um, along z, of the lowest layer between two parallel planes that holds all points.

    left_um: what any plane near to it leaves of the points. Only corners of their convex hull can touch the layer's
    faces; which layer it is says a linear programme over those.
    """
    places = np.stack([points.x_um - points.x_um.mean(), points.y_um - points.y_um.mean()], axis=1)
    span_um, height_um = float(np.abs(places).max()), float(np.ptp(left_um))
    if height_um <= ROUNDING * span_um:
        return height_um
    cloud = np.column_stack([places / span_um, left_um / height_um])
    corners = cloud[ConvexHull(cloud).vertices]
    ones, zeros = np.ones(len(corners)), np.zeros(len(corners))
    # Unknown: two slopes, the layer's top and its foot over the middle. No corner lies over the one or under the other.
    under_top = np.column_stack([-corners[:, :2], -ones, zeros])
    over_foot = np.column_stack([corners[:, :2], zeros, ones])
    limits = np.concatenate([-corners[:, 2], corners[:, 2]])
    found = linprog([0, 0, 1, -1], A_ub=np.vstack([under_top, over_foot]), b_ub=limits, bounds=(None, None))
    return float(found.fun) * height_um
