"""What was measured: numbers with their uncertainty, and what they were measured on.

Every finding has one `main` quantity, the number that stands for it in a list.
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
    """The points of a profile: distance_um and z_um, float64 [n]; NaN where the surface is unmeasured."""

    distance_um: NDArray[np.float64]
    z_um: NDArray[np.float64]
    x_um: NDArray[np.float64]
    y_um: NDArray[np.float64]


class Profile(MeasurementResult, frozen=True, kw_only=True, tag="profile"):
    """A section along a line: its total height Pt and the rise from its first to its last measured point."""

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
    """The height at a place: the median of the measured pixels next to it."""

    place: Region
    height: Length
    points: int

    @property
    def main(self) -> Quantity:
        """The height."""
        return self.height.quantity


class Distance(MeasurementResult, frozen=True, kw_only=True, tag="distance"):
    """From one place on the surface to another: in space, on the map, along z, and how steep the way is."""

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
    """The angle between the normals of two faces, 0 where they are parallel; tilts are those of the faces alone."""

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
    """The sphere through a bump or a pit; top: how far its highest (lowest) point lies over (under) its surroundings.

    sq_um: root mean square distance of the points from the sphere, along z.
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
    """What stands out of a plane within a region, and what lies under it; areas are projected along z.

    reference: the plane through the region's border, or the zero that heights are read from. Pixels within
    noise_um of the plane are area on neither side; as volume they count together, where more lies.
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
        """The volume above the plane, or below it where that is more."""
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
