"""Plane faces, and the measured points of their regions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from wafer_viewer.measure.base.correlated_errors import Labels, Scatter
from wafer_viewer.measure.base.error_covariance import (
    UNRESOLVED_NOTE,
    ErrorCovariance,
    WeightedHeights,
    errors_of,
    side_by_side,
)
from wafer_viewer.measure.base.height_samples import (
    Floats,
    HeightSamples,
    Layer,
    level_for,
    points_in,
    require_area,
    require_region,
)
from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.base.robust_fit import LevelPlane, fit_plane, least_squares, plane_design
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Mosaic

MIN_POINTS = 200
"""Lower limit of the points of a face; fewer do not determine its scatter."""


@dataclass(frozen=True, eq=False)
class Face:
    """Accepted points of a face, the plane through them, and their residuals.

    part: index of the face's region that contains each point. errors: covariance of the errors of its heights.
    """

    points: HeightSamples
    plane: LevelPlane
    residuals_um: Floats
    part: Labels
    errors: ErrorCovariance

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

    @property
    def parts(self) -> tuple[HeightSamples, ...]:
        """Accepted points of each region."""
        return parts_of(self.points, self.part)

    def sums(self, gradient: Floats) -> Iterator[WeightedHeights]:
        """Yield gradient [3] times the parameters as a sum of heights, a term for each region."""
        whole = WeightedHeights.of_fit(self.points, self.design, gradient)
        for k, points in zip(np.unique(self.part), self.parts, strict=True):
            yield WeightedHeights.of(points, whole.weight[self.part == k])

    def scatter(self, gradient: Floats) -> Scatter:
        """Return the uncertainty of gradient [3] times the parameters."""
        return self.errors.scatter_of(float(gradient @ self._covariance @ gradient))

    @cached_property
    def _covariance(self) -> Floats:
        """Covariance [3, 3] of the parameters; a step asks for the uncertainty of ten gradients."""
        return self.errors.of_parameters(side_by_side(self.parts), self.design)

    @property
    def notes(self) -> tuple[str, ...]:
        """Note where the correlation of the errors is not resolved."""
        return () if self.errors.resolved else (UNRESOLVED_NOTE,)


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


def face_of(reading: MeasurementContext, level: int, *parts: HeightSamples) -> Face:
    """Fit a face to the points of one or several regions. Raises MeasureError when they do not determine a plane.

    reading, level: where the points are from; the errors of a small face are told by the surface around it.
    """
    points = joined(parts)
    plane, fit = fit_plane(points)
    used = points if fit.inliers.all() else points.select(fit.inliers)
    part = np.repeat(np.arange(len(parts)), [len(p) for p in parts])[fit.inliers]
    left_um = used.z_um - np.asarray(plane.at(used.x_um, used.y_um))
    design = plane_design(used, (plane.x_um, plane.y_um))
    errors = errors_of(reading, level, parts_of(used, part), design, left_um)
    return Face(used, plane, left_um, part, errors)


def parts_of(points: HeightSamples, part: Labels) -> tuple[HeightSamples, ...]:
    """Return the points of each region, those without points left out; part: region index of each point, ascending."""
    return tuple(points.select(part == k) for k in np.unique(part))


def joined(parts: Sequence[HeightSamples]) -> HeightSamples:
    """Return the points of several regions, concatenated in order."""
    union = parts[0]
    for part in parts[1:]:
        union = union.and_also(part)
    return union


Regions = Region | Sequence[Region]
LEAST_MEASURED = 0.5
"""Smallest measured fraction of a region for a representative result."""


def as_region_tuple(regions: Regions, which: str) -> tuple[Region, ...]:
    """Return the regions as a tuple. Raises MeasureError when there is none."""
    each = (regions,) if isinstance(regions, Region) else tuple(regions)
    if not each:
        raise MeasureError(f"No {which} region was given: draw at least one on the {which} face.")
    for region in each:
        require_region(region, which)
    return each


def require_measured(region: Region, measured_um2: float, which: str, what: str) -> float:
    """Return the measured fraction of a region; pixels off the surface count as unmeasured.

    which, what: words of the error message, as in 'The upper region … and a step height needs'. Raises MeasureError
    when it is less than half.
    """
    share = min(1.0, measured_um2 / (region.area_um2 or measured_um2))
    if share < LEAST_MEASURED:
        raise MeasureError(
            f"Only {100 * share:.0f} % of the {which} is measured and {what} needs {100 * LEAST_MEASURED:.0f} %: "
            "draw it where the surface has fewer holes."
        )
    return share


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


def lattice_of(area: Area) -> Floats:
    """Return the heights of a face, float64 [row, col] of its bounding rectangle; NaN where there are none."""
    points, pixel_um = area.points, area.pixel_um
    rows = np.rint((points.y_um.max() - points.y_um) / pixel_um).astype(np.intp)
    cols = np.rint((points.x_um - points.x_um.min()) / pixel_um).astype(np.intp)
    z_um = np.full((int(rows.max()) + 1, int(cols.max()) + 1), np.nan)
    z_um[rows, cols] = points.z_um
    return z_um


def least_squares_plane(points: HeightSamples) -> tuple[LevelPlane, Floats]:
    """Return the least-squares plane through all points (no outlier rejection), and the residuals.

    Standards on form and texture require this plane.
    """
    x_um, y_um = float(points.x_um.mean()), float(points.y_um.mean())
    slope_x, slope_y, z_um = least_squares(plane_design(points, (x_um, y_um)), points.z_um).tolist()
    plane = LevelPlane(x_um, y_um, z_um, slope_x, slope_y)
    return plane, points.z_um - np.asarray(plane.at(points.x_um, points.y_um))
