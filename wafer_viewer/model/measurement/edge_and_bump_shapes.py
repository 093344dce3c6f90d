"""Shapes measured on the picture that is in focus everywhere, and bumps measured on the heights."""

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
    """The width of a kerf between its two edges: that of the lines through them in the middle, and its extremes.

    first, second: the lines, from end to end of what was found; angle: between them, 0 where they are parallel.
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
    """A die by its four edges: distances of opposite ones through the middle, how it is turned, how square it is.

    rotation: counter-clockwise from the stage's axes; squareness: what the angle at the lower left corner is over 90
    degrees; outline: the four corners where the edges meet, counter-clockwise from the lower left.
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
    """The circle of least squares through the edge of something round; roundness: RONt of ISO 12181 about it.

    circle: the one drawn round it; found: the one found.
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
    """Where a chip is deepest, and how deep, how long along the edge and how large it is."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    place: Point
    depth_um: NonNegative
    length_um: NonNegative
    area_um2: NonNegative


class Chipping(MeasurementResult, frozen=True, kw_only=True, tag="chipping"):
    """What is missing of a die beside the straight line of its edge.

    deepest: the largest way from the line into the die, chip or not; longest, area: of the chips, which are places
    deeper than limit_um; chips: the deepest first; edge: the line; die: on which side of it the die lies.
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
    """One bump: where it is, its top over its surroundings, its width at half of that, and how far its top lies from
    the plane of all tops, away from the substrate."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    place: Point
    height: Length
    diameter_um: NonNegative
    deviation: Length


class Coplanarity(MeasurementResult, frozen=True, kw_only=True, tag="coplanarity"):
    """How far the tops of bumps lie from one plane, as JESD22-B108 has it.

    options.reference: the plane of least squares through all tops, from which the range of deviations counts; or the
    seating plane, on which the part would stand. mean_height, height_range: of the bumps over their own surroundings.
    left_out: bumps that the region cuts or whose tops are not measured.
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
