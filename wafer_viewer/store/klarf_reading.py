"""KLARF 1.0 to 1.2 read: every record counted, units held against the sizes they must have."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.klarf import Klarf, KlarfDefect

KlarfUnit = Literal["um", "nm", "mm"]
UM_PER: dict[str, float] = {"um": 1.0, "nm": 1e-3, "mm": 1e3}
VERSIONS = ("1.0", "1.1", "1.2")
NEEDED = ("DEFECTID", "XREL", "YREL", "XINDEX", "YINDEX")
LEAST_PITCH_UM = 50.0
"""No die is smaller: a file that says so is in another unit."""
_TOKEN = re.compile(r'"([^"]*)"|([^\s"]+)')
_LENGTHS = {"width_um": "XSIZE", "height_um": "YSIZE", "size_um": "DSIZE"}
_COUNTS = {"class_number": "CLASSNUMBER", "bin": "ROUGHBINNUMBER", "test": "TEST"}


@dataclass(frozen=True, slots=True)
class Record:
    """One record, from its keyword to its semicolon: the words of each of its lines, the keyword left out."""

    lines: tuple[tuple[str, ...], ...]

    @property
    def words(self) -> tuple[str, ...]:
        """All of them in order."""
        return tuple(word for line in self.lines for word in line)


def read_klarf(path: str | Path, unit: KlarfUnit | None = None) -> Klarf:
    """Read a KLARF file of one wafer; `unit` of its lengths where the file does not say, um by default.

    Raises DatasetError where it is cut off, lacks records, is in another unit, or is not KLARF 1.0 to 1.2.
    """
    place = Path(path)
    records = _records(place, _text(place))
    try:
        um, notes = _um_per_unit(records, unit)
        klarf = Klarf(**_facts(records, um), defects=tuple(_defects(records, um)), notes=notes)
        _require_all(records, klarf)
        _require_plausible(klarf)
    except DatasetError as fault:
        raise DatasetError(f"{place.name}: {fault}") from fault
    except (ValueError, IndexError) as fault:
        raise DatasetError(f"{place.name} has a damaged record ({fault}): export it again.") from fault
    return klarf if "SummaryList" in records else _unchecked(klarf)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError as fault:
        raise DatasetError(f"{path} does not exist: check the path.") from fault
    except OSError as fault:
        raise DatasetError(f"{path} cannot be read: {fault.strerror}.") from fault


def _records(path: Path, text: str) -> dict[str, Record]:
    """The records by their keywords; a keyword that comes again is kept as it came last, wafers apart."""
    if not text.lstrip().startswith("FileVersion"):
        raise DatasetError(f"{path.name} is no KLARF file: it does not begin with FileVersion.")
    if "EndOfFile" not in text[-200:]:
        raise DatasetError(f"{path.name} is cut off, it has no EndOfFile: copy or export it again.")
    found: dict[str, Record] = {}
    for record in _split(text):
        lines = tuple(words for line in record.splitlines() if (words := _words(line)))
        if not lines:
            continue
        keyword = lines[0][0]
        if keyword == "WaferID" and keyword in found:
            raise DatasetError(f"{path.name} holds several wafers: export one wafer to a file.")
        found[keyword] = Record((lines[0][1:], *lines[1:]))
    return found


def _split(text: str) -> Iterator[str]:
    """At the semicolons that are not within quotation marks."""
    return (part for part in re.findall(r'(?:"[^"]*"|[^;"])+', text) if part.strip())


def _words(line: str) -> tuple[str, ...]:
    return tuple(quoted or plain for quoted, plain in _TOKEN.findall(line))


def _um_per_unit(records: dict[str, Record], unit: KlarfUnit | None) -> tuple[float, tuple[str, ...]]:
    """How many um one of its units is; what it says itself goes before what was asked."""
    version = ".".join(records["FileVersion"].words[:2])
    if version not in VERSIONS:
        raise DatasetError(f"it is KLARF {version} and not one of {', '.join(VERSIONS)}: export it as 1.2.")
    said = next((records[name].words[0].lower() for name in ("Units", "Unit") if name in records), "")
    if said and unit and said != unit:
        raise DatasetError(f"it says that its unit is {said}, not {unit}: leave the unit out.")
    used = said or unit or "um"
    if used not in UM_PER:
        raise DatasetError(f"its unit is {used!r}, not one of {', '.join(UM_PER)}: export it in um.")
    return UM_PER[used], () if used == "um" else (f"Lengths were converted from {used} to um.",)


def _facts(records: dict[str, Record], um: float) -> dict[str, Any]:
    """The header; pitch and defects are needed, what else is left out stays empty."""
    for keyword in ("DiePitch", "DefectRecordSpec", "DefectList"):
        if keyword not in records:
            raise DatasetError(f"it has no record {keyword}: export it again.")
    pitch, center = _numbers(records, "DiePitch"), _numbers(records, "SampleCenterLocation") or (0.0, 0.0)
    area, size = _numbers(records, "AreaPerTest") or (0.0,), _numbers(records, "SampleSize") or (0.0, 0.0)
    return {
        "version": ".".join(records["FileVersion"].words[:2]),
        **{name: _first(records, key) for name, key in _NAMES.items()},
        "notch": _first(records, "OrientationMarkLocation") or "DOWN",
        "slot": int(_first(records, "Slot") or 0),
        "sample_mm": size[1],
        "pitch_x_um": pitch[0] * um,
        "pitch_y_um": pitch[1] * um,
        "center_x_um": center[0] * um,
        "center_y_um": center[1] * um,
        "inspected_um2": area[0] * um**2,
        "classes": _classes(records),
        "dies": _pairs(records),
    }


_NAMES = {"lot": "LotID", "wafer": "WaferID", "device": "DeviceID", "setup": "SetupID", "step": "StepID"}


def _first(records: dict[str, Record], keyword: str) -> str:
    return records[keyword].words[0] if keyword in records and records[keyword].words else ""


def _numbers(records: dict[str, Record], keyword: str) -> tuple[float, ...]:
    return tuple(float(word) for word in records[keyword].words) if keyword in records else ()


def _classes(records: dict[str, Record]) -> tuple[tuple[int, str], ...]:
    words = records["ClassLookup"].words[1:] if "ClassLookup" in records else ()
    return tuple((int(n), name) for n, name in zip(words[::2], words[1::2], strict=False))


def _pairs(records: dict[str, Record]) -> tuple[tuple[int, int], ...]:
    """The dies of the test plan."""
    words = records["SampleTestPlan"].words if "SampleTestPlan" in records else ("0",)
    named = tuple((int(col), int(row)) for col, row in zip(words[1::2], words[2::2], strict=False))
    if len(named) != int(words[0]):
        raise DatasetError(f"its test plan names {len(named)} of {words[0]} dies: export it again.")
    return named


def _defects(records: dict[str, Record], um: float) -> Iterator[KlarfDefect]:
    columns = records["DefectRecordSpec"].words[1:]
    if lacking := [name for name in NEEDED if name not in columns]:
        raise DatasetError(f"its defects have no {lacking[0]}: export it with {', '.join(NEEDED)}.")
    names, images = dict(_classes(records)), 0
    least = len(columns) - ("IMAGELIST" in columns)
    for n, words in enumerate(filter(None, records["DefectList"].lines), 1):
        if len(words) < least:
            if images:  # lines below a defect list its images
                continue
            raise DatasetError(f"line {n} of its defects has {len(words)} of {least} numbers: export it again.")
        values = dict(zip(columns, words, strict=False))
        images = int(values.get("IMAGECOUNT", 0))
        yield _defect(values, names, um)


def _defect(values: dict[str, str], names: dict[int, str], um: float) -> KlarfDefect:
    lengths = {field: float(values.get(name, 0)) * um for field, name in _LENGTHS.items()}
    counts = {field: int(values[name]) for field, name in _COUNTS.items() if name in values}
    return KlarfDefect(
        number=int(values["DEFECTID"]),
        col=int(values["XINDEX"]),
        row=int(values["YINDEX"]),
        u_um=float(values["XREL"]) * um,
        v_um=float(values["YREL"]) * um,
        area_um2=float(values.get("DEFECTAREA", 0)) * um**2,
        class_name=names.get(counts.get("class_number", 0), ""),
        **lengths,
        **counts,  # pyright: ignore[reportArgumentType]
    )


def _require_all(records: dict[str, Record], klarf: Klarf) -> None:
    """Raise DatasetError where the summary counts other defects than are listed."""
    if "SummaryList" not in records:
        return
    width = int(_first(records, "SummarySpec") or 5)
    columns = records["SummarySpec"].words[1:] if "SummarySpec" in records else ("TESTNO", "NDEFECT")
    counts = records["SummaryList"].words[columns.index("NDEFECT") :: width]
    said, there = sum(int(float(count)) for count in counts), len(klarf.defects)
    if said != there:
        raise DatasetError(f"its summary counts {said} defects and {there} are listed: export it again.")


def _require_plausible(klarf: Klarf) -> None:
    """Raise DatasetError where lengths cannot be um."""
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
    from wafer_viewer.model.spec import replace

    note = "The file has no summary: whether records are missing cannot be told."
    return replace(klarf, notes=(*klarf.notes, note))
