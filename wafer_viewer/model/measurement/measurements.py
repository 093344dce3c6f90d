"""Measurement results: values with their uncertainty and the regions they were measured on.

Every result has one `main` quantity, which represents it in a list.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.measurement.measurement import MeasurementResult
from wafer_viewer.model.quantity import Length, Quantity
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import Fraction, NonNegative


@dataclass(frozen=True, slots=True, eq=False)
class ProfileCurve:
    """Points of a profile: distance_um and z_um, float64 [n]; NaN where the surface is unmeasured."""

    distance_um: NDArray[np.float64]
    z_um: NDArray[np.float64]
    x_um: NDArray[np.float64]
    y_um: NDArray[np.float64]


class Profile(MeasurementResult, frozen=True, kw_only=True, tag="profile"):
    """A profile along a line: total height Pt, and rise from its first to its last measured point."""

    line: Region
    length_um: NonNegative
    pt: Length
    rise: Length
    measured_fraction: NonNegative

    @property
    def main(self) -> Quantity:
        """Pt."""
        return self.pt.quantity


class PointHeight(MeasurementResult, frozen=True, kw_only=True, tag="point"):
    """Height at a point: the median of the measured pixels around it."""

    place: Region
    height: Length
    points: int

    @property
    def main(self) -> Quantity:
        """The height."""
        return self.height.quantity


class Distance(MeasurementResult, frozen=True, kw_only=True, tag="distance"):
    """Distance between two points on the surface: in space, lateral, along z, and the slope."""

    start: Region
    end: Region
    distance: Length
    lateral: Length
    dz: Length
    slope: Quantity

    @property
    def main(self) -> Quantity:
        """The distance in space."""
        return self.distance.quantity


class FaceAngle(MeasurementResult, frozen=True, kw_only=True, tag="angle"):
    """Angle between the normals of two faces, 0 if parallel; the tilts are those of the single faces."""

    first: Region
    second: Region
    angle: Quantity
    first_tilt_deg: NonNegative
    second_tilt_deg: NonNegative
    first_sq_um: NonNegative
    second_sq_um: NonNegative
    first_points: int
    second_points: int

    @property
    def main(self) -> Quantity:
        """The angle."""
        return self.angle


class Radius(MeasurementResult, frozen=True, kw_only=True, tag="radius"):
    """Sphere fitted to a bump or a pit; top: height of its highest (lowest) point over (under) its surroundings.

    sq_um: root mean square residual of the points from the sphere, along z.
    """

    circle: Region
    kind: Literal["bump", "pit"]
    radius: Length
    top: Length
    center: Point
    sq_um: NonNegative
    points: int

    @property
    def main(self) -> Quantity:
        """The radius of the sphere."""
        return self.radius.quantity


class AreaVolume(MeasurementResult, frozen=True, kw_only=True, tag="volume"):
    """Volume and area above and below a plane within a region; areas are projected along z.

    reference: plane through the border of the region, or the zero of the heights. Pixels within noise_um of the plane
    count for neither area; their volume counts, summed, on the side with more volume.
    """

    region: Region
    reference: Literal["border", "zero"]
    volume_above: Quantity
    volume_below: Quantity
    area: Quantity
    area_above: Quantity
    area_below: Quantity
    highest: Length
    lowest: Length
    noise_um: NonNegative
    measured_fraction: Fraction

    @property
    def main(self) -> Quantity:
        """Volume above the plane, or below it if that is larger."""
        return max(self.volume_above, self.volume_below, key=lambda volume: volume.value)


class Flatness(MeasurementResult, frozen=True, kw_only=True, tag="flatness"):
    """Flatness of a region, ISO 12781: FLTt and FLTq about a reference plane, and FLTt of the minimum zone."""

    region: Region
    reference: Literal["least_squares", "minimum_zone"]
    flt_t: Length
    flt_q: Length
    flt_t_minimum_zone: Length | None = None
    band_9973_um: NonNegative = 0.0
    points: int = 0
    measured_fraction: Fraction = 1.0

    @property
    def main(self) -> Quantity:
        """FLTt."""
        return self.flt_t.quantity
