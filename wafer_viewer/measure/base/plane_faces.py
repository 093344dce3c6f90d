"""Plane faces for step and angle measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from wafer_viewer.measure.base.height_samples import Floats, HeightSamples, Layer, points_in
from wafer_viewer.measure.base.robust_plane import LevelPlane, fit_plane, plane_design
from wafer_viewer.measure.base.tile_statistics import (
    Labels,
    Scatter,
    Spread,
    extrapolated_uncertainty,
    tile_covariances,
)
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Mosaic

MIN_POINTS = 200
"""Lower limit of the points of a face; fewer do not determine its scatter."""


@dataclass(frozen=True, eq=False)
class Face:
    """Accepted points of a face, the plane through them, and their residuals.

    part: index of the face's region that contains each point.
    """

    points: HeightSamples
    plane: LevelPlane
    residuals_um: Floats
    part: Labels

    @property
    def mean_um(self) -> float:
        """Mean height."""
        return float(self.points.z_um.mean())

    @property
    def sq_um(self) -> float:
        """Root mean square of the residuals from its own plane."""
        return float(np.sqrt(np.mean(self.residuals_um**2)))

    @property
    def design(self) -> Floats:
        """Design matrix: columns x, y, 1 about the centre of the plane, for its slopes and height."""
        return plane_design(self.points, (self.plane.x_um, self.plane.y_um))

    @property
    def parameters(self) -> Floats:
        """Slope along x, slope along y, height at the centre."""
        return np.array([self.plane.slope_x, self.plane.slope_y, self.plane.z_um])

    @cached_property
    def spreads(self) -> list[Spread]:
        """Covariances of the parameters, by tiles of several sizes."""
        return tile_covariances(self.points, self.design, self.residuals_um, self.part)

    def scatter(self, gradient: Floats) -> Scatter | None:
        """Return the uncertainty of gradient [3] times the parameters; None with too few tiles."""
        return extrapolated_uncertainty(self.spreads, gradient)


def enough_points(surface: Mosaic, region: Region, layer: Layer, level: int, which: str, what: str) -> HeightSamples:
    """Return the measured points of a region. Raises MeasureError when it lies outside or has fewer than 200.

    which, what: the region's name and its purpose, as in 'The upper region … and a step height needs'.
    """
    points = points_in(surface, region, layer, level)
    if len(points) < MIN_POINTS:
        raise MeasureError(
            f"The {which} has {len(points)} measured points and {what} needs at least {MIN_POINTS}: "
            "draw it larger or move it to where heights were measured."
        )
    return points


def face_of(*parts: HeightSamples) -> Face:
    """Fit a face to the points of one or several regions. Raises MeasureError when they do not determine a plane."""
    points = joined(parts)
    plane, fit = fit_plane(points)
    kept = points if fit.kept.all() else points.kept(fit.kept)
    part = np.repeat(np.arange(len(parts)), [len(p) for p in parts])[fit.kept]
    return Face(kept, plane, kept.z_um - plane.at(kept.x_um, kept.y_um), part)


def joined(parts: Sequence[HeightSamples]) -> HeightSamples:
    """Return the points of several regions, concatenated in order."""
    whole = parts[0]
    for part in parts[1:]:
        whole = whole.and_also(part)
    return whole
