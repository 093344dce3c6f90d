"""Measured points of an area region and the measured fraction of the region."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wafer_viewer.measure.base.height_samples import Floats, HeightSamples, level_for, require_area
from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.base.plane_faces import enough_points
from wafer_viewer.measure.base.region_samples import require_measured
from wafer_viewer.measure.base.robust_plane import LevelPlane, least_squares, plane_design
from wafer_viewer.model.region import Region


@dataclass(frozen=True, slots=True, eq=False)
class Area:
    """Measured points of a region, with the pyramid level, the pixel size at that level and the measured fraction."""

    points: HeightSamples
    level: int
    pixel_um: float
    measured_fraction: float

    @property
    def um2(self) -> float:
        """Projected area of the measured points."""
        return len(self.points) * self.pixel_um**2


def area_of(reading: MeasurementContext, region: Region, which: str, what: str) -> Area:
    """Return the measured points of a region; pixels off the surface count as unmeasured.

    which, what: words of the error message, as in 'The face … and flatness needs'. Raises MeasureError when the region
    is a line, lies outside the surface, or has fewer than 200 measured points or less than half of its area measured.
    """
    require_area(region, which)
    level = level_for(reading.surface, region)
    points = enough_points(reading.surface, region, reading.layer, level, which, what)
    pixel_um = reading.surface.pixel_um * 2**level
    share = require_measured(region, len(points) * pixel_um**2, which, what)
    return Area(points, level, pixel_um, share)


def least_squares_plane(points: HeightSamples) -> tuple[LevelPlane, Floats]:
    """Return the least-squares plane through all points (no outlier rejection), and the residuals.

    Standards on form and texture require this plane.
    """
    x_um, y_um = float(points.x_um.mean()), float(points.y_um.mean())
    slope_x, slope_y, z_um = least_squares(plane_design(points, (x_um, y_um)), points.z_um).tolist()
    plane = LevelPlane(x_um, y_um, z_um, slope_x, slope_y)
    return plane, points.z_um - np.asarray(plane.at(points.x_um, points.y_um))
