"""KLARF, the exchange format of inspection tools and yield systems: reader and writer.

Lengths in um, in version 1.8 in nm. XREL and YREL are the centre of a defect relative to the lower left corner of its
die, along the axes of the lattice; SampleCenterLocation is the wafer centre relative to the lower left corner of die
0,0. HEIGHT, signed, is an additional column that other readers ignore. The test plan contains only dies that were
inspected completely or that have defects: a die that was not or only partly scanned must not appear clean.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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
from wafer_viewer.store.tables.klarf_records import Records, column_names, parse_integer, read_records

KlarfUnit = Literal["um", "nm", "mm"]
KlarfVersion = Literal["1.2", "1.8"]
UM_PER: dict[str, float] = {"um": 1.0, "nm": 1e-3, "mm": 1e3}
NEEDED = ("DEFECTID", "XREL", "YREL", "XINDEX", "YINDEX")
LEAST_PITCH_UM = 50.0
"""Least plausible die pitch; a smaller one means another unit."""
NOT_GIVEN = "NA"
"""Word for a number that is not known."""
_LENGTHS = {"width_um": "XSIZE", "height_um": "YSIZE", "size_um": "DSIZE"}
_COUNTS = {"class_number": "CLASSNUMBER", "bin": "ROUGHBINNUMBER", "test": "TEST"}
_YES, _NO = ("YES", "Y", "TRUE", "1"), ("NO", "N", "FALSE", "0")
_SIMULATED = "SIMULATED"
"""Model of the inspection station of a simulated wafer."""


def read_klarf(path: str | Path, unit: KlarfUnit | None = None) -> Klarf:
    """Read a KLARF file, version 1.0 to 1.2 or 1.8, of one wafer.

    Record counts are verified, and units are checked for plausibility.

    Parameters
    ----------
    path : str or Path
        The KLARF file, UTF-8 or UTF-16; text that is neither is read as Windows-1252, with a note.
    unit : {"um", "nm", "mm"}, optional
        Unit of the lengths if the file states none. Default: um; version 1.8 is in nm.

    Returns
    -------
    Klarf
        Wafer, lattice of dies, and defects relative to the lower left corners of their dies; lengths in um. Its notes
        state what was converted or merged, or could not be checked.

    Raises
    ------
    DatasetError
        When the file cannot be read, is not KLARF 1.0 to 1.2 or 1.8, is truncated or damaged, holds several wafers,
        lacks records or columns, contradicts itself, or lists another number of columns, dies, classes or defects than
        it states; when its unit is unknown or differs from `unit`, or its lengths are implausible in that unit.

    Notes
    -----
    Keywords may be in any case. Line breaks count as blanks, so the numbers of a defect may continue in the next line;
    rows may each end with a semicolon. The dies and defects of several inspection tests are merged. If the coordinates
    are mirrored, x is mirrored back about the centre of the wafer. In a file without a summary, missing records cannot
    be detected.
    """
    place = Path(path)
    content = read_content(place)  # its errors name the file
    try:
        with parser_errors_as(lambda fault: DatasetError(f"it has a damaged record{detail(fault)}: export it again.")):
            records = read_records(content)
            um, notes = _um_per_unit(records, unit)
            notes += _notes(records)
            klarf = Klarf(**_facts(records, um), defects=tuple(_defects(records, um)), notes=notes)
            _require_all(records, klarf)
            _require_plausible(klarf)
    except DatasetError as fault:
        raise DatasetError(f"{place.name}: {fault}") from fault
    return klarf if records.counted else _unchecked(klarf)


def _um_per_unit(records: Records, unit: KlarfUnit | None) -> tuple[float, tuple[str, ...]]:
    """Return the length unit in um, and notes; the file's own unit takes precedence."""
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
    seen_from = _first(records, "OrientationInstructions")
    turned = (f'Its OrientationInstructions say "{seen_from}": its places are taken as they are.',)
    other_side = turned if seen_from.upper() not in ("", "FRONT") else ()
    return records.notes + several + (mirrored if _is_mirrored(records) else ()) + other_side


def _facts(records: Records, um: float) -> dict[str, Any]:
    """Return the header values; pitch and defects are required, other missing values stay empty."""
    for keyword in ("DiePitch", "DefectRecordSpec", "DefectList"):
        if keyword not in records:
            raise DatasetError(f"it has no record {keyword}: export it again.")
    pitch, center = _numbers(records, "DiePitch", 2), _numbers(records, "SampleCenterLocation", 2) or (0.0, 0.0)
    origin, size = _numbers(records, "DieOrigin", 2) or (0.0, 0.0), _numbers(records, "SampleSize") or (0.0, 0.0)
    center_x = center[0] + origin[0]
    return {
        "version": ".".join(records["FileVersion"].words[:2]),
        **{name: _first(records, key) for name, key in _NAMES.items()},
        "notch": _first(records, "OrientationMarkLocation") or "DOWN",
        "simulated": "InspectionStationID" in records and _SIMULATED in records["InspectionStationID"].words,
        "slot": parse_integer(_first(records, "Slot") or "0"),
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


def _numbers(records: Records, keyword: str, n: int | None = None) -> tuple[float, ...]:
    """Return the numbers of a record, nothing without it. Raises DatasetError if they are not n, or not the same."""
    stated = {tuple(float(word) for word in record.words) for record in records.all(keyword)}
    if len(stated) > 1:
        raise DatasetError(f"it states {keyword} more than once, with different numbers: export it again.")
    numbers = next(iter(stated), ())
    if stated and n not in (None, len(numbers)):
        raise DatasetError(f"its {keyword} has {len(numbers)} of {n} numbers: export it again.")
    return numbers


def _classes(records: Records) -> tuple[tuple[int, str], ...]:
    if "ClassLookup" not in records:
        return ()
    n, *words = records["ClassLookup"].words
    if len(words) != 2 * parse_integer(n):
        raise DatasetError(f"its class list names {len(words) / 2:g} of {n} classes: export it again.")
    return tuple((parse_integer(number), name) for number, name in zip(words[::2], words[1::2], strict=True))


def _pairs(records: Records) -> tuple[tuple[int, int], ...]:
    """Return the dies of the test plans of all inspection tests, each once."""
    found: dict[tuple[int, int], None] = {}
    for plan in records.all("SampleTestPlan"):
        n, *words = plan.words
        if len(words) != 2 * parse_integer(n):
            raise DatasetError(f"its test plan names {len(words) / 2:g} of {n} dies: export it again.")
        numbers = [parse_integer(word) for word in words]
        found |= dict.fromkeys(zip(numbers[::2], numbers[1::2], strict=True))
    return tuple((-col, row) if _is_mirrored(records) else (col, row) for col, row in found)


def _is_mirrored(records: Records) -> bool:
    """Return whether x increases from right to left, as for a wafer back side seen through the front."""
    stated = {" ".join(record.words).upper() for record in records.all("CoordinatesMirrored")} - {""}
    if stated - {*_YES, *_NO} or (stated & {*_YES} and stated & {*_NO}):
        raise DatasetError(f"its CoordinatesMirrored is {' and '.join(sorted(stated))}: give YES or NO.")
    return bool(stated & {*_YES})


def _defects(records: Records, um: float) -> Iterator[KlarfDefect]:
    names, mirrored = dict(_classes(records)), _is_mirrored(records)
    origin_um = tuple(part * um for part in _numbers(records, "DieOrigin", 2) or (0.0, 0.0))
    pitch_um = _numbers(records, "DiePitch")[0] * um
    for listed in records.lists:
        if lacking := [name for name in NEEDED if name not in listed.columns]:
            raise DatasetError(f"its defects have no {lacking[0]}: export it with {', '.join(NEEDED)}.")
        if twice := [name for name in NEEDED if listed.columns.count(name) > 1]:
            raise DatasetError(f"its defects have two columns {twice[0]}: export it with one.")
        for row in listed.rows:
            values = {name: word for name, word in zip(listed.columns, row, strict=False) if word != NOT_GIVEN}
            found = _defect(values, names, um, origin_um)
            if mirrored:
                found = replace(found, col=-found.col, u_um=pitch_um - found.u_um)
            yield found


def _defect(values: dict[str, str], names: dict[int, str], um: float, origin_um: tuple[float, ...]) -> KlarfDefect:
    """Return a defect; its position is relative to its die's origin, which may differ from the lower left corner."""
    lengths = {field: float(values.get(name, 0)) * um for field, name in _LENGTHS.items()}
    counts = {field: parse_integer(values[name]) for field, name in _COUNTS.items() if name in values}
    return KlarfDefect(
        number=parse_integer(values["DEFECTID"]),
        col=parse_integer(values["XINDEX"]),
        row=parse_integer(values["YINDEX"]),
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
    columns = column_names(records["SummarySpec"]) if "SummarySpec" in records else SUMMARY_COLUMNS
    words = [word for record in records.all("SummaryList") for word in record.words]
    if len(words) % len(columns):
        raise DatasetError(f"its summary has {len(words)} numbers in {len(columns)} columns: export it again.")
    n_summary = sum(map(parse_integer, words[columns.index("NDEFECT") :: len(columns)]))
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


ColumnKind = Literal["count", "length", "area"]
COLUMNS: dict[str, ColumnKind] = {
    **dict.fromkeys(("DEFECTID",), "count"),
    **dict.fromkeys(("XREL", "YREL"), "length"),
    **dict.fromkeys(("XINDEX", "YINDEX"), "count"),
    **dict.fromkeys(("XSIZE", "YSIZE"), "length"),
    "DEFECTAREA": "area",
    "DSIZE": "length",
    **dict.fromkeys(("CLASSNUMBER", "TEST", "CLUSTERNUMBER", "ROUGHBINNUMBER", "FINEBINNUMBER"), "count"),
    "HEIGHT": "length",
}
IMAGE_COLUMNS = ("IMAGECOUNT", "IMAGELIST")
NM_PER_UM = 1000.0
SUMMARY_COLUMNS = ("TESTNO", "NDEFECT", "DEFDENSITY", "NDIE", "NDEFDIE")
MM2_PER_CM2, UM2_PER_MM2, STANDARD_MM = 100.0, 1e6, 300.0


def write_klarf(
    inspection: Inspection,
    path: str | Path,
    sample: Sample = Sample(),
    *,
    center_um: tuple[float, float] = (0.0, 0.0),
    at: datetime | None = None,
    version: KlarfVersion = "1.2",
) -> Path:
    """Write the defects of an inspection to a KLARF file.

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
    version : {"1.2", "1.8"}, default "1.2"
        Version of the format.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    DatasetError
        When the inspection has no die grid, the version is another, or the file cannot be written.

    Notes
    -----
    Lengths are in um, in version 1.8 in whole nm. XREL and YREL are the centre of a defect relative to the lower left
    corner of its die, along the axes of the lattice; SampleCenterLocation is the wafer centre relative to the lower
    left corner of die 0,0. HEIGHT, signed, is an additional column that other readers ignore. The test plan contains
    only dies that were inspected completely or that have defects: a die that was not or only partly scanned must not
    appear clean. ROUGHBINNUMBER is the judgement: 0 open, 1 real, 2 nuisance.
    """
    if inspection.grid is None:
        raise DatasetError("KLARF gives places by dies and this inspection has none: give their pitch, or write a CSV.")
    if version not in _WRITERS:
        raise DatasetError(f"KLARF {version} is not written: choose one of {', '.join(_WRITERS)}.")
    text = "\n".join(_WRITERS[version](inspection, inspection.grid, sample, center_um, at or datetime.now()))
    write_text(Path(path), text + "\n")
    return Path(path)


def _flat_lines(
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
    stamp = " ".join(_stamp(at))
    yield "FileVersion 1 2;"
    yield f"FileTimestamp {stamp};"
    yield f"InspectionStationID {' '.join(map(_quoted, _station(inspection)))};"
    yield "SampleType WAFER;"
    yield f"ResultTimestamp {stamp};"
    yield f"LotID {_quoted(sample.lot)};"
    yield f"SampleSize 1 {_size_mm(sample):.0f};"
    yield f"DeviceID {_quoted(inspection.product or sample.product)};"
    yield f"SetupID {_quoted(inspection.recipe.name)} {stamp};"
    yield f"StepID {_quoted(inspection.reference)};"


def _lattice(grid: DieGrid, sample: Sample, center_um: tuple[float, float]) -> Iterator[str]:
    center_x_um, center_y_um = _center_from_die(grid, center_um)
    yield "SampleOrientationMarkType NOTCH;"
    yield f"OrientationMarkLocation {_notch(sample)};"
    yield f"DiePitch {grid.pitch_x_um:.6f} {grid.pitch_y_um:.6f};"
    yield "DieOrigin 0.000000 0.000000;"
    yield f"WaferID {_quoted(sample.wafer_id or sample.name)};"
    yield f"Slot {sample.slot};"
    yield f"SampleCenterLocation {center_x_um:.6f} {center_y_um:.6f};"


def _stamp(at: datetime) -> tuple[str, str]:
    return f"{at:%m-%d-%Y}", f"{at:%H:%M:%S}"


def _station(inspection: Inspection) -> tuple[str, str, str]:
    return "Wafer Viewer", _SIMULATED if inspection.simulated else "shape from focus", "0"


def _notch(sample: Sample) -> str:
    return "DOWN" if sample.notch == "none" else sample.notch.upper()


def _center_from_die(grid: DieGrid, center_um: tuple[float, float]) -> tuple[float, float]:
    """Return the centre of the wafer from the lower left corner of die 0,0, along the axes of the lattice."""
    col, row, u, v = _in_die(grid, *center_um)
    return col * grid.pitch_x_um + u, row * grid.pitch_y_um + v


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
    names = (*COLUMNS, *IMAGE_COLUMNS)
    yield f"DefectRecordSpec {len(names)} {' '.join(names)} ;"
    yield f"DefectList{'' if found else ';'}"
    yield from (f" {_record(defect, grid)}{';' if defect is found[-1] else ''}" for defect in found)


def _record(defect: Defect, grid: DieGrid) -> str:
    values = zip(COLUMNS.values(), _values(defect, grid), strict=True)
    return " ".join(f"{value}" if kind == "count" else f"{value:.3f}" for kind, value in values) + " 0 0"


def _values(defect: Defect, grid: DieGrid) -> tuple[float, ...]:
    """Return the values of a defect in the order of `COLUMNS`, in um and um2."""
    col, row, u, v = _in_die(grid, defect.center.x_um, defect.center.y_um)
    x0, y0, x1, y1 = defect.outline.bounds_um
    places, sizes = (defect.number, u, v, col, row), (x1 - x0, y1 - y0, defect.area.value, defect.major.value_um)
    labels = (CLASS_NUMBERS.get(defect.seen_as, 0), 1, 0, BINS[defect.judgement], 0)
    return *places, *sizes, *labels, defect.height.value_um


def _looked_at(inspection: Inspection) -> list[DieStatus]:
    """Return the dies whose defect state is known."""
    return [die for die in inspection.dies if die.defects or (die.state == "whole" and die.defects is not None)]


def _summary(inspection: Inspection) -> Iterator[str]:
    yield f"SummarySpec {len(SUMMARY_COLUMNS)} {' '.join(SUMMARY_COLUMNS)} ;"
    yield "SummaryList"
    yield f" {' '.join(_counts(inspection))};"


def _counts(inspection: Inspection) -> tuple[str, ...]:
    """Return the values of `SUMMARY_COLUMNS`: the density is per cm2."""
    found, plan = inspection.found, _looked_at(inspection)
    area_cm2 = inspection.inspected_mm2 / MM2_PER_CM2
    density = len(found) / area_cm2 if area_cm2 else 0.0
    return "1", str(len(found)), f"{density:.4f}", str(len(plan)), str(sum(bool(die.defects) for die in plan))


def _size_mm(sample: Sample) -> float:
    return max(sample.width_um or 0.0, sample.height_um or 0.0) / 1000 or STANDARD_MM


def _quoted(text: str) -> str:
    """Return a quoted text; double quotes in it become single ones, as KLARF cannot escape them."""
    return '"' + " ".join(text.replace('"', "'").split()) + '"'


# ---------------------------------------------------------------------------------------------------------- version 1.8


def _nested_lines(
    inspection: Inspection, grid: DieGrid, sample: Sample, center_um: tuple[float, float], at: datetime
) -> Iterator[str]:
    yield from _block(
        'Record FileRecord "1.8"',
        _field("FileTimestamp", *map(_quoted, _stamp(at))),
        *_block(
            f"Record LotRecord {_quoted(sample.lot)}",
            *_lot_fields(inspection, grid, sample, at),
            *_block(
                f"Record WaferRecord {_quoted(sample.wafer_id or sample.name)}",
                _field("DieOrigin", 0, 0),
                _field("OrientationInstructions", '""'),
                _field("SampleCenterLocation", *map(_nm, _center_from_die(grid, center_um))),
                _field("SlotNumber", sample.slot),
                *_wafer_lists(inspection, grid),
            ),
        ),
    )
    yield "EndOfFile;"


def _lot_fields(inspection: Inspection, grid: DieGrid, sample: Sample, at: datetime) -> Iterator[str]:
    classes = ((0, "Unclassified"), *((n, kind.capitalize()) for kind, n in CLASS_NUMBERS.items()))
    yield _field("InspectionStationID", *map(_quoted, _station(inspection)))
    yield _field("SampleType", '"WAFER"')
    yield _field("ResultTimestamp", *map(_quoted, _stamp(at)))
    yield _field("SampleSize", _nm(_size_mm(sample) * 1000), 0)
    yield _field("DeviceID", _quoted(inspection.product or sample.product))
    yield _field("RecipeID", *map(_quoted, (inspection.recipe.name, *_stamp(at))))
    yield _field("StepID", _quoted(inspection.reference))
    yield _field("SampleOrientationMarkType", '"NOTCH"')
    yield _field("OrientationMarkLocation", _quoted(_notch(sample)))
    yield _field("DiePitch", _nm(grid.pitch_x_um), _nm(grid.pitch_y_um))
    columns = ("int32 CLASSNUMBER", "string CLASSNAME", "string CLASSCODE")
    yield from _list("ClassLookupList", columns, [f'{n} {_quoted(name)} ""' for n, name in classes])


def _wafer_lists(inspection: Inspection, grid: DieGrid) -> Iterator[str]:
    columns = [f"{'float' if kind == 'area' else 'int32'} {name}" for name, kind in COLUMNS.items()]
    yield from _list("DefectList", columns, [_nested_record(defect, grid) for defect in inspection.found])
    yield from _block(
        'Record TestRecord "1"',
        _field("AreaPerTest", f"{inspection.inspected_mm2 * UM2_PER_MM2 * NM_PER_UM**2:.6e}"),
        *_list(
            "SampleTestPlanList",
            ("int32 XINDEX", "int32 YINDEX"),
            [f"{die.col} {die.row}" for die in _looked_at(inspection)],
        ),
    )
    columns = [f"{'float' if name == 'DEFDENSITY' else 'int32'} {name}" for name in SUMMARY_COLUMNS]
    yield from _block("Record SummaryRecord", *_list("TestSummaryList", columns, [" ".join(_counts(inspection))]))


def _nested_record(defect: Defect, grid: DieGrid) -> str:
    texts = {"count": str, "length": lambda um: str(_nm(um)), "area": lambda um2: f"{um2 * NM_PER_UM**2:.1f}"}
    return " ".join(texts[kind](value) for kind, value in zip(COLUMNS.values(), _values(defect, grid), strict=True))


def _nm(um: float) -> int:
    return round(um * NM_PER_UM)


def _block(head: str, *lines: str) -> Iterator[str]:
    yield head
    yield "{"
    yield from (f"  {line}" for line in lines)
    yield "}"


def _field(name: str, *values: str | int) -> str:
    return f"Field {name} {len(values)} {{{', '.join(map(str, values))}}}"


def _list(name: str, columns: Sequence[str], rows: Sequence[str]) -> Iterator[str]:
    named = f"Columns {len(columns)} {{ {', '.join(columns)} }}"
    yield from _block(f"List {name}", named, *_block(f"Data {len(rows)}", *(f"{row} ;" for row in rows)))


_WRITERS = {"1.2": _flat_lines, "1.8": _nested_lines}
