"""The radius of a bump or a pit: a sphere fitted within a circle, its top against the plane of the surroundings.

The circle is drawn round the bump, so it holds surroundings as well: the sphere is fitted to what rises over them by
more than a share of the top.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import Floats, HeightSamples, Layer, level_for, points_in
from wafer_viewer.measure.base.measurement_context import Lines, MeasurementContext
from wafer_viewer.measure.base.plane_faces import Face, face_of
from wafer_viewer.measure.base.robust_plane import LevelPlane, plane_design
from wafer_viewer.measure.base.sphere_fit import Cap, fit_cap, no_sphere
from wafer_viewer.measure.base.tile_statistics import parameter_u
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import Radius
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.surface.height_map import Mosaic

CAP_FROM = 0.3
"""The sphere is fitted to what rises over the surroundings by more than this share of the top: below it bumps have
feet."""
RING = 1.25
"""The surroundings are what lies between the circle and one so many times as large."""
MIDDLE = 0.3
"""The top is first looked for within this share of the circle's radius."""
MIN_POINTS = 50
FITTED_POINTS = 100_000
"""More points make a sphere no surer: neighbours err alike."""
_ROUNDS = 3


def bump_radius(
    surface: Mosaic, circle: Region, *, calibration_valid: bool = True, layer: Layer | None = None, name: str = ""
) -> Radius:
    """The radius of the bump or pit in a circle and the height of its top, with expanded uncertainties (k = 2).

    The top is negative for a pit. The surroundings are what lies up to a quarter of the circle's radius outside of it.
    Raises MeasureError when the region is no circle, lies outside, has too few measured points in it or round it, or
    when no sphere stands out of it.
    """
    if circle.kind != "circle":
        raise MeasureError(f"A radius is measured in a circle, this region is a {circle.kind}: draw a circle.")
    reading, outer = MeasurementContext.of(surface, layer, calibration_valid), _wider(circle)
    level = level_for(surface, outer)
    points = _thinned(points_in(surface, outer, reading.layer, level))
    inside = circle.contains(points.x_um, points.y_um)
    around = _surroundings(points.kept(~inside))
    cap, kept = _cap(points.kept(inside), around, circle)
    return Radius(
        **reading.told(name, level, *reading.not_in_budget()),
        circle=circle,
        kind="bump" if cap.curvature > 0 else "pit",
        radius=reading.length(cap.radius_um, _radius_lines(reading, cap, kept, around)),
        top=reading.length(_top_um(cap, around.plane), _top_lines(reading, cap, kept, around)),
        center=Point(x_um=cap.x_um, y_um=cap.y_um),
        sq_um=float(np.sqrt(np.mean((kept.z_um - cap.at(kept)) ** 2))),
        points=len(kept),
    )


def _thinned(points: HeightSamples) -> HeightSamples:
    every = -(-len(points) // FITTED_POINTS) or 1
    return points.kept(np.arange(len(points)) % every == 0)


def _wider(circle: Region) -> Region:
    at = circle.points[0]
    return Region.circle(at.x_um, at.y_um, RING * circle.radius_um)


def _surroundings(points: HeightSamples) -> Face:
    """What a bump rises over."""
    if len(points) < MIN_POINTS:
        raise MeasureError(
            f"Round the circle {len(points)} points are measured and a radius needs at least {MIN_POINTS}: "
            "draw it larger, where its surroundings are measured."
        )
    return face_of(points)


def _over(points: HeightSamples, plane: LevelPlane) -> Floats:
    """How far points rise over a plane."""
    return points.z_um - np.asarray(plane.at(points.x_um, points.y_um))


def _cap(points: HeightSamples, around: Face, circle: Region) -> tuple[Cap, HeightSamples]:
    """The sphere through what rises over the surroundings, and the points it is fitted to."""
    over, top_um = _over(points, around.plane), _first_top_um(points, around, circle)
    cap, kept = _fitted(points.kept(over / top_um >= CAP_FROM))
    for _ in range(_ROUNDS):
        if cap.curvature * top_um < 0 or not circle.contains(np.array(cap.x_um), np.array(cap.y_um)):
            raise no_sphere()
        cap, kept = _fitted(points.kept(_in_cap(points, cap, around)), cap)
    return cap, kept


def _in_cap(points: HeightSamples, cap: Cap, around: Face) -> NDArray[np.bool_]:
    """Which points lie where the sphere is high enough: picked by their own heights their noise would pick them."""
    reached = cap.reaches(points)
    near = points.kept(reached)
    rises = cap.at(near) - np.asarray(around.plane.at(near.x_um, near.y_um))
    reached[reached] = rises / _top_um(cap, around.plane) >= CAP_FROM
    return reached


def _fitted(rising: HeightSamples, start: Cap | None = None) -> tuple[Cap, HeightSamples]:
    if len(rising) < MIN_POINTS:
        raise MeasureError(
            f"The bump has {len(rising)} measured points and a radius needs at least {MIN_POINTS}: "
            "choose one that is larger or better measured."
        )
    return fit_cap(rising, start)


def _first_top_um(points: HeightSamples, around: Face, circle: Region) -> float:
    at = circle.points[0]
    middle = Region.circle(at.x_um, at.y_um, MIDDLE * circle.radius_um).contains(points.x_um, points.y_um)
    if not middle.any():
        raise MeasureError("Nothing is measured in the middle of the circle: draw it round a bump that is measured.")
    top_um = float(np.median(_over(points.kept(middle), around.plane)))
    if abs(top_um) <= around.sq_um:
        raise MeasureError("Nothing stands out of the surroundings in the middle of the circle: draw it round a bump.")
    return top_um


def _top_um(cap: Cap, plane: LevelPlane) -> float:
    """How far the sphere reaches over the plane, along the plane's normal."""
    to_center = cap.z_um - 1 / cap.curvature - float(plane.at(cap.x_um, cap.y_um))
    return to_center / math.hypot(1.0, plane.slope_x, plane.slope_y) + 1 / cap.curvature


def _radius_lines(reading: MeasurementContext, cap: Cap, kept: HeightSamples, around: Face) -> Lines | None:
    """A cap of radius a and height h has R = a^2 / 2 h: what h errs by R errs by, what a errs by twice."""
    u_curvature = parameter_u(kept, cap.slopes(kept), kept.z_um - cap.at(kept), np.array([0.0, 0.0, 0.0, 1.0]))
    if u_curvature is None:
        return None
    cap_um = (1 - CAP_FROM) * abs(_top_um(cap, around.plane))
    return {
        "z scale": reading.u_z_scale * cap.radius_um,
        "pixel scale": 2 * reading.u_pixel_scale * cap.radius_um,
        "noise and form of the cap": u_curvature * cap.radius_um**2,
        "interpolation between frames": reading.u_interpolation_um * cap.radius_um / cap_um,
    }


def _top_lines(reading: MeasurementContext, cap: Cap, kept: HeightSamples, around: Face) -> Lines | None:
    u_cap = parameter_u(kept, cap.slopes(kept), kept.z_um - cap.at(kept), np.array([0.0, 0.0, 1.0, 0.0]))
    design = plane_design(around.points, (cap.x_um, cap.y_um))
    u_plane = parameter_u(around.points, design, around.residuals_um, np.array([0.0, 0.0, 1.0]))
    if u_cap is None or u_plane is None:
        return None
    return {
        "z scale": reading.u_z_scale * abs(_top_um(cap, around.plane)),
        "noise and form of the cap": u_cap,
        "noise and form of the surroundings": u_plane,
        "interpolation between frames": reading.u_interpolation_um,
    }
