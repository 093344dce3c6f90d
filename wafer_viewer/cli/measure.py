"""Commands that measure on a surface.

The signature of a command defines its flags, its docstring is its help.

What is not known of the conditions is left out and then listed as not evaluated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from tyro.conf import OmitArgPrefixes, arg

from wafer_viewer.cli.arguments import (
    Circle,
    File,
    Integers,
    Level,
    Line,
    Numbers,
    OutFile,
    Place,
    Rectangle,
    Source,
    Um,
    levelling_from,
)
from wafer_viewer.cli.output import print_json
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.sections import (
    MOST_LINES,
    OtherSurface,
    Section,
    SectionAsked,
    column_line,
    row_line,
)
from wafer_viewer.model.measurement.tools import (
    STEEL_PER_K,
    ChippingOptions,
    CircleOptions,
    Conditions,
    CoplanarityOptions,
    DieOptions,
    GrooveOptions,
    KerfOptions,
    RoughnessOptions,
    StepDefinition,
    TextureOptions,
    ToolName,
    ToolOptions,
)
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.spec import replace as finding_replace
from wafer_viewer.model.surface.height_map import Mosaic, Outline


def _measure(
    tool: ToolName,
    places: tuple[Region, ...],
    src: Path,
    level: tuple[str, ...],
    field: int,
    result: str,
    options: ToolOptions | None = None,
) -> None:
    """Measure with a tool at its regions and print the result."""
    from wafer_viewer.measure.registry import measured

    surface, calibrated = _surface(src, level, field, result)
    _print(measured(surface, tool, places, calibrated, options), field)


def _surface(src: Path, level: tuple[str, ...], field: int, result: str) -> tuple[Mosaic, bool]:
    """Return the surface levelled as --level says, and whether its calibration holds."""
    from wafer_viewer.measure.base.levelled_surface import levelled
    from wafer_viewer.session.surface.headless import measured_surface

    levelling = levelling_from(level)
    surface, calibrated = measured_surface(src, field, result)
    return levelled(surface, levelling), calibrated


def _print(found: AnyResult, field: int) -> None:
    """Print a result as JSON on standard output."""
    print_json(msgspec.to_builtins(replace(found, show=field)))


def measure_point(src: Source, at: Place, level: Level = (), field: int = 0, result: str = "default") -> None:
    """The height at a point, with its uncertainty, as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        at: Where the point is.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    _measure("point", (Region.point(*at),), src, level, field, result)


def measure_distance(
    src: Source, start: Place, end: Place, level: Level = (), field: int = 0, result: str = "default"
) -> None:
    """The distance between two points: in space, lateral, along z, its slope; with uncertainties, as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        start: Where it begins.
        end: Where it ends.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    _measure("distance", (Region.point(*start), Region.point(*end)), src, level, field, result)


def measure_angle(
    src: Source, first: Rectangle, second: Rectangle, level: Level = (), field: int = 0, result: str = "default"
) -> None:
    """The angle between two faces, with its uncertainty, as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        first: Two opposite corners of a rectangle on the one face.
        second: The same on the other.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    _measure("angle", (Region.rectangle(*first), Region.rectangle(*second)), src, level, field, result)


def measure_radius(src: Source, circle: Circle, level: Level = (), field: int = 0, result: str = "default") -> None:
    """The radius of a bump or pit and the height of its top, with uncertainties, as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        circle: Centre and radius of a circle round it.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    _measure("radius", (Region.circle(*circle),), src, level, field, result)


def measure_volume(
    src: Source,
    region: Rectangle,
    reference: Literal["border", "zero"] | None = None,
    level: Level = (),
    field: int = 0,
    result: str = "default",
) -> None:
    """Area and volume over and under a plane, with uncertainties, as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        region: Two opposite corners of a rectangle.
        reference: The plane through the rectangle's border, or the zero of --level; that of --level where it is given.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    from wafer_viewer.measure.tools.volume import area_volume

    surface, calibrated = _surface(src, level, field, result)
    place = Region.rectangle(*region)
    _print(area_volume(surface, place, reference=reference, calibration_valid=calibrated), field)


def measure_flatness(
    src: Source, region: Rectangle, level: Level = (), field: int = 0, result: str = "default"
) -> None:
    """Flatness of a face, FLTt and FLTq of ISO 12781, as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        region: Two opposite corners of a rectangle.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    _measure("flatness", (Region.rectangle(*region),), src, level, field, result)


def measure_texture(
    src: Source,
    region: Rectangle,
    form_order: int = 1,
    s_filter_um: Um = None,
    l_filter_um: Um = None,
    level: Level = (),
    field: int = 0,
    result: str = "default",
) -> None:
    """Texture of a face, the parameters of ISO 25178 of what form and filters leave, as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        region: Two opposite corners of a rectangle.
        form_order: Order of the polynomial that is removed as form; 0 the mean alone, 1 a plane.
        s_filter_um: Nesting index of the Gaussian filter that removes shorter wavelengths; none by default.
        l_filter_um: Nesting index of the Gaussian filter that removes longer wavelengths; none by default.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    own = TextureOptions(form_order=form_order, s_filter_um=s_filter_um, l_filter_um=l_filter_um)
    _measure("texture", (Region.rectangle(*region),), src, level, field, result, ToolOptions(texture=own))


def measure_roughness(
    src: Source,
    line: Line,
    width_um: float = 0.0,
    lambda_c_um: Um = None,
    lambda_s_um: Um = None,
    level: Level = (),
    field: int = 0,
    result: str = "default",
) -> None:
    """Roughness along a line, the parameters of ISO 21920 of what the filters leave, as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        line: The two ends of the line.
        width_um: Width across the line that is averaged over.
        lambda_c_um: Cut-off of the Gaussian filter against longer wavelengths, the sampling length; none by default.
        lambda_s_um: Cut-off of the Gaussian filter that removes shorter wavelengths; none by default.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    own = RoughnessOptions(lambda_c_um=lambda_c_um, lambda_s_um=lambda_s_um)
    place = Region.line(*line, width_um=width_um)
    _measure("roughness", (place,), src, level, field, result, ToolOptions(roughness=own))


def measure_site_range(
    src: Source,
    site: Annotated[tuple[float, float], arg(metavar="WIDTH HEIGHT")],
    region: Annotated[tuple[float, float, float, float] | None, arg(metavar="X0 Y0 X1 Y1")] = None,
    level: Level = (),
    field: int = 0,
    result: str = "default",
) -> None:
    """Front-surface site range, as mounted: the range of heights in each site about its own plane, as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        site: Width and height of a site.
        region: Two opposite corners of what the sites are laid into; the whole surface by default.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    from wafer_viewer.measure.tools.site_range import site_ranges

    surface, calibrated = _surface(src, level, field, result)
    within = Region.rectangle(*region) if region is not None else None
    print_json(msgspec.to_builtins(site_ranges(surface, site, within, calibration_valid=calibrated)))


def measure_profile(
    src: Source,
    line: Numbers = (),
    row: Integers = (),
    column: Integers = (),
    width_um: float = 0.0,
    level: Level = (),
    cleaned: bool = False,
    other: File = None,
    field: int = 0,
    result: str = "default",
    points: bool = False,
    out: OutFile = None,
) -> None:
    """Sections along lines, rows and columns, four at most, as JSON; a list of them where there are several. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        line: The two ends of a line; eight numbers are two lines.
        row: Rows by number, from edge to edge; 0 is the top one.
        column: Columns by number; 0 is the left one.
        width_um: Width across a line that is averaged over.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        cleaned: For each line also the other of measured and filtered heights.
        other: For each line also the same on the stitched surface of this other dataset.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
        points: Also print the points of each section.
        out: Also write all curves to this file, .csv a table, .png a picture at print size.
    """
    from wafer_viewer.session.measurement.sections import require_known, write_sections

    if out is not None:
        require_known(out.suffix)
    surface, calibrated = _opened(src, field, result)
    lines = _lines(surface, line, row, column, width_um)
    levelling = levelling_from(level)
    asked = [SectionAsked(place, at, field, levelling) for place, at in enumerate(lines)]
    source = src.stem if field == 0 else f"{src.stem}, field {field}"
    sections = _cut(asked, surface, calibrated, source)
    if cleaned:
        sections += _cut([replace(one, cleaned=True) for one in asked], surface, calibrated, source)
    if other is not None:
        beside = OtherSurface(str(other), "default")
        sections += _cut([replace(one, show=0, of=beside) for one in asked], *_opened(other, 0, "default"), other.stem)
    if out is not None:
        write_sections(sections, out)
    facts = [_facts(section, points) for section in sections]
    print_json(facts if len(facts) > 1 else facts[0])


def _opened(src: Path, field: int, result: str) -> tuple[Mosaic, bool]:
    from wafer_viewer.session.surface.headless import measured_surface

    return measured_surface(src, field, result)


def _lines(surface: Outline, ends: Numbers, rows: Integers, columns: Integers, width_um: float) -> list[Region]:
    """Return the requested lines: lines first, then rows, then columns. Raises MeasureError for none or too many."""
    if len(ends) % 4:
        raise MeasureError(f"--line has {len(ends)} numbers: give X0 Y0 X1 Y1 for each line.")
    lines = [
        *(Region.line(*ends[k : k + 4], width_um=width_um) for k in range(0, len(ends), 4)),
        *(row_line(surface, row, width_um) for row in rows),
        *(column_line(surface, column, width_um) for column in columns),
    ]
    if not 1 <= len(lines) <= MOST_LINES:
        raise MeasureError(f"{len(lines)} lines are asked for: give 1 to {MOST_LINES} with --line, --row and --column.")
    return lines


def _cut(asked: Sequence[SectionAsked], surface: Mosaic, calibrated: bool, source: str) -> list[Section]:
    """Return the sections along all lines, with their common levelling."""
    from wafer_viewer.measure.base.levelled_surface import levelled
    from wafer_viewer.session.measurement.sections import cut

    from_zero = levelled(surface, asked[0].levelling)
    return [cut(one, from_zero, calibrated, source) for one in asked]


def _facts(section: Section, points: bool) -> dict[str, Any]:
    """Return the numbers of a section and its source."""
    found = finding_replace(section.profile, levelling=section.asked.levelling, show=section.asked.show)
    facts: dict[str, Any] = {"curve": section.title, "source": section.source, **msgspec.to_builtins(found)}
    if points:
        curve = section.curve
        facts["points"] = {"distance_um": curve.distance_um.tolist(), "z_um": curve.z_um.tolist()}
    return facts


Brightness = Literal["either", "bright", "dark"]


def measure_kerf(
    src: Source, region: Rectangle, kerf: Brightness = "either", field: int = 0, result: str = "default"
) -> None:
    """The width of a kerf on the picture: mean, narrowest, widest, angle of its edges; with uncertainties, as JSON.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        region: Two opposite corners of a rectangle across the kerf, stage um.
        kerf: Whether it is brighter or darker than the ground beside it.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    options = ToolOptions(kerf=KerfOptions(kerf=kerf))
    _measure("kerf", (Region.rectangle(*region),), src, (), field, result, options)


def measure_die(
    src: Source, region: Rectangle, die: Brightness = "either", field: int = 0, result: str = "default"
) -> None:
    """The size of a die on the picture, its centre, how it is turned and how square it is; with uncertainties, as JSON.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        region: Two opposite corners of a rectangle round the die, stage um.
        die: Whether its rim is brighter or darker than its surroundings.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    options = ToolOptions(die=DieOptions(die=die))
    _measure("die", (Region.rectangle(*region),), src, (), field, result, options)


def measure_circle(
    src: Source, circle: Circle, inside: Brightness = "either", field: int = 0, result: str = "default"
) -> None:
    """The diameter of something round on the picture, its centre and roundness; with uncertainties, as JSON.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        circle: Centre and radius of a circle drawn round it, stage um.
        inside: Whether the picture is brighter or darker inside of the edge.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    options = ToolOptions(circle=CircleOptions(inside=inside))
    _measure("circle", (Region.circle(*circle),), src, (), field, result, options)


def measure_chipping(
    src: Source,
    region: Rectangle,
    limit_um: float | None = None,
    die: Literal["auto", "bright", "dark"] = "auto",
    field: int = 0,
    result: str = "default",
) -> None:
    """Depth, length and area of the chips along an edge of a die on the picture; with uncertainties, as JSON.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        region: Two opposite corners of a rectangle over one edge, stage um.
        limit_um: What is deeper is a chip; by default four robust deviations of the edge, two pixels at least.
        die: The side of the edge that the die lies on; auto takes the higher one.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    options = ToolOptions(chipping=ChippingOptions(limit_um=limit_um, die=die))
    _measure("chipping", (Region.rectangle(*region),), src, (), field, result, options)


def measure_coplanarity(
    src: Source,
    region: Rectangle,
    reference: Literal["least_squares", "seating"] = "least_squares",
    level: Level = (),
    field: int = 0,
    result: str = "default",
) -> None:
    """Coplanarity of the bumps in a region (JESD22-B108), place and height of each; with uncertainties, as JSON.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        region: Two opposite corners of a rectangle over the bumps, stage um.
        reference: The plane of least squares through all tops, or the seating plane.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    options = ToolOptions(coplanarity=CoplanarityOptions(reference=reference))
    _measure("coplanarity", (Region.rectangle(*region),), src, level, field, result, options)


Rectangles = Annotated[tuple[tuple[float, float, float, float], ...], arg(metavar="X0 Y0 X1 Y1 ...")]
Known = Annotated[float | None, arg(metavar="UM")]


@dataclass(frozen=True, slots=True)
class Given:
    """Known conditions of the measurement; standard uncertainties, k = 1.

    Args:
        repeatability_um: Standard deviation of the height over repeat scans.
        drift_um: Of z between the two faces while they were scanned.
        z_linearity_um: Of the z axis over the step, beside its scale.
        abbe_um: From the pitch of the stage times the offset from the line of its scale.
        temperature_c: Of the sample.
        u_temperature_c: Of its temperature.
        expansion_per_k: Of its material, relative; that of steel by default.
    """

    repeatability_um: Known = None
    drift_um: Known = None
    z_linearity_um: Known = None
    abbe_um: Known = None
    temperature_c: Annotated[float | None, arg(metavar="C")] = None
    u_temperature_c: float = 0.5
    expansion_per_k: float = STEEL_PER_K

    @property
    def conditions(self) -> Conditions:
        """Conditions of the measurement."""
        return Conditions(**{name: getattr(self, name) for name in Conditions.__struct_fields__})


def measure_step(
    src: Source,
    upper: Rectangles = (),
    lower: Rectangles = (),
    faces: Literal["auto"] | None = None,
    definition: StepDefinition = "common_plane",
    given: OmitArgPrefixes[Given] = Given(),
    level: Level = (),
    field: int = 0,
    result: str = "default",
) -> None:
    """The height of one face over another, with its uncertainty and what is not in it, as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        upper: Two opposite corners of the upper rectangle, or of several on one face.
        lower: The same of the lower face.
        faces: auto looks for the two faces of a pair of gauge blocks, as it does without rectangles.
        definition: Where h is taken: in the middles of the regions over a plane that both faces have in common, or
            over that of the upper or the lower one; or at the joint, both faces extended.
        given: What is known of how it was measured.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    from wafer_viewer.measure.tools.step_height import step_height

    _require_one_way(bool(upper), bool(lower), faces)
    surface, calibrated = _surface(src, level, field, result)
    high, low, notes = _faces(surface, upper, lower)
    found = step_height(
        surface, high, low, definition=definition, conditions=given.conditions, calibration_valid=calibrated
    )
    _print(replace(found, notes=(*notes, *found.notes)), field)


def measure_groove(
    src: Source,
    line: Line,
    width_um: float = 0.0,
    shape: Literal["groove", "step"] = "groove",
    given: OmitArgPrefixes[Given] = Given(),
    level: Level = (),
    field: int = 0,
    result: str = "default",
) -> None:
    """The depth of a groove, the height of a ridge or of a single step that a line crosses (ISO 5436-1), as JSON.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        line: Both ends; it reaches beyond each edge as far as the groove is wide.
        width_um: How wide a strip across the line is averaged over; 0: a pixel.
        shape: What it crosses: two edges or one.
        given: What is known of how it was measured.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    options = ToolOptions(groove=GrooveOptions(shape=shape, conditions=given.conditions))
    _measure("groove", (Region.line(*line, width_um),), src, level, field, result, options)


def _require_one_way(upper: bool, lower: bool, faces: str | None) -> None:
    if upper != lower:
        given, missing = ("--upper", "--lower") if upper else ("--lower", "--upper")
        raise MeasureError(f"{given} is given and {missing} is not: give both, or neither to have the faces found.")
    if upper and faces == "auto":
        raise MeasureError("--faces auto looks for the faces that --upper and --lower give: leave one of them out.")


def _faces(
    surface: Mosaic, upper: tuple[tuple[float, ...], ...], lower: tuple[tuple[float, ...], ...]
) -> tuple[tuple[Region, ...], tuple[Region, ...], tuple[str, ...]]:
    """Return the regions of the upper and lower face, and notes on how they were found."""
    if upper:
        high, low = (tuple(Region.rectangle(*corners) for corners in each) for each in (upper, lower))
        return high, low, ()
    from wafer_viewer.measure.gauge.find_faces import find_faces

    found = find_faces(surface)
    return (found.upper,), (found.lower,), ("The faces were found automatically.", *found.notes)
