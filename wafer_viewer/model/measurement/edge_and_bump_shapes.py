"""Results of shapes measured on the all-in-focus picture, and of bumps measured on the heights."""

from __future__ import annotations

from typing import ClassVar, Literal

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.measurement.measurement import MeasurementResult
from wafer_viewer.model.measurement.tool_options import (
    ChippingOptions,
    CircleOptions,
    CoplanarityOptions,
    DieOptions,
    KerfOptions,
)
from wafer_viewer.model.quantity import Length, Quantity
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import Fraction, NonNegative, Spec

Side = Literal["left", "right", "lower", "upper"]


class KerfWidth(MeasurementResult, frozen=True, kw_only=True, tag="kerf_width"):
    """Width of a kerf between the lines through its two edges, measured in the middle, and its extremes.

    first, second: the lines over the length of the detected edges; angle: between them, 0 if parallel.
    """

    region: Region
    options: KerfOptions = KerfOptions()
    width: Length
    narrowest: Length
    widest: Length
    angle: Quantity
    kerf: Literal["bright", "dark"]
    first: Region
    second: Region
    points: int

    @property
    def main(self) -> Quantity:
        """The mean width."""
        return self.width.quantity


class DieSize(MeasurementResult, frozen=True, kw_only=True, tag="die_size"):
    """A die measured by its four edges: width and height through the centre, rotation and squareness.

    rotation: anticlockwise from the stage axes; squareness: angle at the lower left corner minus 90 degrees; outline:
    the four corners where the edges intersect, anticlockwise from the lower left.
    """

    region: Region
    options: DieOptions = DieOptions()
    width: Length
    height: Length
    rotation: Quantity
    squareness: Quantity
    center: Point
    outline: Region
    die: Literal["bright", "dark"]
    points: int

    @property
    def main(self) -> Quantity:
        """The width."""
        return self.width.quantity


class CircleSize(MeasurementResult, frozen=True, kw_only=True, tag="circle"):
    """Least-squares circle through the edge of a round shape; roundness: RONt of ISO 12181 about it.

    circle: the circle drawn by the user; found: the fitted circle.
    """

    circle: Region
    options: CircleOptions = CircleOptions()
    diameter: Length
    radius: Length
    roundness: Length
    center: Point
    found: Region
    inside: Literal["bright", "dark"]
    points: int

    @property
    def main(self) -> Quantity:
        """The diameter."""
        return self.diameter.quantity


class Chip(Spec, frozen=True, kw_only=True):
    """A chip: position of its deepest point, depth, length along the edge and area."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    place: Point
    depth_um: NonNegative
    length_um: NonNegative
    area_um2: NonNegative


class Chipping(MeasurementResult, frozen=True, kw_only=True, tag="chipping"):
    """Material missing from a die along the straight line of its edge.

    deepest: largest distance from the line into the die, chip or not; longest, area: of the chips, which are deeper
    than limit_um; chips: the deepest first; edge: the line; die: side of the edge on which the die lies.
    """

    region: Region
    options: ChippingOptions = ChippingOptions()
    deepest: Length
    longest: Length
    area: Quantity
    n_chips: int
    chips: tuple[Chip, ...] = ()
    limit_um: NonNegative
    edge_length_um: NonNegative
    chipped_fraction: Fraction
    edge: Region
    die: Side
    points: int

    @property
    def main(self) -> Quantity:
        """The largest depth."""
        return self.deepest.quantity


class Bump(Spec, frozen=True, kw_only=True):
    """One bump: position, height of its top over its surroundings, width at half height, deviation.

    deviation: of its top from the plane of all tops, positive away from the substrate.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    place: Point
    height: Length
    diameter_um: NonNegative
    deviation: Length


class Coplanarity(MeasurementResult, frozen=True, kw_only=True, tag="coplanarity"):
    """Coplanarity of the tops of bumps after JESD22-B108.

    options.reference: least-squares plane through all tops, from which the range of deviations counts, or the seating
    plane, on which the part would stand. mean_height, height_range: of the bumps over their surroundings.
    left_out: bumps cut by the region, or with unmeasured tops.
    """

    region: Region
    options: CoplanarityOptions = CoplanarityOptions()
    coplanarity: Length
    mean_height: Length
    height_range: Length
    n_bumps: int
    left_out: int
    tilt_mrad: NonNegative
    bumps: tuple[Bump, ...] = ()

    @property
    def main(self) -> Quantity:
        """The coplanarity."""
        return self.coplanarity.quantity
