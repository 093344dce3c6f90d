"""KLARF 1.0 to 1.2, the exchange format of inspection tools and yield systems: reader and writer.

Line breaks count as blanks, so the numbers of a defect may continue in the next line. There may be several defect lists
(one for each image or inspection test), each with the last preceding column specification.

Lengths in um. XREL and YREL are the centre of a defect relative to the lower left corner of its die, along the axes of
the lattice; SampleCenterLocation is the wafer centre relative to the lower left corner of die 0,0. HEIGHT, signed, is
an additional column that other readers ignore. The test plan contains only dies that were inspected completely or that
have defects: a die that was not or only partly scanned must not appear clean.
"""

from __future__ import annotations

import codecs
import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np

from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.errors import DatasetError, detail, parser_errors_as
from wafer_viewer.model.inspection.defect import Defect, Inspection
from wafer_viewer.model.inspection.die_grid import DieGrid, DieStatus
from wafer_viewer.model.inspection.klarf import BINS, CLASS_NUMBERS, Klarf, KlarfDefect
from wafer_viewer.model.spec import replace
from wafer_viewer.store.io.atomic_files import write_text
from wafer_viewer.store.io.guarded_reading import read_content

KlarfUnit = Literal["um", "nm", "mm"]
UM_PER: dict[str, float] = {"um": 1.0, "nm": 1e-3, "mm": 1e3}
VERSIONS = ("1.0", "1.1", "1.2")
NEEDED = ("DEFECTID", "XREL", "YREL", "XINDEX", "YINDEX")
LEAST_PITCH_UM = 50.0
"""Least plausible die pitch; a smaller one means another unit."""
_NEWER = re.compile(r'\s*Record\s+FileRecord\s+"([^"]*)"')
_TOKEN = re.compile(r'"([^"]*)"|([^\s"]+)')
_LENGTHS = {"width_um": "XSIZE", "height_um": "YSIZE", "size_um": "DSIZE"}
_COUNTS = {"class_number": "CLASSNUMBER", "bin": "ROUGHBINNUMBER", "test": "TEST"}


_SIMULATED = "SIMULATED"
"""Model of the inspection station of a simulated wafer."""
IMAGE_WORDS = 3
"""Greatest number of words per image of a defect, in the lines after it."""


@dataclass(frozen=True, slots=True)
class Record:
    """One record, from its keyword to its semicolon: the words of each line, without the keyword."""

    lines: tuple[tuple[str, ...], ...]

    @property
    def words(self) -> tuple[str, ...]:
        """All words in order."""
        return tuple(word for line in self.lines for word in line)


@dataclass(frozen=True, slots=True)
class DefectList:
    """List of defects with its columns."""

    columns: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True)
class Records:
    """Records of a file by keyword, in order; repeated ones of all inspection tests together."""

    by_keyword: dict[str, tuple[Record, ...]]
    lists: tuple[DefectList, ...]

    def __contains__(self, keyword: str) -> bool:
        return keyword in self.by_keyword

    def __getitem__(self, keyword: str) -> Record:
        """Return the last record of a keyword."""
        return self.by_keyword[keyword][-1]

    def all(self, keyword: str) -> tuple[Record, ...]:
        """Return all records of a keyword."""
        return self.by_keyword.get(keyword, ())


def read_klarf(path: str | Path, unit: KlarfUnit | None = None) -> Klarf:
    """Read a KLARF file, version 1.0 to 1.2, of one wafer.

    Record counts are verified, and units are checked for plausibility.

    Parameters
    ----------
    path : str or Path
        The KLARF file, UTF-8 or UTF-16.
    unit : {"um", "nm", "mm"}, optional
        Unit of the lengths if the file states none. Default: um.

    Returns
    -------
    Klarf
        Wafer, lattice of dies, and defects relative to the lower left corners of their dies; lengths in um. Its notes
        state what was converted or merged, or could not be checked.

    Raises
    ------
    DatasetError
        When the file cannot be read, is not KLARF 1.0 to 1.2, is truncated or damaged, holds several wafers, lacks
        records or columns, or lists another number of dies or defects than it states; when its unit is unknown or
        differs from `unit`, or its lengths are implausible in that unit.

    Notes
    -----
    Line breaks count as blanks, so the numbers of a defect may continue in the next line. The dies and defects of
    several inspection tests are merged. If the coordinates are mirrored, x is mirrored back about the centre of the
    wafer. In a file without a summary, missing records cannot be detected.
    """
    place = Path(path)
    records = _records(place, _text(place))
    try:
        with parser_errors_as(lambda fault: DatasetError(f"it has a damaged record{detail(fault)}: export it again.")):
            um, notes = _um_per_unit(records, unit)
            notes += _notes(records)
            klarf = Klarf(**_facts(records, um), defects=tuple(_defects(records, um)), notes=notes)
            _require_all(records, klarf)
            _require_plausible(klarf)
    except DatasetError as fault:
        raise DatasetError(f"{place.name}: {fault}") from fault
    return klarf if "SummaryList" in records else _unchecked(klarf)


def _text(path: Path) -> str:
    content = read_content(path)
    utf_16 = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    return content.decode("utf-16" if utf_16 else "utf-8-sig", errors="replace")


def _records(path: Path, text: str) -> Records:
    """Return all records. Raises DatasetError for another format, a truncated file, or several wafers."""
    if (newer := _NEWER.match(text)) is not None:
        raise DatasetError(
            f"{path.name} is KLARF {newer[1]}, which has another syntax: export it as KLARF 1.2 (FileVersion 1 2)."
        )
    if not text.lstrip().startswith("FileVersion"):
        raise DatasetError(f"{path.name} is not a KLARF file: it does not begin with FileVersion.")
    if "EndOfFile" not in text[-200:]:
        raise DatasetError(f"{path.name} is cut off, it has no EndOfFile: copy or export it again.")
    found: dict[str, list[Record]] = defaultdict(list)
    lists: list[DefectList] = []
    for record in _split(text):
        lines = tuple(words for line in record.splitlines() if (words := _words(line)))
        if not lines:
            continue
        keyword = lines[0][0]
        if keyword == "WaferID" and keyword in found:
            raise DatasetError(f"{path.name} holds several wafers: export one wafer to a file.")
        found[keyword].append(Record((lines[0][1:], *lines[1:])))
        if keyword == "DefectList":
            columns = found["DefectRecordSpec"][-1].words[1:] if "DefectRecordSpec" in found else ()
            lists.append(DefectList(columns, tuple(filter(None, found[keyword][-1].lines))))
    return Records({keyword: tuple(of_it) for keyword, of_it in found.items()}, tuple(lists))


def _split(text: str) -> Iterator[str]:
    """Split at the semicolons outside quotation marks."""
    return (part for part in re.findall(r'(?:"[^"]*"|[^;"])+', text) if part.strip())


def _words(line: str) -> tuple[str, ...]:
    return tuple(quoted or plain for quoted, plain in _TOKEN.findall(line))


def _um_per_unit(records: Records, unit: KlarfUnit | None) -> tuple[float, tuple[str, ...]]:
    """Return the length unit in um, and notes; the file's own unit takes precedence."""
    version = ".".join(records["FileVersion"].words[:2])
    if version not in VERSIONS:
        raise DatasetError(f"it is KLARF {version} and not one of {', '.join(VERSIONS)}: export it as 1.2.")
    named_unit = next((records[name].words[0].lower() for name in ("Units", "Unit") if name in records), "")
    if named_unit and unit and named_unit != unit:
        raise DatasetError(f"it states the unit {named_unit}, not {unit}: leave the unit out.")
    used = named_unit or unit or "um"
    if used not in UM_PER:
        raise DatasetError(f"its unit is {used!r}, not one of {', '.join(UM_PER)}: export it in um.")
    return UM_PER[used], () if used == "um" else (f"Lengths were converted from {used} to um.",)


def _notes(records: Records) -> tuple[str, ...]:
    """Return sentences on data that were merged or converted."""
    tests = len(records.all("InspectionTest"))
    several = (f"It holds {tests} inspection tests: their dies and defects are shown together.",) if tests > 1 else ()
    mirrored = ("Its coordinates are mirrored: x was mirrored back about the centre of the wafer.",)
    return several + (mirrored if _is_mirrored(records) else ())


def _facts(records: Records, um: float) -> dict[str, Any]:
    """Return the header values; pitch and defects are required, other missing values stay empty."""
    for keyword in ("DiePitch", "DefectRecordSpec", "DefectList"):
        if keyword not in records:
            raise DatasetError(f"it has no record {keyword}: export it again.")
    pitch, center = _numbers(records, "DiePitch"), _numbers(records, "SampleCenterLocation") or (0.0, 0.0)
    origin, size = _numbers(records, "DieOrigin") or (0.0, 0.0), _numbers(records, "SampleSize") or (0.0, 0.0)
    center_x = center[0] + origin[0]
    return {
        "version": ".".join(records["FileVersion"].words[:2]),
        **{name: _first(records, key) for name, key in _NAMES.items()},
        "notch": _first(records, "OrientationMarkLocation") or "DOWN",
        "simulated": "InspectionStationID" in records and _SIMULATED in records["InspectionStationID"].words,
        "slot": _parse_integer(_first(records, "Slot") or "0"),
        "sample_mm": size[1],
        "pitch_x_um": pitch[0] * um,
        "pitch_y_um": pitch[1] * um,
        "center_x_um": (pitch[0] - center_x if _is_mirrored(records) else center_x) * um,
        "center_y_um": (center[1] + origin[1]) * um,
        "inspected_um2": max((float(area.words[0]) for area in records.all("AreaPerTest")), default=0.0) * um**2,
        "classes": _classes(records),
        "dies": _pairs(records),
    }


_NAMES = {"lot": "LotID", "wafer": "WaferID", "device": "DeviceID", "setup": "SetupID", "step": "StepID"}


def _first(records: Records, keyword: str) -> str:
    return records[keyword].words[0] if keyword in records and records[keyword].words else ""


def _numbers(records: Records, keyword: str) -> tuple[float, ...]:
    return tuple(float(word) for word in records[keyword].words) if keyword in records else ()


def _classes(records: Records) -> tuple[tuple[int, str], ...]:
    words = records["ClassLookup"].words[1:] if "ClassLookup" in records else ()
    return tuple((_parse_integer(n), name) for n, name in zip(words[::2], words[1::2], strict=False))


def _pairs(records: Records) -> tuple[tuple[int, int], ...]:
    """Return the dies of the test plans of all inspection tests, each once."""
    found: dict[tuple[int, int], None] = {}
    for plan in records.all("SampleTestPlan"):
        words = plan.words
        named = [(_parse_integer(col), _parse_integer(row)) for col, row in zip(words[1::2], words[2::2], strict=False)]
        if len(named) != _parse_integer(words[0]):
            raise DatasetError(f"its test plan names {len(named)} of {words[0]} dies: export it again.")
        found |= dict.fromkeys(named)
    return tuple((-col, row) if _is_mirrored(records) else (col, row) for col, row in found)


def _is_mirrored(records: Records) -> bool:
    """Return whether x increases from right to left, as for a wafer back side seen through the front."""
    return _first(records, "CoordinatesMirrored").upper() in ("YES", "Y", "TRUE", "1")


def _parse_integer(word: str) -> int:
    """Parse an integer, which some programs write as ``0.000``. Raises ValueError for any other word."""
    value = float(word)
    if not value.is_integer():
        raise ValueError(f"{word} is not a whole number")
    return int(value)


def _defects(records: Records, um: float) -> Iterator[KlarfDefect]:
    names, mirrored = dict(_classes(records)), _is_mirrored(records)
    origin_um = tuple(part * um for part in _numbers(records, "DieOrigin") or (0.0, 0.0))
    pitch_um = _numbers(records, "DiePitch")[0] * um
    for listed in records.lists:
        if lacking := [name for name in NEEDED if name not in listed.columns]:
            raise DatasetError(f"its defects have no {lacking[0]}: export it with {', '.join(NEEDED)}.")
        for values in _rows(listed):
            found = _defect(values, names, um, origin_um)
            if mirrored:
                found = replace(found, col=-found.col, u_um=pitch_um - found.u_um)
            yield found


def _rows(listed: DefectList) -> Iterator[dict[str, str]]:
    """Yield the words of each defect by column; line breaks count as blanks."""
    least = len(listed.columns) - ("IMAGELIST" in listed.columns)
    pending: tuple[str, ...] = ()
    n_image_words, begun = 0, 0
    for n, words in enumerate(listed.lines, 1):
        if not pending and len(words) <= n_image_words:  # lines below a defect list its images
            n_image_words -= len(words)
            continue
        begun = begun if pending else n
        joined = pending + words
        if pending and len(words) >= least and len(joined) > len(listed.columns):  # this line is a complete defect
            raise DatasetError(_too_few(begun, len(pending), least))
        pending = joined if len(joined) < least else ()
        if not pending:
            values = dict(zip(listed.columns, joined, strict=False))
            n_image_words = IMAGE_WORDS * _parse_integer(values.get("IMAGECOUNT", "0"))
            yield values
    if pending:
        raise DatasetError(_too_few(begun, len(pending), least))


def _too_few(line: int, n_words: int, least: int) -> str:
    return f"line {line} of its defects has {n_words} of {least} numbers: export it again."


def _defect(values: dict[str, str], names: dict[int, str], um: float, origin_um: tuple[float, ...]) -> KlarfDefect:
    """Return a defect; its position is relative to its die's origin, which may differ from the lower left corner."""
    lengths = {field: float(values.get(name, 0)) * um for field, name in _LENGTHS.items()}
    counts = {field: _parse_integer(values[name]) for field, name in _COUNTS.items() if name in values}
    return KlarfDefect(
        number=_parse_integer(values["DEFECTID"]),
        col=_parse_integer(values["XINDEX"]),
        row=_parse_integer(values["YINDEX"]),
        u_um=float(values["XREL"]) * um + origin_um[0],
        v_um=float(values["YREL"]) * um + origin_um[1],
        area_um2=float(values.get("DEFECTAREA", 0)) * um**2,
        class_name=names.get(counts.get("class_number", 0), ""),
        **lengths,
        **counts,  # pyright: ignore[reportArgumentType]
    )


def _require_all(records: Records, klarf: Klarf) -> None:
    """Raise DatasetError when the summary count differs from the number of listed defects."""
    if "SummaryList" not in records:
        return
    width = _parse_integer(_first(records, "SummarySpec") or "5")
    columns = records["SummarySpec"].words[1:] if "SummarySpec" in records else ("TESTNO", "NDEFECT")
    at = columns.index("NDEFECT")
    n_summary = sum(_parse_integer(count) for record in records.all("SummaryList") for count in record.words[at::width])
    n_listed = len(klarf.defects)
    if n_summary != n_listed:
        raise DatasetError(f"its summary counts {n_summary} defects and {n_listed} are listed: export it again.")


def _require_plausible(klarf: Klarf) -> None:
    """Raise DatasetError when lengths cannot be in um."""
    pitch_um = min(klarf.pitch_x_um, klarf.pitch_y_um)
    if pitch_um < LEAST_PITCH_UM:
        raise DatasetError(
            f"its dies would be {pitch_um:g} um apart, and none are under {LEAST_PITCH_UM:g} um: "
            "it is in another unit, say which (mm)."
        )
    across_um = klarf.sample_mm * 1000
    if across_um and max(klarf.pitch_x_um, klarf.pitch_y_um) > across_um:
        raise DatasetError(
            f"its dies would be {max(klarf.pitch_x_um, klarf.pitch_y_um):g} um apart on a sample of {across_um:g} um: "
            "it is in another unit, say which (nm)."
        )
    for d in klarf.defects:
        if abs(d.u_um) > 2 * klarf.pitch_x_um or abs(d.v_um) > 2 * klarf.pitch_y_um:
            raise DatasetError(
                f"defect {d.number} lies {d.u_um:g}, {d.v_um:g} um from its die's corner, beyond the next die: "
                "its places are in another unit than its dies, export it again."
            )


def _unchecked(klarf: Klarf) -> Klarf:
    note = "The file has no summary: missing records cannot be detected."
    return replace(klarf, notes=(*klarf.notes, note))


COLUMNS = (
    *("DEFECTID", "XREL", "YREL", "XINDEX", "YINDEX", "XSIZE", "YSIZE", "DEFECTAREA", "DSIZE", "CLASSNUMBER", "TEST"),
    *("CLUSTERNUMBER", "ROUGHBINNUMBER", "FINEBINNUMBER", "HEIGHT", "IMAGECOUNT", "IMAGELIST"),
)
MM2_PER_CM2, UM2_PER_MM2, STANDARD_MM = 100.0, 1e6, 300.0


def write_klarf(
    inspection: Inspection,
    path: str | Path,
    sample: Sample = Sample(),
    *,
    center_um: tuple[float, float] = (0.0, 0.0),
    at: datetime | None = None,
) -> Path:
    """Write the defects of an inspection to a KLARF 1.2 file.

    Parameters
    ----------
    inspection : Inspection
        Result of a defect inspection with a die grid. Unmeasured areas are not written.
    path : str or Path
        File to write; an existing file is replaced.
    sample : Sample, optional
        Identification of the wafer: lot, wafer id, slot, notch and size (300 mm if not given). Default: empty.
    center_um : tuple of float, default (0.0, 0.0)
        Stage position (x, y) of the wafer centre in um.
    at : datetime, optional
        Time stamp of the file. Default: now.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    DatasetError
        When the inspection has no die grid, or the file cannot be written.

    Notes
    -----
    Lengths are in um. XREL and YREL are the centre of a defect relative to the lower left corner of its die, along the
    axes of the lattice; SampleCenterLocation is the wafer centre relative to the lower left corner of die 0,0. HEIGHT,
    signed, is an additional column that other readers ignore. The test plan contains only dies that were inspected
    completely or that have defects: a die that was not or only partly scanned must not appear clean. ROUGHBINNUMBER is
    the judgement: 0 open, 1 real, 2 nuisance.
    """
    if inspection.grid is None:
        raise DatasetError("KLARF gives places by dies and this inspection has none: give their pitch, or write a CSV.")
    text = "\n".join(_lines(inspection, inspection.grid, sample, center_um, at or datetime.now()))
    write_text(Path(path), text + "\n")
    return Path(path)


def _lines(
    inspection: Inspection, grid: DieGrid, sample: Sample, center_um: tuple[float, float], at: datetime
) -> Iterator[str]:
    yield from _head(inspection, sample, at)
    yield from _lattice(grid, sample, center_um)
    yield from _class_records()
    yield from _plan(inspection)
    yield from _defect_records(inspection, grid)
    yield from _summary(inspection)
    yield "EndOfFile;"


def _head(inspection: Inspection, sample: Sample, at: datetime) -> Iterator[str]:
    stamp = f"{at:%m-%d-%Y %H:%M:%S}"
    yield "FileVersion 1 2;"
    yield f"FileTimestamp {stamp};"
    yield (
        f'InspectionStationID "Wafer Viewer" "{_SIMULATED}" "0";'
        if inspection.simulated
        else ('InspectionStationID "Wafer Viewer" "shape from focus" "0";')
    )
    yield "SampleType WAFER;"
    yield f"ResultTimestamp {stamp};"
    yield f"LotID {_quoted(sample.lot)};"
    yield f"SampleSize 1 {_size_mm(sample):.0f};"
    yield f"DeviceID {_quoted(inspection.product or sample.product)};"
    yield f"SetupID {_quoted(inspection.recipe.name)} {stamp};"
    yield f"StepID {_quoted(inspection.reference)};"


def _lattice(grid: DieGrid, sample: Sample, center_um: tuple[float, float]) -> Iterator[str]:
    col, row, u, v = _in_die(grid, *center_um)
    yield "SampleOrientationMarkType NOTCH;"
    yield f"OrientationMarkLocation {'DOWN' if sample.notch == 'none' else sample.notch.upper()};"
    yield f"DiePitch {grid.pitch_x_um:.6f} {grid.pitch_y_um:.6f};"
    yield "DieOrigin 0.000000 0.000000;"
    yield f"WaferID {_quoted(sample.wafer_id or sample.name)};"
    yield f"Slot {sample.slot};"
    yield f"SampleCenterLocation {col * grid.pitch_x_um + u:.6f} {row * grid.pitch_y_um + v:.6f};"


def _in_die(grid: DieGrid, x_um: float, y_um: float) -> tuple[int, int, float, float]:
    """Return (col, row, u_um, v_um) of one stage position."""
    col, row, u, v = grid.to_die(np.asarray(x_um), np.asarray(y_um))
    return int(col), int(row), float(u), float(v)


def _class_records() -> Iterator[str]:
    yield f"ClassLookup {len(CLASS_NUMBERS) + 1}"
    yield ' 0 "Unclassified"'
    *_, last = CLASS_NUMBERS
    yield from (f' {n} "{kind.capitalize()}"{";" if kind == last else ""}' for kind, n in CLASS_NUMBERS.items())


def _plan(inspection: Inspection) -> Iterator[str]:
    """Yield the inspected dies and their area."""
    dies = _looked_at(inspection)
    yield "InspectionTest 1;"
    yield f"SampleTestPlan {len(dies)}{'' if dies else ';'}"
    yield from (f" {die.col} {die.row}{';' if die is dies[-1] else ''}" for die in dies)
    yield "InspectedAreaOrigin 0.000000 0.000000;"
    yield f"AreaPerTest {inspection.inspected_mm2 * UM2_PER_MM2:.6e};"


def _defect_records(inspection: Inspection, grid: DieGrid) -> Iterator[str]:
    found = inspection.found
    yield f"DefectRecordSpec {len(COLUMNS)} {' '.join(COLUMNS)} ;"
    yield f"DefectList{'' if found else ';'}"
    yield from (f" {_record(defect, grid)}{';' if defect is found[-1] else ''}" for defect in found)


def _record(defect: Defect, grid: DieGrid) -> str:
    col, row, u, v = _in_die(grid, defect.center.x_um, defect.center.y_um)
    x0, y0, x1, y1 = defect.outline.bounds_um
    lengths = (x1 - x0, y1 - y0, defect.area.value, defect.major.value_um)
    parts = (
        f"{defect.number} {u:.3f} {v:.3f} {col} {row}",
        " ".join(f"{length:.3f}" for length in lengths),
        f"{CLASS_NUMBERS.get(defect.seen_as, 0)} 1 0 {BINS[defect.judgement]} 0",
        f"{defect.height.value_um:.3f} 0 0",
    )
    return " ".join(parts)


def _looked_at(inspection: Inspection) -> list[DieStatus]:
    """Return the dies whose defect state is known."""
    return [die for die in inspection.dies if die.defects or (die.state == "whole" and die.defects is not None)]


def _summary(inspection: Inspection) -> Iterator[str]:
    found, plan = inspection.found, _looked_at(inspection)
    area_cm2 = inspection.inspected_mm2 / MM2_PER_CM2
    density = len(found) / area_cm2 if area_cm2 else 0.0
    yield "SummarySpec 5 TESTNO NDEFECT DEFDENSITY NDIE NDEFDIE ;"
    yield "SummaryList"
    yield f" 1 {len(found)} {density:.4f} {len(plan)} {sum(bool(die.defects) for die in plan)};"


def _size_mm(sample: Sample) -> float:
    return max(sample.width_um or 0.0, sample.height_um or 0.0) / 1000 or STANDARD_MM


def _quoted(text: str) -> str:
    """Return a quoted text; double quotes in it become single ones, as KLARF cannot escape them."""
    return '"' + " ".join(text.replace('"', "'").split()) + '"'
