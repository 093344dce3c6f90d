"""Command that cuts a surface along lines, rows and columns: numbers as JSON, curves as a table or picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec

from wafer_viewer.cli.arguments import File, Integers, Level, Numbers, OutFile, Source, levelling_from
from wafer_viewer.cli.output import print_json
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.section_lines import MOST_LINES, column_line, row_line
from wafer_viewer.model.measurement.sections import OtherSurface, Section, SectionAsked
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace as finding_replace
from wafer_viewer.model.surface.height_map import Mosaic, Outline


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
    from wafer_viewer.session.measurement.section_export import require_known, write_sections

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
    from wafer_viewer.session.measurement.section_export import cut

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
