"""Flatness of a face by ISO 12781: deviations from the least-squares plane, and minimum zone."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from wafer_viewer.measure.base.height_samples import Floats, HeightSamples, Layer
from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.base.plane_faces import area_of, least_squares_plane
from wafer_viewer.model.measurement.measurements import Flatness
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Mosaic

BAND = (0.135, 99.865)
"""Percentiles that enclose 99.73 % of the heights, as +-3 deviations of normal noise do."""
ROUNDING = 1e-9
"""Residuals below this fraction of the extent of a face are rounding."""
EXTREMES = "FLTt is between the two most extreme points: noise and single false heights make it larger."


def flatness(
    surface: Mosaic, region: Region, *, calibration_valid: bool = True, layer: Layer | None = None, name: str = ""
) -> Flatness:
    """Measure the flatness of a face by ISO 12781.

    FLTt (peak to valley) and FLTq (root mean square) are about the least-squares plane. FLTt of the minimum zone is the
    smallest distance, along z, of two parallel planes that enclose every point.

    Parameters
    ----------
    surface : Mosaic
        Height map or mosaic to measure; regions are in its stage coordinates, um.
    region : Region
        Rectangle, circle or polygon on the face, in stage um.
    calibration_valid : bool, optional
        Whether the calibration of the surface is valid. Default True. Where it is False, or the surface has no
        calibration, results have status 'uncalibrated' and no uncertainty.
    layer : {'unsmoothed', 'smoothed', 'filled'}, optional
        Height layer. Default None: the layer on which the recipe of the surface measures.
    name : str, optional
        Name of the result. Default ''.

    Returns
    -------
    Flatness
        FLTt, FLTq, FLTt of the minimum zone, and the band that encloses 99.73 % of the heights, all in um and without
        uncertainty: the effect of noise on the extremes is not evaluated.

    Raises
    ------
    MeasureError
        If the region is a line or a point, or lies outside the surface.
    MeasureError
        If the region has fewer than 200 measured points or less than half of its area measured.
    MeasureError
        If its points do not determine a plane.

    Notes
    -----
    Every measured point counts; no outliers are rejected. FLTt is between the two most extreme points, so that noise
    and single false heights make it larger. Parameters are those of ISO 12781-1 [1]_.

    References
    ----------
    .. [1] ISO 12781-1, Flatness - Part 1: Vocabulary and parameters of flatness.
    """
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    area = area_of(reading, region, "face", "flatness")
    _, left = least_squares_plane(area.points)
    low, high = np.percentile(left, BAND)
    return Flatness(
        **reading.result_fields(name, area.level, EXTREMES),
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
    """Return the height in um, along z, of the minimum zone: two parallel planes that enclose all points.

    left_um: residuals from any plane near to it. Only vertices of the convex hull can touch the planes; a linear
    programme over these finds the zone.
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
