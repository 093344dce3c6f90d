"""Measurement results: values with their uncertainty and the regions they were measured in.

Every result has one `main` quantity, which represents it in a list.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.measurement.levelling import Levelling
from wafer_viewer.model.measurement.tool_options import (
    ChippingOptions,
    CircleOptions,
    CoplanarityOptions,
    DieOptions,
    GrooveOptions,
    KerfOptions,
    RoughnessOptions,
    StepOptions,
    TextureOptions,
)
from wafer_viewer.model.quantity import Length, Quantity
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import Fraction, NonNegative, Positive, Spec


class MeasurementResult(Spec, frozen=True, kw_only=True):
    """Fields common to all results: name, surface and filter it was measured on, and whether any input is simulated.

    show: 0 for the stitched surface, else the number of a field, negative for a comparison; levelling: the zero of the
    heights.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    name: str = ""
    number: int = 0
    show: int = 0
    surface: Literal["unsmoothed", "smoothed", "filled"] = "unsmoothed"
    filter: str = "none"
    levelling: Levelling = Levelling()
    simulated: bool = False
    notes: tuple[str, ...] = ()

    input_fields: ClassVar[tuple[str, ...]] = ("region",)
    """Fields with the regions that the tool was given, in its order."""

    main_fields: ClassVar[tuple[str, ...]]
    """Field with the main quantity; of several, the one with the largest value."""

    @property
    def quantities(self) -> dict[str, Quantity]:
        """Quantities and lengths, by field name."""
        fields = {name: getattr(self, name) for name in self.__struct_fields__}
        values = {name: value for name, value in fields.items() if isinstance(value, Length | Quantity)}
        return {name: value.quantity if isinstance(value, Length) else value for name, value in values.items()}

    @property
    def main_field(self) -> str:
        """Name of the field with the main quantity."""
        quantities = self.quantities
        return max(self.main_fields, key=lambda name: quantities[name].value)

    @property
    def main(self) -> Quantity:
        """Quantity that represents the result in a list."""
        return self.quantities[self.main_field]

    @property
    def inputs(self) -> tuple[Region, ...]:
        """Regions that the tool was given."""
        return tuple(getattr(self, name) for name in self.input_fields)

    @property
    def detected(self) -> tuple[Region, ...]:
        """Edges and outlines that the tool found."""
        return ()

    @property
    def drawn(self) -> tuple[Region, ...]:
        """All regions to draw."""
        return (*self.inputs, *self.detected)


@dataclass(frozen=True, slots=True, eq=False)
class ProfileCurve:
    """Points of a profile: distance_um and z_um, float64 [n]; NaN where the surface is unmeasured."""

    distance_um: NDArray[np.float64]
    z_um: NDArray[np.float64]
    x_um: NDArray[np.float64]
    y_um: NDArray[np.float64]


class Profile(MeasurementResult, frozen=True, kw_only=True, tag="profile"):
    """A profile along a line: total height Pt, and rise from its first to its last measured point."""

    input_fields: ClassVar[tuple[str, ...]] = ("line",)
    main_fields: ClassVar[tuple[str, ...]] = ("pt",)
    line: Region
    length_um: NonNegative
    pt: Length
    rise: Length
    measured_fraction: NonNegative


class PointHeight(MeasurementResult, frozen=True, kw_only=True, tag="point"):
    """Height at a point: the median of the measured pixels around it."""

    input_fields: ClassVar[tuple[str, ...]] = ("place",)
    main_fields: ClassVar[tuple[str, ...]] = ("height",)
    place: Region
    height: Length
    points: int


class Distance(MeasurementResult, frozen=True, kw_only=True, tag="distance"):
    """Distance between two points on the surface: in space, lateral, along z, and the slope."""

    input_fields: ClassVar[tuple[str, ...]] = ("start", "end")
    main_fields: ClassVar[tuple[str, ...]] = ("distance",)
    start: Region
    end: Region
    distance: Length
    lateral: Length
    dz: Length
    slope: Quantity

    @property
    def detected(self) -> tuple[Region, ...]:
        """Line between the two points."""
        (a,), (b,) = self.start.points, self.end.points
        return (Region.line(a.x_um, a.y_um, b.x_um, b.y_um),)


class FaceAngle(MeasurementResult, frozen=True, kw_only=True, tag="angle"):
    """Angle between the normals of two faces, 0 if parallel; the tilts are those of the single faces."""

    input_fields: ClassVar[tuple[str, ...]] = ("first", "second")
    main_fields: ClassVar[tuple[str, ...]] = ("angle",)
    first: Region
    second: Region
    angle: Quantity
    first_tilt_deg: NonNegative
    second_tilt_deg: NonNegative
    first_sq_um: NonNegative
    second_sq_um: NonNegative
    first_points: int
    second_points: int


class Radius(MeasurementResult, frozen=True, kw_only=True, tag="radius"):
    """Sphere fitted to a bump or a pit; top: height of its highest (lowest) point over (under) its surroundings.

    sq_um: root mean square residual of the points from the sphere, along z.
    """

    input_fields: ClassVar[tuple[str, ...]] = ("circle",)
    main_fields: ClassVar[tuple[str, ...]] = ("radius",)
    circle: Region
    kind: Literal["bump", "pit"]
    radius: Length
    top: Length
    center: Point
    sq_um: NonNegative
    points: int


class AreaVolume(MeasurementResult, frozen=True, kw_only=True, tag="volume"):
    """Volume and area above and below a plane within a region; areas are projected along z.

    reference: plane through the border of the region, or the zero of the heights. Pixels within noise_um of the plane
    count for neither area; their volume counts, summed, on the side with more volume.
    """

    main_fields: ClassVar[tuple[str, ...]] = ("volume_above", "volume_below")
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


class Flatness(MeasurementResult, frozen=True, kw_only=True, tag="flatness"):
    """Flatness of a region, ISO 12781: FLTt and FLTq about a reference plane, and FLTt of the minimum zone."""

    main_fields: ClassVar[tuple[str, ...]] = ("flt_t",)
    region: Region
    reference: Literal["least_squares", "minimum_zone"]
    flt_t: Length
    flt_q: Length
    flt_t_minimum_zone: Length | None = None
    band_9973_um: NonNegative = 0.0
    points: int = 0
    measured_fraction: Fraction = 1.0


class StepHeight(MeasurementResult, frozen=True, kw_only=True, tag="step_height"):
    """Height of one face over another, with the definition of h.

    also_upper, also_lower: further regions of the two faces; at_joint: step of both faces extrapolated to the middle
    between the regions; tilt: of one face against the other, in mrad; not_evaluated: contributions missing from the
    budget.
    """

    input_fields: ClassVar[tuple[str, ...]] = ("upper", "lower")
    main_fields: ClassVar[tuple[str, ...]] = ("height",)
    upper: Region
    lower: Region
    also_upper: tuple[Region, ...] = ()
    also_lower: tuple[Region, ...] = ()
    height: Length
    definition: str
    options: StepOptions = StepOptions()
    at_joint: Length | None = None
    tilt: Quantity | None = None
    upper_mean_um: float
    lower_mean_um: float
    upper_sq_um: NonNegative
    lower_sq_um: NonNegative
    upper_points: int
    lower_points: int
    relative_tilt_mrad: NonNegative = 0.0
    not_evaluated: tuple[str, ...] = ()

    @property
    def detected(self) -> tuple[Region, ...]:
        """Further regions of the two faces."""
        return (*self.also_upper, *self.also_lower)


class StepProfile(MeasurementResult, frozen=True, kw_only=True, tag="step_profile"):
    """A groove, ridge or single step across a line, after ISO 5436-1: z = a x + b + h delta.

    height: depth of a groove or height of a ridge, positive; for a step, the height behind its edge minus that before
    it. edges_um: positions of the edges along the line; zones: names with their ends along the line, in um; curve: the
    profile in a few hundred points, distance and height in um.
    """

    input_fields: ClassVar[tuple[str, ...]] = ("line",)
    main_fields: ClassVar[tuple[str, ...]] = ("height",)
    line: Region
    kind: Literal["groove", "ridge", "step"]
    height: Length
    definition: str
    options: GrooveOptions = GrooveOptions()
    width: Length | None = None
    edges_um: tuple[float, ...]
    zones: tuple[tuple[str, float, float], ...]
    curve: tuple[tuple[float, float], ...] = ()
    sq_um: NonNegative
    points: int
    measured_fraction: NonNegative
    not_evaluated: tuple[str, ...] = ()


MOST_SITES = 400
"""With more sites only the region is drawn."""


class Site(Spec, frozen=True, kw_only=True):
    """One site with its centre in stage um; range is None if too little of it is measured."""

    x_um: float
    y_um: float
    range: Length | None
    measured_fraction: Fraction = 0.0


class SiteRanges(MeasurementResult, frozen=True, kw_only=True, tag="site_range"):
    """Front-surface site ranges, as mounted, row by row from the top left; `largest` of the measured ones.

    Rows and columns count complete sites; the remaining border belongs to none.
    """

    main_fields: ClassVar[tuple[str, ...]] = ("largest",)
    region: Region
    site_width_um: Positive
    site_height_um: Positive
    rows: int
    cols: int
    sites: tuple[Site, ...]
    largest: Length

    @property
    def outlines(self) -> tuple[Region, ...]:
        """Rectangles of all sites, in their order."""
        x, y = self.site_width_um / 2, self.site_height_um / 2
        return tuple(Region.rectangle(s.x_um - x, s.y_um - y, s.x_um + x, s.y_um + y) for s in self.sites)

    @property
    def detected(self) -> tuple[Region, ...]:
        """Outlines of the sites, unless there are very many."""
        return self.outlines if len(self.sites) <= MOST_SITES else ()


class Texture(MeasurementResult, frozen=True, kw_only=True, tag="texture"):
    """ISO 25178-2 parameters of a region, after removal of form and filtered wavelengths.

    Height: sa, sq, sp, sv, sz, ssk, sku. Hybrid: sdq (a slope), sdr_fraction. Functional: sk, spk, svk, smr1_fraction,
    smr2_fraction. Spatial: sal, str_ratio, std (across the lay, anticlockwise from +x). None: not defined for this
    surface; ssk, sku and sal for a flat one, std for one without a lay.
    """

    main_fields: ClassVar[tuple[str, ...]] = ("sa",)
    region: Region
    options: TextureOptions = TextureOptions()
    sa: Length
    sq: Length
    sp: Length
    sv: Length
    sz: Length
    ssk: float | None
    sku: float | None
    sdq: NonNegative | None = None
    sdr_fraction: NonNegative | None = None
    sk: Length | None = None
    spk: Length | None = None
    svk: Length | None = None
    smr1_fraction: Fraction | None = None
    smr2_fraction: Fraction | None = None
    sal: Length | None = None
    str_ratio: Fraction | None = None
    std: Quantity | None = None
    points: int
    measured_fraction: Fraction


class Roughness(MeasurementResult, frozen=True, kw_only=True, tag="roughness"):
    """ISO 21920-2 parameters along a line.

    ra, rq, rt, rsk, rku: over the whole evaluation length; rp, rv, rz: means over its sections of section_um each.
    Without a cut-off the profile is the primary profile with one section, and the standard names are Pa, Pq, Pt ...
    """

    input_fields: ClassVar[tuple[str, ...]] = ("line",)
    main_fields: ClassVar[tuple[str, ...]] = ("ra",)
    line: Region
    options: RoughnessOptions = RoughnessOptions()
    ra: Length
    rq: Length
    rz: Length
    rt: Length
    rp: Length
    rv: Length
    rsk: float | None
    rku: float | None
    sections: int
    section_um: NonNegative
    points: int
    measured_fraction: Fraction


Side = Literal["left", "right", "lower", "upper"]


class KerfWidth(MeasurementResult, frozen=True, kw_only=True, tag="kerf_width"):
    """Width of a kerf between the lines through its two edges, measured in the middle, and its extremes.

    first, second: the lines over the length of the detected edges; angle: between them, 0 if parallel.
    """

    main_fields: ClassVar[tuple[str, ...]] = ("width",)
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
    def detected(self) -> tuple[Region, ...]:
        """Both edges."""
        return self.first, self.second


class DieSize(MeasurementResult, frozen=True, kw_only=True, tag="die_size"):
    """A die measured by its four edges: width and height through the centre, rotation and squareness.

    rotation: anticlockwise from the stage axes; squareness: angle at the lower left corner minus 90 degrees; outline:
    the four corners where the edges intersect, anticlockwise from the lower left.
    """

    main_fields: ClassVar[tuple[str, ...]] = ("width",)
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
    def detected(self) -> tuple[Region, ...]:
        """Outline of the die."""
        return (self.outline,)


class CircleSize(MeasurementResult, frozen=True, kw_only=True, tag="circle"):
    """Least-squares circle through the edge of a round shape; roundness: RONt of ISO 12181 about it.

    circle: the circle drawn by the user; found: the fitted circle.
    """

    input_fields: ClassVar[tuple[str, ...]] = ("circle",)
    main_fields: ClassVar[tuple[str, ...]] = ("diameter",)
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
    def detected(self) -> tuple[Region, ...]:
        """The fitted circle."""
        return (self.found,)


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

    main_fields: ClassVar[tuple[str, ...]] = ("deepest",)
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
    def detected(self) -> tuple[Region, ...]:
        """Line of the edge."""
        return (self.edge,)


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

    main_fields: ClassVar[tuple[str, ...]] = ("coplanarity",)
    region: Region
    options: CoplanarityOptions = CoplanarityOptions()
    coplanarity: Length
    mean_height: Length
    height_range: Length
    n_bumps: int
    left_out: int
    tilt_mrad: NonNegative
    bumps: tuple[Bump, ...] = ()
