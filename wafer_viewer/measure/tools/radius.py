"""Radius of a bump or a pit: sphere fit within a circle, and top height over the plane of the surroundings.

The circle is drawn around the bump and contains surroundings as well. The sphere is fitted to points above a fraction
of the top height.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.correlated_errors import Scatter
from wafer_viewer.measure.base.error_covariance import ErrorCovariance, WeightedHeights
from wafer_viewer.measure.base.height_samples import Floats, HeightSamples, Layer, level_for, points_in
from wafer_viewer.measure.base.measurement_context import PIXEL_SCALE, WINDOW, Lines, MeasurementContext
from wafer_viewer.measure.base.pixel_noise import noise_um, pixel_noise_um
from wafer_viewer.measure.base.plane_faces import Face, face_of
from wafer_viewer.measure.base.robust_fit import Cap, LevelPlane, fit_cap, no_sphere
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import Radius
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.surface.height_map import Mosaic


@dataclass(frozen=True, slots=True)
class RadiusParameters:
    """Limits of the sphere fit to a bump or a pit.

    Parameters
    ----------
    cap_from : float
        Fraction of the top height above which the sphere is fitted; below it bumps have feet.
    ring : float
        Outer radius of the surroundings, relative to the circle.
    middle : float
        Radius of the initial search for the top, relative to the circle.
    least_points : int
        Smallest number of measured points of the surroundings, and of the bump.
    fitted_points : int
        Largest number of fitted points; with more, correlated errors do not reduce the uncertainty.
    rounds : int
        Number of times that the points of the sphere are chosen by the sphere of the time before.
    """

    cap_from: float = 0.3
    ring: float = 1.25
    middle: float = 0.3
    least_points: int = 50
    fitted_points: int = 100_000
    rounds: int = 3


RADIUS = RadiusParameters()
SHRINKS = 4.0
"""Change of the radius, in sags of the top, by averaging a sphere over the focus window."""
APEX, CURVATURE = np.array([0.0, 0.0, 1.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0])
"""Gradients of the height of the apex and of the curvature by the parameters of a sphere."""


def bump_radius(
    surface: Mosaic, circle: Region, *, calibration_valid: bool = True, layer: Layer | None = None, name: str = ""
) -> Radius:
    """Measure the sphere radius and the top height of a bump or a pit.

    Both have an expanded uncertainty (k = 2).

    Parameters
    ----------
    surface : Mosaic
        Height map or mosaic to measure; regions are in its stage coordinates, um.
    circle : Region
        Circle around the bump or pit, in stage um, with some of its surroundings in it.
    calibration_valid : bool, optional
        Whether the calibration of the surface is valid. Default True. Where it is False, or the surface has no
        calibration, results have status 'uncalibrated' and no uncertainty.
    layer : {'unsmoothed', 'smoothed', 'filled'}, optional
        Height layer. Default None: the layer on which the recipe of the surface measures.
    name : str, optional
        Name of the result. Default ''.

    Returns
    -------
    Radius
        Radius of the sphere and height of its top over the plane of the surroundings, both in um; the top is negative
        for a pit. Also the centre of the sphere and the root mean square residual of the fitted points, in um.

    Raises
    ------
    MeasureError
        If the region is no circle, or lies outside the surface.
    MeasureError
        If fewer than 50 points are measured around the circle or on the bump, or none in the middle of the circle.
    MeasureError
        If nothing stands out of the surroundings in the middle of the circle, or no sphere fits the heights.

    Notes
    -----
    The surroundings extend to a quarter of the circle's radius outside it. The sphere is fitted, with outlier
    rejection, to the points above 30 % of the top height, because bumps have feet below. At most 100 000 points, evenly
    thinned, are used.
    """
    if circle.kind != "circle":
        raise MeasureError(f"A radius is measured in a circle, this region is a {circle.kind}: draw a circle.")
    reading, outer = MeasurementContext.of(surface, layer, calibration_valid), _wider(circle)
    level = level_for(surface, outer)
    points = _thinned(points_in(surface, outer, reading.layer, level))
    inside = circle.contains(points.x_um, points.y_um)
    around = _surroundings(reading, level, points.select(~inside))
    cap, inliers = _cap(points.select(inside), around, circle)
    errors = cap_errors(cap, inliers, around.errors)
    return Radius(
        **reading.result_fields(name, level, *around.notes, *reading.not_in_budget()),
        circle=circle,
        kind="bump" if cap.curvature > 0 else "pit",
        radius=reading.length(
            cap.radius_um, _radius_lines(reading, cap, _of_cap(cap, inliers, CURVATURE), errors, around)
        ),
        top=reading.length(
            _top_um(cap, around.plane), _top_lines(reading, cap, _of_cap(cap, inliers, APEX), errors, around)
        ),
        center=Point(x_um=cap.x_um, y_um=cap.y_um),
        sq_um=float(np.sqrt(np.mean((inliers.z_um - cap.at(inliers)) ** 2))),
        points=len(inliers),
    )


def _thinned(points: HeightSamples) -> HeightSamples:
    every = -(-len(points) // RADIUS.fitted_points) or 1
    return points.select(np.arange(len(points)) % every == 0)


def _wider(circle: Region) -> Region:
    center = circle.points[0]
    return Region.circle(center.x_um, center.y_um, RADIUS.ring * circle.radius_um)


def _surroundings(reading: MeasurementContext, level: int, points: HeightSamples) -> Face:
    """Fit the face around a bump. Raises MeasureError with too few points."""
    if len(points) < RADIUS.least_points:
        raise MeasureError(
            f"Round the circle {len(points)} points are measured and a radius needs at least {RADIUS.least_points}: "
            "draw it larger, where its surroundings are measured."
        )
    return face_of(reading, level, points)


def _over(points: HeightSamples, plane: LevelPlane) -> Floats:
    """Return the heights of points over a plane."""
    return points.z_um - np.asarray(plane.at(points.x_um, points.y_um))


def _cap(points: HeightSamples, around: Face, circle: Region) -> tuple[Cap, HeightSamples]:
    """Fit the sphere to points that rise over the surroundings; return it and its points."""
    over, top_um = _over(points, around.plane), _first_top_um(points, around, circle)
    cap, inliers = _fitted(points.select(over / top_um >= RADIUS.cap_from))
    for _ in range(RADIUS.rounds):
        if cap.curvature * top_um < 0 or not circle.contains(np.array(cap.x_um), np.array(cap.y_um)):
            raise no_sphere()
        cap, inliers = _fitted(points.select(_in_cap(points, cap, around)), cap)
    return cap, inliers


def _in_cap(points: HeightSamples, cap: Cap, around: Face) -> NDArray[np.bool_]:
    """Return which points have a sufficiently high sphere; selection by their own noisy heights would be biased."""
    reached = cap.within_reach(points)
    near = points.select(reached)
    rises = cap.at(near) - np.asarray(around.plane.at(near.x_um, near.y_um))
    reached[reached] = rises / _top_um(cap, around.plane) >= RADIUS.cap_from
    return reached


def _fitted(rising: HeightSamples, start: Cap | None = None) -> tuple[Cap, HeightSamples]:
    if len(rising) < RADIUS.least_points:
        raise MeasureError(
            f"The bump has {len(rising)} measured points and a radius needs at least {RADIUS.least_points}: "
            "choose one that is larger or better measured."
        )
    return fit_cap(rising, start)


def _first_top_um(points: HeightSamples, around: Face, circle: Region) -> float:
    center = circle.points[0]
    middle = Region.circle(center.x_um, center.y_um, RADIUS.middle * circle.radius_um).contains(
        points.x_um, points.y_um
    )
    if not middle.any():
        raise MeasureError("Nothing is measured in the middle of the circle: draw it round a bump that is measured.")
    top_um = float(np.median(_over(points.select(middle), around.plane)))
    if abs(top_um) <= around.sq_um:
        raise MeasureError("Nothing stands out of the surroundings in the middle of the circle: draw it round a bump.")
    return top_um


def _top_um(cap: Cap, plane: LevelPlane) -> float:
    """Return the height of the sphere over the plane, along the plane's normal."""
    to_center = cap.z_um - 1 / cap.curvature - float(plane.at(cap.x_um, cap.y_um))
    return to_center / math.hypot(1.0, plane.slope_x, plane.slope_y) + 1 / cap.curvature


def cap_errors(cap: Cap, points: HeightSamples, around: ErrorCovariance) -> ErrorCovariance:
    """Return the covariance of the errors of a cap: that of its surroundings, larger where its points are noisier."""
    return around.covering(points, cap.slopes(points), points.z_um - cap.at(points))


def _of_cap(cap: Cap, points: HeightSamples, gradient: Floats) -> WeightedHeights:
    return WeightedHeights.of_fit(points, cap.slopes(points), gradient)


def _radius_lines(
    reading: MeasurementContext, cap: Cap, curvature: WeightedHeights, errors: ErrorCovariance, around: Face
) -> Lines:
    """Return the budget lines of the radius.

    Heights too large by a share f multiply the fitted curvature by 1 + c f. A larger z and pixel alike only enlarge
    the sphere, so that a pixel too large by f multiplies R by 1 + (1 + c) f. c is 1 for a shallow cap, less for a
    steep one.
    """
    heights_um = cap.at(HeightSamples(curvature.x_um, curvature.y_um, np.zeros(len(curvature.x_um))))
    stretch = float(curvature.weight @ heights_um) / cap.curvature
    cap_um = (1 - RADIUS.cap_from) * abs(_top_um(cap, around.plane))
    return {
        "z scale": reading.u_z_scale * abs(stretch) * cap.radius_um,
        PIXEL_SCALE: reading.u_pixel_scale * abs(1 + stretch) * cap.radius_um,
        "noise and form of the cap": _noise(reading, curvature, errors).times(cap.radius_um**2),
        WINDOW: SHRINKS * reading.sag_um(cap.curvature),
        **reading.frame_lines(cap.radius_um / cap_um),
    }


def _top_lines(
    reading: MeasurementContext, cap: Cap, apex: WeightedHeights, errors: ErrorCovariance, around: Face
) -> Lines:
    """Return the budget lines of the height of the top over the plane of the surroundings."""
    ground = np.array([cap.x_um - around.plane.x_um, cap.y_um - around.plane.y_um, 1.0])
    return {
        "z scale": reading.u_z_scale * abs(_top_um(cap, around.plane)),
        "noise and form of the cap": _noise(reading, apex, errors),
        "noise and form of the surroundings": around.scatter(ground),
        WINDOW: reading.sag_um(cap.curvature),
        **reading.frame_lines(),
    }


def _noise(reading: MeasurementContext, heights: WeightedHeights, errors: ErrorCovariance) -> Scatter:
    """Return the uncertainty of a sum over the points of the cap by their scatter and their own noise."""
    return noise_um(errors.scatter(heights), pixel_noise_um(reading, heights))
