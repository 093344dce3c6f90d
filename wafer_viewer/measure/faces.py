"""The plane faces that steps and angles lie between."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wafer_viewer.measure.heights import Floats, Layer, Points, points_in
from wafer_viewer.measure.level import Plane, fit_plane
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface import Mosaic

MIN_POINTS = 200
"""Fewer say too little of their own scatter."""


@dataclass(frozen=True, slots=True, eq=False)
class Face:
    """A region's points that were not rejected, the plane through them, and their distance from it."""

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


def enough_points(surface: Mosaic, region: Region, layer: Layer, level: int, which: str, what: str) -> Points:
    """The measured points of a region. Raises MeasureError when it lies outside or has fewer than 200.

    which, what: the region's name and what it is for, as in 'The upper region … and a step height needs'.
    """
    points = points_in(surface, region, layer, level)
    if len(points) < MIN_POINTS:
        raise MeasureError(
            f"The {which} has {len(points)} measured points and {what} needs at least {MIN_POINTS}: "
            "draw it larger or move it to where heights were measured."
        )
    return points


def face_of(points: Points) -> Face:
    """The face that points lie on. Raises MeasureError when they span no plane."""
    plane, fit = fit_plane(points)
    kept = points.kept(fit.kept)
    return Face(kept, plane, kept.z_um - plane.at(kept.x_um, kept.y_um))
