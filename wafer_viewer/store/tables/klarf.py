"""KLARF, the exchange format of inspection tools and yield systems: reader.

Lengths in um, in version 1.8 in nm. XREL and YREL are the centre of a defect relative to the lower left corner of its
die, along the axes of the lattice; SampleCenterLocation is the wafer centre relative to the lower left corner of die
0,0.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

from wafer_viewer.model.errors import DatasetError, detail, parser_errors_as
from wafer_viewer.model.inspection.klarf import Klarf, KlarfDefect, KlarfImage
from wafer_viewer.model.spec import replace
from wafer_viewer.store.io.guarded_reading import read_content
from wafer_viewer.store.tables.klarf_records import Records, column_names, parse_integer, read_records

KlarfUnit = Literal["um", "nm", "mm"]
UM_PER: dict[str, float] = {"um": 1.0, "nm": 1e-3, "mm": 1e3}
NEEDED = ("DEFECTID", "XREL", "YREL", "XINDEX", "YINDEX")
LEAST_PITCH_UM = 50.0
"""Least plausible die pitch; a smaller one means another unit."""
NOT_GIVEN = "NA"
"""Word for a number that is not known."""
SUMMARY_COLUMNS = ("TESTNO", "NDEFECT", "DEFDENSITY", "NDIE", "NDEFDIE")
_LENGTHS = {"width_um": "XSIZE", "height_um": "YSIZE", "size_um": "DSIZE"}
_COUNTS = {"class_number": "CLASSNUMBER", "bin": "ROUGHBINNUMBER", "test": "TEST"}
_YES, _NO = ("YES", "Y", "TRUE", "1"), ("NO", "N", "FALSE", "0")
SIMULATED = "SIMULATED"
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
        "simulated": "InspectionStationID" in records and SIMULATED in records["InspectionStationID"].words,
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
    tiff_file = _first(records, "TiffFileName")
    for listed in records.lists:
        if lacking := [name for name in NEEDED if name not in listed.columns]:
            raise DatasetError(f"its defects have no {lacking[0]}: export it with {', '.join(NEEDED)}.")
        if twice := [name for name in NEEDED if listed.columns.count(name) > 1]:
            raise DatasetError(f"its defects have two columns {twice[0]}: export it with one.")
        all_images = listed.images or ((),) * len(listed.rows)
        for row, words in zip(listed.rows, all_images, strict=True):
            values = {name: word for name, word in zip(listed.columns, row, strict=False) if word != NOT_GIVEN}
            images = _images(words, listed.tiff_file or tiff_file)
            found = replace(_defect(values, names, um, origin_um), images=images)
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
        **lengths,  # pyright: ignore[reportArgumentType]
        **counts,  # pyright: ignore[reportArgumentType]
    )


def _images(images: tuple[tuple[str, ...], ...], tiff_file: str) -> tuple[KlarfImage, ...]:
    """Return the images of a defect: "page kind" of the TIFF file, or "file format page kind"."""
    pages = [(tiff_file, words[0]) if words[0].isdecimal() else (words[0], *words[2:3]) for words in images]
    return tuple(
        KlarfImage(file=file, page=max(int(page[0]), 1) if page and page[0].isdecimal() else 1)
        for file, *page in pages
        if file
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
