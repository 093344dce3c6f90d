"""KLARF 1.0 to 1.2 reader: record counts are verified, units are checked for plausibility.

Line breaks count as blanks, so the numbers of a defect may continue in the next line. There may be several defect lists
(one for each image or inspection test), each with the last preceding column specification.
"""

from __future__ import annotations

import codecs
import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.inspection.klarf import Klarf, KlarfDefect
from wafer_viewer.model.spec import replace

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
        um, notes = _um_per_unit(records, unit)
        notes += _notes(records)
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
        content = path.read_bytes()
    except FileNotFoundError as fault:
        raise DatasetError(f"{path} does not exist: check the path.") from fault
    except OSError as fault:
        raise DatasetError(f"{path} cannot be read: {fault.strerror}.") from fault
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
    said = next((records[name].words[0].lower() for name in ("Units", "Unit") if name in records), "")
    if said and unit and said != unit:
        raise DatasetError(f"it says that its unit is {said}, not {unit}: leave the unit out.")
    used = said or unit or "um"
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
        if pending and len(words) >= least and len(joined) > len(listed.columns):  # the next defect, whole by itself
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
    said = sum(_parse_integer(count) for summary in records.all("SummaryList") for count in summary.words[at::width])
    there = len(klarf.defects)
    if said != there:
        raise DatasetError(f"its summary counts {said} defects and {there} are listed: export it again.")


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
    note = "The file has no summary: whether records are missing cannot be told."
    return replace(klarf, notes=(*klarf.notes, note))
