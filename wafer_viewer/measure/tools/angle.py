"""Angle between two faces: between the normals of the fitted planes."""

from __future__ import annotations

import math

import numpy as np

from wafer_viewer.measure.base.correlated_errors import Scatter
from wafer_viewer.measure.base.height_samples import Floats, Layer, level_for, require_area
from wafer_viewer.measure.base.measurement_context import PIXEL_SCALE, Lines, MeasurementContext
from wafer_viewer.measure.base.plane_faces import Face, enough_points, face_of
from wafer_viewer.model.measurement.measurements import FaceAngle
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Mosaic

ALONG_X = np.array([1.0, 0.0, 0.0])
"""Gradient of the slope of a face along x by its parameters: slope x, slope y, height."""
ALONG_Y = np.array([0.0, 1.0, 0.0])
"""The same of the slope along y."""
ENDS = 1.5
"""Slope of a plane through two halves that differ by a height, times its length over that height."""
SCALE_STEP = 1e-3
"""Relative step of the scale for the derivative of an angle by it."""


def face_angle(
    surface: Mosaic,
    first: Region,
    second: Region,
    *,
    calibration_valid: bool = True,
    layer: Layer | None = None,
    name: str = "",
) -> FaceAngle:
    """Measure the angle between two faces.

    The angle is that between the normals of the planes fitted to the faces, 0 if they are parallel.

    Parameters
    ----------
    surface : Mosaic
        Height map or mosaic to measure; regions are in its stage coordinates, um.
    first : Region
        Rectangle, circle or polygon on the first face, in stage um.
    second : Region
        Rectangle, circle or polygon on the second face, in stage um.
    calibration_valid : bool, optional
        Whether the calibration of the surface is valid. Default True. Where it is False, or the surface has no
        calibration, results have status 'uncalibrated' and no uncertainty.
    layer : {'unsmoothed', 'smoothed', 'filled'}, optional
        Height layer. Default None: the layer on which the recipe of the surface measures.
    name : str, optional
        Name of the result. Default ''.

    Returns
    -------
    FaceAngle
        Angle in degrees with its expanded uncertainty (k = 2), and for each face its tilt in degrees, the root mean
        square of its residuals in um, and its number of points.

    Raises
    ------
    MeasureError
        If a region is a line or a point, or lies outside the surface.
    MeasureError
        If a region has fewer than 200 measured points, or its points do not determine a plane.

    Notes
    -----
    The planes are fitted with rejection of outliers beyond 3 robust deviations. An angle near 0 has no direction, so
    the budget takes the larger of a face's slope uncertainties along x and along y.
    """
    require_area(first, "first")
    require_area(second, "second")
    reading, level = MeasurementContext.of(surface, layer, calibration_valid), level_for(surface, first, second)
    a, b = (
        face_of(reading, level, enough_points(surface, region, reading.layer, level, f"{which} region", "an angle"))
        for region, which in ((first, "first"), (second, "second"))
    )
    return FaceAngle(
        **reading.result_fields(name, level, *dict.fromkeys((*a.notes, *b.notes)), *reading.not_in_budget()),
        first=first,
        second=second,
        angle=reading.quantity(_angle_deg(_slopes(a), _slopes(b)), "deg", _lines(reading, a, b)),
        first_tilt_deg=_tilt_deg(a),
        second_tilt_deg=_tilt_deg(b),
        first_sq_um=a.sq_um,
        second_sq_um=b.sq_um,
        first_points=len(a.points),
        second_points=len(b.points),
    )


def _slopes(face: Face) -> Floats:
    return np.array([face.plane.slope_x, face.plane.slope_y])


def _angle_deg(a: Floats, b: Floats) -> float:
    """Return the angle between the normals (-slope_x, -slope_y, 1); accurate for small angles, unlike an arc cosine."""
    m, n = np.array([*-a, 1.0]), np.array([*-b, 1.0])
    return math.degrees(math.atan2(float(np.linalg.norm(np.cross(m, n))), float(m @ n)))


def _tilt_deg(face: Face) -> float:
    return math.degrees(math.atan(math.hypot(face.plane.slope_x, face.plane.slope_y)))


def _lines(reading: MeasurementContext, a: Face, b: Face) -> Lines:
    slopes = _slopes(a), _slopes(b)
    per_scale = abs(_angle_deg(*(slope * (1 + SCALE_STEP) for slope in slopes)) - _angle_deg(*slopes)) / SCALE_STEP
    return {
        "z scale": per_scale * reading.u_z_scale,
        PIXEL_SCALE: per_scale * reading.u_pixel_scale,
        "noise and form of the faces": Scatter.joined(_tilt_u_deg(a), _tilt_u_deg(b)),
        **reading.frame_lines(math.degrees(math.hypot(_per_height(a), _per_height(b)))),
    }


def _per_height(face: Face) -> float:
    """Return the change of a face's slope by a height difference between its ends."""
    return ENDS / min(float(np.ptp(face.points.x_um)), float(np.ptp(face.points.y_um)))


def _tilt_u_deg(face: Face) -> Scatter:
    """Return the largest uncertainty of a face's tilt over directions: an angle near 0 has no direction."""
    largest = Scatter.largest(face.scatter(axis) for axis in (ALONG_X, ALONG_Y))
    return largest.times(math.degrees(math.cos(math.radians(_tilt_deg(face)))))
