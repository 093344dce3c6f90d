"""Tables for spreadsheets: results, defects, profiles and studies, each number with its unit."""

from __future__ import annotations

import csv
import io
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from itertools import zip_longest
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import MeasureError, detail, parser_errors_as
from wafer_viewer.model.findings import AnyResult, MeasurementResults
from wafer_viewer.model.inspection.defect import Defect, Inspection
from wafer_viewer.model.inspection.die_grid import DieStatus
from wafer_viewer.model.inspection.lot import StatisticsRow
from wafer_viewer.model.measurement.measurements import Bump, Chip
from wafer_viewer.model.measurement.particles import Particle
from wafer_viewer.model.measurement.result_rows import Row, rows
from wafer_viewer.model.measurement.sections import Section
from wafer_viewer.model.quantity import Quantity
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import Spec
from wafer_viewer.model.surface.height_map import LAYER_TITLES
from wafer_viewer.store.io.guarded_reading import read_content

RESULT_COLUMNS = (
    *("number", "name", "kind", "quantity", "value", "U", "unit", "k", "status"),
    *("x_um", "y_um", "surface", "filter", "levelled by", "show", "simulated"),
)
_FORMULA = re.compile(r"\s*([=@]|[+-](?![-+0-9.,eE ]*$))")
"""Begin of a text that spreadsheets run as a formula; the names of dies, as -1,0, are none."""


class TableWriter:
    """Writer of lines of cells; a text that a spreadsheet would run as a formula gets an apostrophe before it."""

    def __init__(self, file: io.StringIO) -> None:
        self._lines = csv.writer(file, lineterminator="\n")

    def writerow(self, cells: Iterable[object]) -> None:
        """Write a line."""
        self._lines.writerow([_harmless(cell) for cell in cells])

    def writerows(self, rows: Iterable[Iterable[object]]) -> None:
        """Write several lines."""
        for row in rows:
            self.writerow(row)


def _harmless(cell: object) -> object:
    if not isinstance(cell, str):
        return cell
    text = cell.replace("\r", " ")  # csv of Python before 3.13 does not quote it, and a spreadsheet begins a line there
    return f"'{text}" if _FORMULA.match(text) else text


def without_apostrophe(text: str) -> str:
    """Return a text as it was before it was made harmless for spreadsheets."""
    return text[1:] if text.startswith("'") and _FORMULA.match(text[1:]) else text


def findings_csv(findings: MeasurementResults) -> str:
    """Return the table; U is expanded (95 %). x_um, y_um: centre of the first region; show 0: entire surface."""
    text = io.StringIO()
    table = TableWriter(text)
    table.writerow(RESULT_COLUMNS)
    for finding in findings.items:
        main = finding.main_field
        lines = [
            (row, row.name, _place(finding)) for row in sorted(_numbers(finding), key=lambda row: row.field != main)
        ]
        for row, name, place in (*lines, *_parts(finding)):
            cells = _identity_cells(finding), _cells(row, name), place, _processing_cells(finding)
            table.writerow([cell for some in cells for cell in some])
    return text.getvalue()


def _numbers(part: Spec) -> list[Row]:
    return [row for row in rows(part) if isinstance(row.value, Quantity | int | float)]


def _parts(finding: AnyResult) -> Iterator[tuple[Row, str, list[str]]]:
    """Yield the numbers of each chip, bump or particle of a result, with its name and position."""
    for kind, field in (("chip", "chips"), ("bump", "bumps"), ("particle", "particles")):
        found: tuple[Chip | Bump | Particle, ...] = getattr(finding, field, ())
        for k, part in enumerate(found, 1):
            place = [f"{part.place.x_um:.2f}", f"{part.place.y_um:.2f}"]
            yield from ((row, f"{kind} {k} {row.name}", place) for row in _numbers(part))


def _identity_cells(finding: AnyResult) -> list[object]:
    return [finding.number, finding.name, finding.__struct_config__.tag]


def _cells(row: Row, name: str) -> list[object]:
    if not isinstance(row.value, Quantity):
        return [name, f"{row.value:.6g}", "", row.unit or "1", "", ""]
    value, expanded = row.value, row.value.expanded
    u, k = ("", "") if expanded is None else (f"{expanded:.2g}", f"{value.k:.3g}")
    return [name, f"{value.value:.6g}", u, value.unit, k, value.status]


def _place(finding: AnyResult) -> list[str]:
    places = (getattr(finding, name) for name in finding.__struct_fields__)
    bounds = next((place.bounds_um for place in places if isinstance(place, Region)), None)
    if bounds is None:
        return ["", ""]
    return [f"{(bounds[0] + bounds[2]) / 2:.2f}", f"{(bounds[1] + bounds[3]) / 2:.2f}"]


def _processing_cells(finding: AnyResult) -> list[object]:
    simulated = "SIMULATED" if finding.simulated else ""
    return [finding.surface, finding.filter, finding.levelling.by, finding.show, simulated]


DEFECT_COLUMNS = (
    *("number", "die", "u_um", "v_um", "x_um", "y_um", "class", "class by rules", "reasons", "judgement", "judged by"),
    *("judged at", "note", "height_um", "U height_um", "major_um", "U major_um", "minor_um", "U minor_um", "angle_deg"),
    *("area_um2", "U area_um2", "volume_um3", "score", "confidence", "scale_px", "evidence", "size resolved"),
    *("repeats", "simulated"),
)


def defects_csv(inspection: Inspection) -> str:
    """Return the table; U is expanded (95 %), empty if not evaluated.

    x_um, y_um are stage coordinates; u_um, v_um are relative to the lower left corner of the die. Heights are empty for
    unmeasured areas, lateral sizes where they are not resolved.
    """
    text = io.StringIO()
    table = TableWriter(text)
    table.writerow(DEFECT_COLUMNS)
    table.writerows(_row(defect) for defect in inspection.defects)
    return text.getvalue()


DIE_COLUMNS = (
    *("die", "column", "row", "state", "measured", "defects", "tilt_x_mrad", "U tilt_x_mrad", "tilt_y_mrad"),
    *("U tilt_y_mrad", "offset_um", "U offset_um", "bow_um", "U bow_um", "brightness_percent", "u brightness_percent"),
    "simulated",
)


def dies_csv(inspection: Inspection) -> str:
    """Return the table of the dies; U is expanded (95 %), u standard (k = 1), empty if not evaluated."""
    text = io.StringIO()
    table = TableWriter(text)
    table.writerow(DIE_COLUMNS)
    simulated = "SIMULATED" if inspection.simulated else ""
    table.writerows([*_die_cells(die), simulated] for die in inspection.dies)
    return text.getvalue()


STATISTICS_COLUMNS = ("table", "item", "quantity", "value", "low", "high", "unit", "remark")


def statistics_csv(rows: Iterable[StatisticsRow]) -> str:
    """Return the table of a lot; low and high are confidence or control limits, empty where there are none."""
    text = io.StringIO()
    table = TableWriter(text)
    table.writerow(STATISTICS_COLUMNS)
    for row in rows:
        numbers = ("" if number is None else f"{number:.8g}" for number in (row.value, row.low, row.high))
        table.writerow([row.table, row.item, row.quantity, *numbers, row.unit, row.remark])
    return text.getvalue()


def _die_cells(die: DieStatus) -> list[object]:
    defects = "" if die.defects is None else die.defects
    cells: list[object] = [die.name, die.col, die.row, die.state, f"{die.measured_fraction:.3f}", defects]
    if (at := die.measured) is None:
        return [*cells, *[""] * 10]
    pairs = (_pair(number) for number in (at.tilt_x, at.tilt_y, at.offset.quantity, at.bow.quantity))
    shine = f"{100 * at.brightness_fraction:.4g}", f"{100 * at.u_brightness_fraction:.2g}"
    return [*cells, *(cell for pair in pairs for cell in pair), *shine]


def _row(defect: Defect) -> list[object]:
    return [*_position(defect), *_review_cells(defect), *_sizes(defect), *_quality_cells(defect)]


def _position(defect: Defect) -> list[object]:
    at = defect.in_die
    in_die = [f"{at.x_um:.3f}", f"{at.y_um:.3f}"] if at is not None else ["", ""]
    return [defect.number, defect.die, *in_die, f"{defect.center.x_um:.3f}", f"{defect.center.y_um:.3f}"]


def _review_cells(defect: Defect) -> list[object]:
    reasons = "; ".join(defect.reasons)
    by = (defect.judgement, defect.judged_by, defect.judged_at, defect.note)
    return [defect.seen_as, defect.kind, reasons, *by]


def _sizes(defect: Defect) -> list[str]:
    measured, resolved = defect.kind != "unmeasured", defect.size_resolved
    height = _pair(defect.height.quantity) if measured else ["", ""]
    lengths = [*_pair(defect.major.quantity), *_pair(defect.minor.quantity)] if resolved else [""] * 4
    angle = [f"{defect.angle_deg:.1f}"] if resolved else [""]
    area = _pair(defect.area) if resolved else ["", ""]
    return [*height, *lengths, *angle, *area, f"{defect.volume.value:.6g}" if measured else ""]


def _pair(quantity: Quantity) -> list[str]:
    return [f"{quantity.value:.6g}", "" if quantity.expanded is None else f"{quantity.expanded:.2g}"]


def _quality_cells(defect: Defect) -> list[object]:
    yes = {True: "yes", False: "no"}
    return [
        f"{defect.score:.2f}",
        f"{defect.confidence:.2f}",
        f"{defect.scale_px:g}",
        defect.evidence,
        yes[defect.size_resolved],
        yes[defect.repeats],
        "SIMULATED" if defect.simulated else "",
    ]


PROFILE_COLUMNS = ("distance_um", "x_um", "y_um", "z_um")


def profiles_csv(sections: Sequence[Section], software_version: str) -> str:
    """Return the table; lines that begin with ``#`` state the sources, empty cells are unmeasured heights."""
    text = io.StringIO()
    text.writelines(f"# {_comment(line)}\n" for line in _heading(sections, software_version))
    table = TableWriter(text)
    table.writerow([f"{section.title} {column}" for section in sections for column in PROFILE_COLUMNS])
    blocks = [_rows(section) for section in sections]
    nothing = [""] * len(PROFILE_COLUMNS)
    table.writerows([cell for part in row for cell in part] for row in zip_longest(*blocks, fillvalue=nothing))
    return text.getvalue()


def _comment(line: str) -> str:
    """Return a line for the head of a table: one line, and no cell of it a formula."""
    return re.sub(rf",(?={_FORMULA.pattern})", ";", " ".join(line.split()))


def _heading(sections: Sequence[Section], software_version: str) -> list[str]:
    simulated = any(section.profile.simulated for section in sections)
    return [
        f"Wafer Viewer {software_version}: profiles, um, stage coordinates",
        *(["SIMULATED: not measurements of a real sample."] if simulated else []),
        *(_about(section) for section in sections),
    ]


def _about(section: Section) -> str:
    profile = section.profile
    first, *corners, last = profile.line.points
    corner = f" by {len(corners)} corner{'' if len(corners) == 1 else 's'}" if corners else ""
    facts = [
        section.source,
        f"from ({first.x_um:.2f}, {first.y_um:.2f}){corner} to ({last.x_um:.2f}, {last.y_um:.2f}) um",
        f"width {profile.line.width_um:g} um",
        LAYER_TITLES[profile.surface],
        f"filter {profile.filter}",
        f"levelled by {section.asked.levelling.by}",
        "SIMULATED" if profile.simulated else "real",
        f"Pt {profile.pt.value_um:.6g} um ({profile.pt.status})",
        *profile.notes,
    ]
    return f"{section.title}: {'; '.join(facts)}"


def _rows(section: Section) -> list[list[str]]:
    curve = section.curve
    columns = (curve.distance_um, curve.x_um, curve.y_um, curve.z_um)
    return [["" if v != v else f"{v:.4f}" for v in row] for row in zip(*(c.tolist() for c in columns), strict=True)]


STUDY_COLUMNS = {
    "part": ("part", "sample", "wafer", "die", "piece", "item", "specimen", "part number", "part no", "serial"),
    "appraiser": ("appraiser", "operator", "inspector", "technician", "person", "name", "by"),
    "value": ("value", "measurement", "measured", "reading", "result", "height", "response"),
}
"""Names of the columns of a study as people write them, without unit, in any case; the first are ours."""
HOW = "a study has the columns part, appraiser (or operator) and value (or measurement), and a line for each trial"


def read_study(path: Path) -> NDArray[np.float64]:
    """Read the values of a CSV file, [part, appraiser, trial]; trials in line order. Lines with # are skipped.

    Columns are separated by commas, semicolons or tabs; where it is not commas, a number may have a decimal comma.

    Raises MeasureError when the file cannot be read, lacks a column, holds a non-number, or has unequal numbers of
    trials.
    """
    cells: dict[tuple[str, str], list[float]] = defaultdict(list)
    for number, line in _lines(path):
        try:
            cells[line["part"], line["appraiser"]].append(float(line["value"]))
        except ValueError as fault:
            raise MeasureError(
                f"{path.name}, line {number}: {line['value'][:80]!r} is not a number: correct the line."
            ) from fault
    if not cells:
        raise MeasureError(f"{path.name} holds no values: {HOW}.")
    parts, appraisers = (list(dict.fromkeys(key[k] for key in cells)) for k in range(2))
    trials = len(next(iter(cells.values())))
    for part in parts:
        for appraiser in appraisers:
            if (found := len(cells.get((part, appraiser), ()))) != trials:
                raise MeasureError(
                    f"{path.name}: part {_brief(part)} has {found} values of {_brief(appraiser)}, the first has "
                    f"{trials}: everyone measures every part equally often."
                )
    return np.array([[cells[part, appraiser] for appraiser in appraisers] for part in parts])


def _brief(name: str) -> str:
    """Return a name of a file on one line, shortened."""
    return " ".join(name.split())[:80]


def read_column(path: Path, column: str) -> NDArray[np.float64]:
    """Read the numbers of a column of a CSV file, [line]; empty cells are skipped, and lines with #.

    Raises MeasureError when the file cannot be read, has no such column or two, or a cell is no number.
    """
    lines, heads, separator = _table(path, "a table has a line of column names, then a line for each part")
    places = [at for at, head in enumerate(heads) if head.strip() == column]
    if len(places) != 1:
        has = "two columns" if places else "no column"
        raise MeasureError(f"{path.name} has {has} {_brief(column)}: it has {_brief(', '.join(heads)) or 'none'}.")
    values: list[float] = []
    for number, row in lines:
        if text := _cell(row, places[0], separator):
            try:
                values.append(float(text))
            except ValueError as fault:
                raise MeasureError(f"{path.name}, line {number}: {text[:80]!r} is not a number.") from fault
    return np.array(values)


def _lines(path: Path) -> list[tuple[int, dict[str, str]]]:
    """Return number and cells of each line, the columns of a study under our names."""
    lines, heads, separator = _table(path, HOW)
    columns = _study_columns(path, heads)
    return [(n, {name: _cell(row, at, separator) for name, at in columns.items()}) for n, row in lines]


def _table(path: Path, how: str) -> tuple[list[tuple[int, list[str]]], list[str], str]:
    """Return number and cells of each line, the names of the columns, and what separates them."""
    with parser_errors_as(lambda fault: MeasureError(f"{path} cannot be read{detail(fault)}: {how}.")):
        text = read_content(path, MeasureError).decode("utf-8-sig")
        lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if _counts(line)]
        separator = max(",;\t", key=lines[0][1].count) if lines else ","
        rows = list(csv.reader((line for _, line in lines), delimiter=separator))
    numbered = [(n, row) for (n, _), row in zip(lines[1:], rows[1:], strict=False)]
    return numbered, rows[0] if rows else [], separator


def _study_columns(path: Path, heads: list[str]) -> dict[str, int]:
    """Return the place of each column of a study. Raises MeasureError where one is missing or stands there twice."""
    plain = [re.sub(r"[(\[].*", "", head).replace("_", " ").strip().lower() for head in heads]
    found: dict[str, int] = {}
    for name, words in STUDY_COLUMNS.items():
        places = [at for word in words for at, head in enumerate(plain) if head == word]
        if not places:
            raise MeasureError(f"{path.name} has no column {name}, only {_brief(', '.join(heads)) or 'none'}: {HOW}.")
        if plain.count(plain[places[0]]) > 1:
            raise MeasureError(f"{path.name} has two columns {_brief(heads[places[0]])}: rename or remove one.")
        found[name] = places[0]
    return found


def _cell(row: list[str], at: int, separator: str) -> str:
    text = row[at].strip() if at < len(row) else ""
    decimal_comma = separator != "," and re.fullmatch(r"[-+]?\d+,\d+", text)
    return text.replace(",", ".") if decimal_comma else text


def _counts(text: str) -> bool:
    return bool(text.strip()) and not text.startswith("#")
