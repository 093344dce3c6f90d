"""Measurement results: values with their uncertainty and the regions they were measured in.

Every result has one `main` quantity, which represents it in a list.
"""

from __future__ import annotations

from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Annotated, Any, ClassVar, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.measurement.result_rows import UNLISTED, Label
from wafer_viewer.model.measurement.tool_options import (
    ChippingOptions,
    CircleOptions,
    CoplanarityOptions,
    DieOptions,
    GrooveOptions,
    KerfOptions,
    Levelling,
    RoughnessOptions,
    StepOptions,
    TextureOptions,
)
from wafer_viewer.model.quantity import Length, Quantity
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import Fraction, NonNegative, Positive, Spec

MEASURED = Label("Measured", "Share of the pixels that have a height")
_SKEWNESS = "Skewness: over 0 peaks, under 0 valleys prevail"
_KURTOSIS = "Kurtosis: 3 for normal heights"
_WHOLE = "of the whole evaluation length"


class MeasurementResult(Spec, frozen=True, kw_only=True):
    """Fields common to all results: name, surface and filter it was measured on, and whether any input is simulated.

    show: 0 for the stitched surface, else the number of a field, negative for a comparison; levelling: the zero of the
    heights.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    name: Annotated[str, UNLISTED] = ""
    number: Annotated[int, UNLISTED] = 0
    show: Annotated[int, UNLISTED] = 0
    surface: Annotated[Literal["unsmoothed", "smoothed", "filled"], UNLISTED] = "unsmoothed"
    filter: Annotated[str, UNLISTED] = "none"
    levelling: Annotated[Levelling, UNLISTED] = Levelling()
    simulated: Annotated[bool, UNLISTED] = False
    notes: Annotated[tuple[str, ...], UNLISTED] = ()

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

    def __float__(self) -> float:
        return float(self.main)

    def __repr__(self) -> str:
        main, others = self.main_field, [name for name in self.quantities if name != self.main_field]
        k = f" ({self.main.k_text})" if self.u is not None else f" ({self.main.status})"
        about = [f"{len(self.notes)} notes" if self.notes else "", "simulated" if self.simulated else ""]
        lines = [
            f"{type(self).__name__}: {self._words(main)}{k}",
            "; ".join(map(self._words, others[:_MOST_IN_REPR])) + ("; ..." if len(others) > _MOST_IN_REPR else ""),
            "; ".join(filter(None, (self.name, f"{self.surface} heights", *about))),
        ]
        return "\n  ".join(filter(None, lines))

    def _words(self, name: str) -> str:
        return f"{name.replace('_', ' ')} {self.quantities[name]}"

    @property
    def u(self) -> float | None:
        """Standard uncertainty (k = 1) of the main quantity, in its unit; None if it is not evaluated."""
        return self.main.u

    def to_dict(self) -> dict[str, Any]:
        """Return all fields as plain Python values; quantities as `Quantity.to_dict` returns them."""
        return msgspec.to_builtins(self) | {name: each.to_dict() for name, each in self.quantities.items()}

    def to_frame(self) -> Any:
        """Return a pandas.DataFrame with a row for each quantity. Raises MeasureError where pandas is missing."""
        try:
            import pandas
        except ImportError as missing:
            raise MeasureError("Data frames need pandas, which is not installed: pip install pandas.") from missing
        rows = {name: each.to_dict() | {"name": self.name} for name, each in self.quantities.items()}
        columns = ["name", "value", "unit", "u", "k", "freedom", "expanded", "status"]
        return pandas.DataFrame.from_dict(rows, orient="index")[columns].rename_axis("quantity")

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


_MOST_IN_REPR = 6
"""Quantities beside the main one that the text of a result names."""


@dataclass(frozen=True, slots=True, eq=False)
class ProfileCurve:
    """Points of a profile: distance_um and z_um, float64 [n]; NaN where the surface is unmeasured."""

    distance_um: NDArray[np.float64]
    z_um: NDArray[np.float64]
    x_um: NDArray[np.float64]
    y_um: NDArray[np.float64]

    def plot(self, axes: Any = None) -> Any:
        """Draw the heights over the distance by matplotlib, in new axes if none are given; return the axes."""
        return resolve_name("wafer_viewer.draw.plots:plot_profile")(self, axes)


class Profile(MeasurementResult, frozen=True, kw_only=True, tag="profile"):
    """A profile along a line: total height Pt, and rise from its first to its last measured point."""

    input_fields: ClassVar[tuple[str, ...]] = ("line",)
    main_fields: ClassVar[tuple[str, ...]] = ("pt",)
    line: Region
    length_um: Annotated[NonNegative, Label(digits=1)]
    pt: Annotated[Length, Label("Total height Pt")]
    rise: Annotated[Length, Label("Rise, first to last point", signed=True)]
    measured_fraction: Annotated[NonNegative, MEASURED]


class PointHeight(MeasurementResult, frozen=True, kw_only=True, tag="point"):
    """Height at a point: the median of the measured pixels around it."""

    input_fields: ClassVar[tuple[str, ...]] = ("place",)
    main_fields: ClassVar[tuple[str, ...]] = ("height",)
    place: Annotated[Region, Label("Place x, y")]
    height: Annotated[Length, Label(signed=True)]
    points: Annotated[int, Label("Pixels, their median")]


class Distance(MeasurementResult, frozen=True, kw_only=True, tag="distance"):
    """Distance between two points on the surface: in space, lateral, along z, and the slope."""

    input_fields: ClassVar[tuple[str, ...]] = ("start", "end")
    main_fields: ClassVar[tuple[str, ...]] = ("distance",)
    start: Annotated[Region, Label("From x, y")]
    end: Annotated[Region, Label("To x, y")]
    distance: Annotated[Length, Label("In space")]
    lateral: Annotated[Length, Label("On the map")]
    dz: Annotated[Length, Label("Rise Δz", signed=True)]
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
    first_tilt_deg: Annotated[NonNegative, Label("Tilt of the first face")]
    second_tilt_deg: Annotated[NonNegative, Label("Tilt of the second face")]
    first_sq_um: Annotated[NonNegative, Label("Sq of the first face")]
    second_sq_um: Annotated[NonNegative, Label("Sq of the second face")]
    first_points: Annotated[int, Label("Points on the first face")]
    second_points: Annotated[int, Label("Points on the second face")]


class Radius(MeasurementResult, frozen=True, kw_only=True, tag="radius"):
    """Sphere fitted to a bump or a pit; top: height of its highest (lowest) point over (under) its surroundings.

    sq_um: root mean square residual of the points from the sphere, along z.
    """

    input_fields: ClassVar[tuple[str, ...]] = ("circle",)
    main_fields: ClassVar[tuple[str, ...]] = ("radius",)
    circle: Region
    kind: Literal["bump", "pit"]
    radius: Length
    top: Annotated[Length, Label("Top over (bottom under) its surroundings")]
    center: Annotated[Point, Label("Centre x, y")]
    sq_um: Annotated[NonNegative, Label("Sq from the sphere")]
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
    area: Annotated[Quantity, Label("Area of the region")]
    area_above: Quantity
    area_below: Quantity
    highest: Annotated[Length, Label(signed=True)]
    lowest: Annotated[Length, Label(signed=True)]
    noise_um: Annotated[NonNegative, Label("Counts as neither within")]
    measured_fraction: Annotated[Fraction, MEASURED]


class Flatness(MeasurementResult, frozen=True, kw_only=True, tag="flatness"):
    """Flatness of a region, ISO 12781: FLTt and FLTq about a reference plane, and FLTt of the minimum zone."""

    main_fields: ClassVar[tuple[str, ...]] = ("flt_t",)
    region: Region
    reference: Literal["least_squares", "minimum_zone"]
    flt_t: Annotated[Length, Label("FLTt")]
    flt_q: Annotated[Length, Label("FLTq")]
    flt_t_minimum_zone: Annotated[Length | None, Label("FLTt, minimum zone")] = None
    band_9973_um: Annotated[NonNegative, Label("Band with 99.73 %")] = 0.0
    points: int = 0
    measured_fraction: Annotated[Fraction, MEASURED] = 1.0


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
    at_joint: Annotated[Length | None, Label("Step at the joint")] = None
    tilt: Annotated[Quantity | None, Label("Relative tilt")] = None
    upper_mean_um: Annotated[float, Label("Mean of the upper face", signed=True)]
    lower_mean_um: Annotated[float, Label("Mean of the lower face", signed=True)]
    upper_sq_um: Annotated[NonNegative, Label("Sq of the upper face")]
    lower_sq_um: Annotated[NonNegative, Label("Sq of the lower face")]
    upper_points: Annotated[int, Label("Points on the upper face")]
    lower_points: Annotated[int, Label("Points on the lower face")]
    relative_tilt_mrad: Annotated[NonNegative, Label("Relative tilt, without direction")] = 0.0
    not_evaluated: Annotated[tuple[str, ...], UNLISTED] = ()

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
    kind: Annotated[Literal["groove", "ridge", "step"], Label("The line crosses")]
    height: Length
    definition: str
    options: GrooveOptions = GrooveOptions()
    width: Length | None = None
    edges_um: Annotated[tuple[float, ...], Label("Edges along the line, µm", digits=1)]
    zones: Annotated[tuple[tuple[str, float, float], ...], UNLISTED]
    curve: Annotated[tuple[tuple[float, float], ...], UNLISTED] = ()
    sq_um: Annotated[NonNegative, Label("Sq from the fit")]
    points: Annotated[int, Label("Samples")]
    measured_fraction: Annotated[NonNegative, MEASURED]
    not_evaluated: Annotated[tuple[str, ...], UNLISTED] = ()


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
    site_width_um: Annotated[Positive, Label("Width of a site", digits=1)]
    site_height_um: Annotated[Positive, Label("Height of a site", digits=1)]
    rows: Annotated[int, Label("Rows of sites")]
    cols: Annotated[int, Label("Columns of sites")]
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
    smr2_fraction; smr_fraction and smc where the options ask for them. Volume, um3/um2: vmp, vmc, vvc, vvv at material
    ratios of 10 and 80 %; sxp. Spatial: sal, str_ratio, std (across the lay, anticlockwise from +x). Features, of hills
    and dales after Wolf pruning of 5 % of Sz: s5p, s5v, s10z, spd_per_mm2, spc_per_mm. None: not defined for this
    surface; ssk, sku and sal for a flat one, std for one without a lay, s5p for one with fewer than five peaks.
    """

    main_fields: ClassVar[tuple[str, ...]] = ("sa",)
    region: Region
    options: TextureOptions = TextureOptions()
    chain: Annotated[str, Label("Operators", "Operators in their order, each with Sq after it")] = ""
    sa: Annotated[Length, Label("Sa", "Arithmetical mean height", "Height")]
    sq: Annotated[Length, Label("Sq", "Root mean square height", "Height")]
    sp: Annotated[Length, Label("Sp", "Highest peak over the mean", "Height")]
    sv: Annotated[Length, Label("Sv", "Lowest pit under the mean", "Height")]
    sz: Annotated[Length, Label("Sz", "Highest peak over lowest pit", "Height")]
    ssk: Annotated[float | None, Label("Ssk", _SKEWNESS, "Height", signed=True)]
    sku: Annotated[float | None, Label("Sku", _KURTOSIS, "Height")]
    sdq: Annotated[NonNegative | None, Label("Sdq", "Root mean square slope", "Hybrid")] = None
    sdr_fraction: Annotated[NonNegative | None, Label("Sdr", "Area over that of its projection, less 1", "Hybrid")] = (
        None
    )
    sk: Annotated[Length | None, Label("Sk", "Height of the core", "Functional")] = None
    spk: Annotated[Length | None, Label("Spk", "Reduced height of the peaks over the core", "Functional")] = None
    svk: Annotated[Length | None, Label("Svk", "Reduced depth of the valleys under the core", "Functional")] = None
    smr1_fraction: Annotated[Fraction | None, Label("Smr1", "Material ratio where peaks end", "Functional")] = None
    smr2_fraction: Annotated[Fraction | None, Label("Smr2", "Material ratio where valleys begin", "Functional")] = None
    smr_fraction: Annotated[Fraction | None, Label("Smr(c)", "Material ratio at the height c", "Functional")] = None
    smc: Annotated[Length | None, Label("Smc", "Height at a material ratio", "Functional", signed=True)] = None
    vmp: Annotated[Length | None, Label("Vmp", "Material volume of the peaks, up to 10 %, per area", "Volume")] = None
    vmc: Annotated[Length | None, Label("Vmc", "Material volume of the core, 10 to 80 %, per area", "Volume")] = None
    vvc: Annotated[Length | None, Label("Vvc", "Void volume of the core, 10 to 80 %, per area", "Volume")] = None
    vvv: Annotated[Length | None, Label("Vvv", "Void volume of the valleys, from 80 %, per area", "Volume")] = None
    sxp: Annotated[Length | None, Label("Sxp", "Peak extreme height: from 2.5 to 50 %", "Volume")] = None
    sal: Annotated[
        Length | None,
        Label("Sal", "Autocorrelation length: the shortest distance at which heights no longer correlate", "Spatial"),
    ] = None
    str_ratio: Annotated[
        Fraction | None,
        Label("Str", "Texture aspect ratio: near 1 isotropic, near 0 with a lay", "Spatial"),
    ] = None
    std: Annotated[
        Quantity | None, Label("Std", "Texture direction, across the lay, counter-clockwise from x", "Spatial")
    ] = None
    s5p: Annotated[Length | None, Label("S5p", "Mean height of the five highest peaks", "Features")] = None
    s5v: Annotated[Length | None, Label("S5v", "Mean depth of the five deepest pits", "Features")] = None
    s10z: Annotated[Length | None, Label("S10z", "Five highest peaks over five deepest pits", "Features")] = None
    spd_per_mm2: Annotated[NonNegative | None, Label("Spd, 1/mm²", "Peaks per area", "Features", digits=0)] = None
    spc_per_mm: Annotated[float | None, Label("Spc, 1/mm", "Mean curvature of the peaks", "Features", digits=1)] = None
    points: int
    measured_fraction: Annotated[Fraction, MEASURED]


class Roughness(MeasurementResult, frozen=True, kw_only=True, tag="roughness"):
    """ISO 21920-2 parameters along a line.

    ra, rq, rt, rsk, rku, rdq (a slope), rsm, rc, rk, rpk, rvk, rmr1_fraction, rmr2_fraction: over the whole length;
    rp, rv, rz: means over its sections of section_um each. Without a cut-off the profile is the primary profile with
    one section, and the standard names are Pa, Pq, Pt ...
    """

    input_fields: ClassVar[tuple[str, ...]] = ("line",)
    main_fields: ClassVar[tuple[str, ...]] = ("ra",)
    line: Region
    options: RoughnessOptions = RoughnessOptions()
    ra: Annotated[Length, Label("Ra", f"Arithmetical mean height {_WHOLE}", "Evaluation")]
    rq: Annotated[Length, Label("Rq", f"Root mean square height {_WHOLE}", "Evaluation")]
    rz: Annotated[Length, Label("Rz", "Highest over lowest, mean of the sections", "Sections")]
    rt: Annotated[Length, Label("Rt", f"Highest over lowest {_WHOLE}", "Evaluation")]
    rp: Annotated[Length, Label("Rp", "Highest peak, mean of the sections", "Sections")]
    rv: Annotated[Length, Label("Rv", "Lowest pit, mean of the sections", "Sections")]
    rsk: Annotated[float | None, Label("Rsk", _SKEWNESS, "Evaluation", signed=True)]
    rku: Annotated[float | None, Label("Rku", _KURTOSIS, "Evaluation")]
    rdq: Annotated[NonNegative | None, Label("Rdq", f"Root mean square slope {_WHOLE}", "Evaluation")] = None
    rsm: Annotated[Length | None, Label("RSm", f"Mean width of the profile elements {_WHOLE}", "Evaluation")] = None
    rc: Annotated[Length | None, Label("Rc", f"Mean height of the profile elements {_WHOLE}", "Evaluation")] = None
    rk: Annotated[Length | None, Label("Rk", "Height of the core", "Functional")] = None
    rpk: Annotated[Length | None, Label("Rpk", "Reduced height of the peaks over the core", "Functional")] = None
    rvk: Annotated[Length | None, Label("Rvk", "Reduced depth of the valleys under the core", "Functional")] = None
    rmr1_fraction: Annotated[Fraction | None, Label("Rmr1", "Material ratio where peaks end", "Functional")] = None
    rmr2_fraction: Annotated[Fraction | None, Label("Rmr2", "Material ratio where valleys begin", "Functional")] = None
    sections: Annotated[int, Label("Sampling lengths")]
    section_um: Annotated[NonNegative, Label("Sampling length", digits=1)]
    points: int
    measured_fraction: Annotated[Fraction, MEASURED]


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
    angle: Annotated[Quantity, Label("Angle between the edges")]
    kerf: Annotated[Literal["bright", "dark"], Label("Kerf on the picture")]
    first: Region
    second: Region
    points: Annotated[int, Label("Edge points")]

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
    rotation: Annotated[Quantity, Label(signed=True)]
    squareness: Annotated[Quantity, Label("Squareness, angle over 90°", signed=True)]
    center: Annotated[Point, Label("Centre x, y")]
    outline: Region
    die: Annotated[Literal["bright", "dark"], Label("Rim on the picture")]
    points: Annotated[int, Label("Edge points")]

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
    roundness: Annotated[Length, Label("Roundness RONt")]
    center: Annotated[Point, Label("Centre x, y")]
    found: Region
    inside: Annotated[Literal["bright", "dark"], Label("Inside on the picture")]
    points: Annotated[int, Label("Edge points")]

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
    longest: Annotated[Length, Label("Longest chip")]
    area: Annotated[Quantity, Label("Area of the chips")]
    n_chips: Annotated[int, Label("Chips")]
    chips: Annotated[tuple[Chip, ...], UNLISTED] = ()
    limit_um: Annotated[NonNegative, Label("Deeper than")]
    edge_length_um: Annotated[NonNegative, Label("Length of the edge", digits=1)]
    chipped_fraction: Annotated[Fraction, Label("Share of the edge chipped")]
    edge: Region
    die: Annotated[Side, Label("Side of the die")]
    points: Annotated[int, Label("Edge points")]

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
    height_range: Annotated[Length, Label("Range of heights")]
    n_bumps: Annotated[int, Label("Bumps")]
    left_out: Annotated[int, Label("Left out, cut or not measured")]
    tilt_mrad: Annotated[NonNegative, Label("Tilt of the plane")]
    bumps: Annotated[tuple[Bump, ...], UNLISTED] = ()
