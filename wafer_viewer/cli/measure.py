"""Commands that measure on a surface.

The signature of a command defines its flags, its docstring is its help.

What is not known of the conditions is left out and then listed as not evaluated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

import msgspec
from tyro.conf import OmitArgPrefixes, arg

from wafer_viewer.cli.arguments import (
    Circle,
    Corners,
    DatasetFolder,
    File,
    Flag,
    Integers,
    Level,
    Line,
    Numbers,
    OutFile,
    Place,
    Rectangle,
    Rectangles,
    Source,
    levelling_from,
    outlined,
    with_flags,
)
from wafer_viewer.cli.output import print_json, progress, to_program
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.measuring_tool import MeasuringTool, PlaceAsked, ToolName
from wafer_viewer.model.measurement.sections import (
    MOST_LINES,
    OtherSurface,
    Section,
    SectionRequest,
    column_line,
    row_line,
)
from wafer_viewer.model.measurement.tool_options import STEEL_PER_K, Conditions, GrooveOptions, StepDefinition
from wafer_viewer.model.measurement.tools import ToolOptions
from wafer_viewer.model.region import Region, RegionKind
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Mosaic, Outline


def _measure(
    tool: ToolName,
    places: tuple[Region, ...],
    src: Path,
    level: tuple[str, ...],
    field: int,
    result: str,
    json: bool,
    options: ToolOptions | None = None,
) -> None:
    """Measure with a tool at its regions and print the result."""
    from wafer_viewer.measure.registry import measured

    surface, calibrated = _surface(src, level, field, result)
    _print(measured(surface, tool, places, calibrated, options), field, json)


def _surface(src: Path, level: tuple[str, ...], field: int, result: str) -> tuple[Mosaic, bool]:
    """Return the surface levelled as --level says, and whether its calibration holds."""
    from wafer_viewer.measure.base.levelled_surface import levelled
    from wafer_viewer.session.surface.headless import measured_surface

    levelling = levelling_from(level)
    surface, calibrated = measured_surface(src, field, result)
    return levelled(surface, levelling), calibrated


def tool_command(tool: MeasuringTool) -> Callable[..., None]:
    """Return the command of a tool, whose flags are its regions and options."""

    def run(src: Path, field: int, result: str, json: bool, level: tuple[str, ...] = (), **given: Any) -> None:
        widths = {"width_um": given.pop("width_um")} if "width_um" in given else {}
        masked = tuple(Region.rectangle(*corners) for corners in given.pop(EXCLUDE, ()))
        places = tuple(_region(place, given.pop(place.flag), widths, masked, tool) for place in tool.places)
        options = ToolOptions(**{tool.name: tool.options(**given)}) if tool.options is not None else None
        _measure(tool.name, places, src, level, field, result, json, options)

    flags = [Flag("src", Source, "A NAME.wafer or a surface file, such as .x3p."), *_region_flags(tool)]
    flags += _option_flags(tool)
    if not tool.on_picture:
        flags.append(Flag("level", Level, _LEVEL_HELP, ()))
    flags.append(Flag("field", int, "A field of the dataset; 0 is the stitched surface.", 0))
    flags.append(Flag("result", str, "Name of the reconstruction.", "default"))
    flags.append(Flag("json", bool, "Print JSON to a terminal too, as into a pipe or a file.", False))
    return with_flags(run, tool.help, flags)


def _region_flags(tool: MeasuringTool) -> list[Flag]:
    """Return a flag for each region, and one for the width of a line."""
    flags = [Flag(place.flag, _region_type(place, tool), place.help) for place in tool.places]
    if _takes_outlines(tool):
        flags.append(Flag(EXCLUDE, Rectangles, _EXCLUDE_HELP, ()))
    if any(place.kind == "line" for place in tool.places):
        flags.append(Flag("width_um", float, "How wide a strip across the line is averaged over; 0: a pixel.", 0.0))
    return flags


def _option_flags(tool: MeasuringTool) -> list[Flag]:
    """Return a flag for each option of a tool."""
    if tool.options is None:
        return []
    helps = {control.field: control.help or control.hint for control in tool.controls}
    hints, default = get_type_hints(tool.options), tool.options()
    names = tool.options.__struct_fields__
    return [Flag(name, hints[name], helps.get(name, ""), getattr(default, name)) for name in names]


EXCLUDE = "exclude"
_EXCLUDE_HELP = (
    "Rectangles that are left out: two opposite corners of each. Six numbers or more of a region: a polygon."
)


def _takes_outlines(tool: MeasuringTool) -> bool:
    """Return whether the regions of a tool may be polygons with parts left out."""
    return not tool.on_picture and any(place.kind == "rectangle" for place in tool.places)


def _region_type(place: PlaceAsked, tool: MeasuringTool) -> Any:
    return Corners if place.kind == "rectangle" and _takes_outlines(tool) else _REGION_TYPES[place.kind]


def _region(
    place: PlaceAsked,
    numbers: Sequence[float],
    widths: dict[str, float],
    masked: tuple[Region, ...],
    tool: MeasuringTool,
) -> Region:
    """Return the region of a flag, without the masked ones if it has an area."""
    if place.kind == "rectangle" and _takes_outlines(tool):
        return outlined(*numbers).without(*masked)
    return _REGIONS[place.kind](*numbers, **(widths if place.kind == "line" else {}))


_REGIONS: dict[RegionKind, Callable[..., Region]] = {
    "point": Region.point,
    "line": Region.line,
    "rectangle": Region.rectangle,
    "circle": Region.circle,
}
_REGION_TYPES: dict[RegionKind, Any] = {"point": Place, "line": Line, "rectangle": Rectangle, "circle": Circle}
_LEVEL_HELP = "Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default."


def _print(found: AnyResult, field: int, json: bool) -> None:
    """Print a result: a few lines to a person at a terminal, JSON into a pipe or a file, and where it is asked for."""
    if to_program(json):
        print_json(msgspec.to_builtins(replace(found, show=field)))
        return
    print(found)
    if missing := getattr(found, "not_evaluated", ()):
        print(f"  not in U: {'; '.join(missing)}")
    for note in found.notes:
        print(f"  {note}")


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
    with progress("Measuring the sites") as tell:
        found = site_ranges(surface, site, within, calibration_valid=calibrated, progress=tell)
    print_json(msgspec.to_builtins(found))


def measure_profile(
    src: Source,
    line: Numbers = (),
    polyline: Numbers = (),
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
    """Sections along lines, a polyline, rows and columns, four at most, as JSON; several are a list. Stage um.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        line: The two ends of a line; eight numbers are two lines.
        polyline: The points of a path, in order; distances along it are arc lengths.
        row: Rows by number, from edge to edge; 0 is the top one.
        column: Columns by number; 0 is the left one.
        width_um: Width across a line that is averaged over.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        cleaned: For each line also the other of measured and filtered heights.
        other: For each line also the same on the stitched surface of this other dataset.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
        points: Also print the points of each section.
        out: Also write all curves to this file, .csv a table, .png, .pdf or .svg a figure for print.
    """
    from wafer_viewer.session.measurement.dataset_queries import require_section_format, write_sections

    if out is not None:
        require_section_format(out.suffix)
    surface, calibrated = _opened(src, field, result)
    lines = _lines(surface, line, polyline, row, column, width_um)
    levelling = levelling_from(level)
    requests = [SectionRequest(place, at, field, levelling) for place, at in enumerate(lines)]
    source = src.stem if field == 0 else f"{src.stem}, field {field}"
    sections = _cut(requests, surface, calibrated, source)
    if cleaned:
        sections += _cut([replace(one, cleaned=True) for one in requests], surface, calibrated, source)
    if other is not None:
        other_surface = OtherSurface(str(other), "default")
        sections += _cut(
            [replace(one, show=0, of=other_surface) for one in requests], *_opened(other, 0, "default"), other.stem
        )
    if out is not None:
        write_sections(sections, out)
    facts = [_facts(section, points) for section in sections]
    print_json(facts if len(facts) > 1 else facts[0])


def _opened(src: Path, field: int, result: str) -> tuple[Mosaic, bool]:
    from wafer_viewer.session.surface.headless import measured_surface

    return measured_surface(src, field, result)


def _lines(
    surface: Outline, ends: Numbers, path: Numbers, rows: Integers, columns: Integers, width_um: float
) -> list[Region]:
    """Return lines, then the polyline, rows and columns. Raises MeasureError for none or too many."""
    if len(ends) % 4:
        raise MeasureError(f"--line has {len(ends)} numbers: give X0 Y0 X1 Y1 for each line.")
    if len(path) % 2 or len(path) == 2:
        raise MeasureError(f"--polyline has {len(path)} numbers: give X Y of each of its points, at least two.")
    points = list(zip(path[::2], path[1::2], strict=True))
    lines = [
        *(Region.line(*ends[k : k + 4], width_um=width_um) for k in range(0, len(ends), 4)),
        *([Region.polyline(*points, width_um=width_um)] if points else []),
        *(row_line(surface, row, width_um) for row in rows),
        *(column_line(surface, column, width_um) for column in columns),
    ]
    if not 1 <= len(lines) <= MOST_LINES:
        raise MeasureError(
            f"{len(lines)} lines are asked for: give 1 to {MOST_LINES} with --line, --polyline, --row and --column."
        )
    return lines


def _cut(requests: Sequence[SectionRequest], surface: Mosaic, calibrated: bool, source: str) -> list[Section]:
    """Return the sections along all lines, with their common levelling."""
    from wafer_viewer.measure.base.levelled_surface import levelled
    from wafer_viewer.session.measurement.dataset_queries import cut

    from_zero = levelled(surface, requests[0].levelling)
    return [cut(one, from_zero, calibrated, source) for one in requests]


def _facts(section: Section, points: bool) -> dict[str, Any]:
    """Return the numbers of a section and its source."""
    profile = replace(section.profile, levelling=section.asked.levelling, show=section.asked.show)
    facts: dict[str, Any] = {"curve": section.title, "source": section.source, **msgspec.to_builtins(profile)}
    if points:
        curve = section.curve
        facts["points"] = {"distance_um": curve.distance_um.tolist(), "z_um": curve.z_um.tolist()}
    return facts


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
    json: bool = False,
) -> None:
    """The height of one face over another, with its uncertainty and what is not in it. Stage um.

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
        json: Print JSON to a terminal too, as into a pipe or a file.
    """
    from wafer_viewer.measure.tools.step_height import step_height

    _require_one_way(bool(upper), bool(lower), faces)
    surface, calibrated = _surface(src, level, field, result)
    high, low, notes = _faces(surface, upper, lower)
    found = step_height(
        surface, high, low, definition=definition, conditions=given.conditions, calibration_valid=calibrated
    )
    _print(replace(found, notes=(*notes, *found.notes)), field, json)


def measure_groove(
    src: Source,
    line: Line,
    width_um: float = 0.0,
    shape: Literal["groove", "step"] = "groove",
    given: OmitArgPrefixes[Given] = Given(),
    level: Level = (),
    field: int = 0,
    result: str = "default",
    json: bool = False,
) -> None:
    """The depth of a groove, the height of a ridge or of a single step that a line crosses (ISO 5436-1).

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        line: Both ends; it reaches beyond each edge as far as the groove is wide.
        width_um: How wide a strip across the line is averaged over; 0: a pixel.
        shape: What it crosses: two edges or one.
        given: What is known of how it was measured.
        level: Heights over: plane, form [ORDER], region X0 Y0 X1 Y1, points X Y X Y X Y. The stage's zero by default.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
        json: Print JSON to a terminal too, as into a pipe or a file.
    """
    options = ToolOptions(groove=GrooveOptions(shape=shape, conditions=given.conditions))
    _measure("groove", (Region.line(*line, width_um),), src, level, field, result, json, options)


def measure_difference(
    dataset: DatasetFolder,
    first: Annotated[int, arg(metavar="N")],
    second: Annotated[int, arg(metavar="N")],
    other: Annotated[Path | None, arg(metavar="NAME.wafer")] = None,
    quantity: str = "",
    result: str = "default",
    json: bool = False,
) -> None:
    """The first of two kept results less the second one; sources of uncertainty that both have count once.

    Args:
        dataset: The dataset with the results.
        first: Number of the first result.
        second: Number of the second result.
        other: Another dataset with the second result, scanned with the same calibration.
        quantity: A quantity of both, such as sq; the main one of each by default.
        result: Name of the reconstruction.
        json: Print JSON to a terminal too, as into a pipe or a file.
    """
    from wafer_viewer.measure.difference import difference

    found = difference(
        _kept(dataset, result, first),
        _kept(other or dataset, result, second),
        quantity=quantity,
        same_surface=other is None,
    )
    if to_program(json):
        print_json(found.to_dict())
    else:
        print(f"{found} ({found.k_text})" if found.expanded is not None else f"{found} ({found.status})")


def _kept(folder: Path, result: str, number: int) -> AnyResult:
    """Return a result that was kept by its number."""
    from wafer_viewer.store.dataset.dataset import Dataset

    findings = Dataset.open(folder).result(result).findings().items
    for finding in findings:
        if finding.number == number:
            return finding
    known = ", ".join(f"{finding.number}" for finding in findings) or "none"
    raise MeasureError(f"{folder.name} has no result {number} among those of {result}: it has {known}.")


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
