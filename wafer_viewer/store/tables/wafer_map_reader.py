"""Reader of wafer maps: SEMI E142 (XML) and SINF (text)."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

from wafer_viewer.model.acquisition.sample import Notch
from wafer_viewer.model.errors import DatasetError, detail, parser_errors_as
from wafer_viewer.model.inspection.wafer_map import DieQuality, MapDie, Place, WaferMap
from wafer_viewer.store.io.guarded_reading import read_content
from wafer_viewer.store.tables.wafer_map import (
    E142_NOTCH_DEG,
    FIRST_DIE,
    SINF_NOT_INSPECTED,
    SINF_NOTCH_DEG,
    SINF_NULL,
)

UM_PER: dict[str, float] = {"um": 1.0, "micron": 1.0, "microns": 1.0, "mm": 1e3, "mil": 25.4, "inch": 25_400.0}
CODE_LETTERS = {"ascii": 1, "hexadecimal": 2, "decimal": 3, "integer2": 4}
"""Letters of a bin code by the BinType of SEMI E142."""
E142_QUALITIES: dict[str, DieQuality] = {"pass": "pass", "fail": "fail"}
SINF_NULLS = (SINF_NULL, "--", "..")
_FIRST_DIE = re.compile(re.escape(FIRST_DIE).replace(r"\{\}", r"(-?\d+),(-?\d+)"))
MOST_PLACES = 4_000_000
Table = list[tuple[str, ...]]


def is_wafer_map(path: Path) -> bool:
    """Return whether a file looks like a wafer map: XML, or lines of RowData."""
    content = read_content(path)
    return content.lstrip(b"\xef\xbb\xbf \r\n\t").startswith(b"<") or b"rowdata:" in content.lower()


def read_wafer_map(path: str | Path) -> WaferMap:
    """Read a wafer map, SEMI E142 or SINF.

    Parameters
    ----------
    path : str or Path
        XML of SEMI E142 with one substrate map and one overlay of bin codes, or a SINF text.

    Returns
    -------
    WaferMap
        Bin code and quality of each die by its column from the left and row from the bottom of the map, with the
        notch, pitch and size of the dies as far as the file states them.

    Raises
    ------
    DatasetError
        When the file cannot be read, is of neither format or damaged, holds several maps, or has other numbers of rows,
        columns or dies than it states.

    References
    ----------
    SEMI E142, Specification for Substrate Mapping. SINF: Simplified Integrator Nested Format.
    """
    place = Path(path)
    content = read_content(place)
    try:
        with parser_errors_as(lambda fault: DatasetError(f"it has a damaged record{detail(fault)}: export it again.")):
            text = content.decode("utf-8-sig")
            return _e142(text) if text.lstrip().startswith("<") else _sinf(text)
    except DatasetError as fault:
        raise DatasetError(f"{place.name}: {fault}") from fault


# ----------------------------------------------------------------------------------------------------------------- E142


def _e142(text: str) -> WaferMap:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise DatasetError("it defines entities, which wafer maps do not have: export it again.")
    root = ET.fromstring(text)
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    found = root.findall(".//SubstrateMap")
    codes = root.findall(".//SubstrateMap/Overlay/BinCodeMap")
    if len(found) != 1 or len(codes) != 1:
        raise DatasetError(f"it has {len(codes)} maps of bin codes where 1 is expected: export one wafer to a file.")
    whole, bins = found[0], codes[0]
    rows = _upright(_e142_rows(bins), whole.get("OriginLocation", "UpperLeft"))
    names = {element.get("BinCode", ""): element for element in bins.iter("BinDefinition")}
    null = bins.get("NullBin", "")

    def die(col: int, row: int, code: str) -> MapDie | None:
        quality = names[code].get("BinQuality", "") if code in names else ""
        return None if code == null else MapDie(col=col, row=row, code=code, quality=_quality(quality))

    layout = _layout(root, whole.get("LayoutSpecifier", ""))
    pitch, size = _lengths(layout, "StepSize"), _lengths(layout, "DeviceSize")
    turn = int(whole.get("Orientation", "0"))
    return WaferMap(
        format="e142",
        lot=root.findtext(".//Substrate/LotId", ""),
        wafer=whole.get("SubstrateId", ""),
        product=layout.findtext("ProductId", "") if layout is not None else "",
        notch=_notch(E142_NOTCH_DEG, turn),
        cols=len(rows[0]),
        rows=len(rows),
        pitch_x_um=pitch[0],
        pitch_y_um=pitch[1],
        width_um=size[0],
        height_um=size[1],
        dies=tuple(found for place in _places(rows) if (found := die(*place)) is not None),
        codes=tuple((code, element.get("BinDescription", "")) for code, element in names.items()),
        reference=_reference(text, len(rows)),
    )


def _quality(word: str) -> DieQuality:
    return E142_QUALITIES.get(word.lower(), "skip")


def _e142_rows(bins: ET.Element) -> Table:
    kind = bins.get("BinType", "HexaDecimal")
    if (letters := CODE_LETTERS.get(kind.lower())) is None:
        raise DatasetError(f"its BinType is {kind}, not one of {', '.join(CODE_LETTERS)}: export it again.")
    rows: Table = []
    for element in bins.findall("BinCode"):
        text = "".join((element.text or "").split())
        if len(text) % letters:
            raise DatasetError(f"row {len(rows) + 1} of its bins has {len(text)} letters, {letters} to a code.")
        rows.append(tuple(text[k : k + letters] for k in range(0, len(text), letters)))
    return _rectangular(rows)


def _rectangular(rows: Table) -> Table:
    widths = {len(row) for row in rows}
    if len(widths) != 1 or 0 in widths:
        raise DatasetError("its rows are not equally long: export it again.")
    if len(rows) * len(rows[0]) > MOST_PLACES:
        raise DatasetError(f"it has {len(rows)} x {len(rows[0])} places, and at most {MOST_PLACES} are read.")
    return rows


def _upright(rows: Table, origin: str) -> Table:
    """Return the rows from the top down and from the left, of a map that begins at another corner."""
    match origin.lower():
        case "upperleft":
            return rows
        case "upperright":
            return [row[::-1] for row in rows]
        case "lowerleft":
            return rows[::-1]
        case "lowerright":
            return [row[::-1] for row in rows[::-1]]
        case _:
            raise DatasetError(f"its OriginLocation is {origin}, which is no corner: export it from the upper left.")


def _places(rows: Table) -> Iterator[tuple[int, int, str]]:
    """Yield column, row from the bottom, and code of each place."""
    for k, row in enumerate(rows):
        yield from ((col, len(rows) - 1 - k, code) for col, code in enumerate(row))


def _layout(root: ET.Element, specifier: str) -> ET.Element | None:
    """Return the layout of the dies: the last one that the map names, else the only one."""
    layouts = root.findall(".//Layout")
    named = [element for element in layouts if element.get("LayoutId") == specifier.rpartition("/")[2]]
    return next(iter(named or layouts[-1:]), None)


def _lengths(layout: ET.Element | None, name: str) -> tuple[float, float]:
    """Return a length along x and y in um; 0 if not stated."""
    element = layout.find(name) if layout is not None else None
    if layout is None or element is None:
        return 0.0, 0.0
    um = _unit(element.get("Units") or layout.get("DefaultUnits") or "mm")
    return float(element.get("X", "0")) * um, float(element.get("Y", "0")) * um


def _unit(name: str) -> float:
    if name.lower() not in UM_PER:
        raise DatasetError(f"its unit is {name!r}, not one of {', '.join(UM_PER)}: export it in mm.")
    return UM_PER[name.lower()]


def _notch(degrees: dict[Notch, int], turn: int) -> Notch:
    known: dict[int, Notch] = {angle: notch for notch, angle in degrees.items()}
    return known.get(turn % 360, "none")


def _reference(text: str, n_rows: int) -> Place | None:
    """Return the place of die 0,0 from the lower left; None in maps of other programs."""
    found = _FIRST_DIE.search(text)
    return (-int(found[1]), n_rows - 1 - int(found[2])) if found is not None else None


# ----------------------------------------------------------------------------------------------------------------- SINF


def _sinf(text: str) -> WaferMap:
    pairs = [(name.strip().upper(), value.strip()) for name, _, value in (ln.partition(":") for ln in text.split("\n"))]
    rows = [tuple(value.split()) for name, value in pairs if name == "ROWDATA"]
    header = {name: value for name, value in pairs if name != "ROWDATA"}
    if not rows:
        raise DatasetError("it is neither XML nor has it lines of RowData: choose a wafer map, E142 or SINF.")
    rows = _rectangular(rows)
    _require_stated(header, rows)
    good = header.get("BCEQU", "").split()

    def quality(code: str) -> DieQuality:
        judged: DieQuality = "pass" if code in good else "fail"
        return "skip" if code == SINF_NOT_INSPECTED or not good else judged

    um = _unit(header.get("DUTMS") or "mm")
    return WaferMap(
        format="sinf",
        lot=header.get("LOT", ""),
        wafer=header.get("WAFER", ""),
        product=header.get("DEVICE", ""),
        notch=_notch(SINF_NOTCH_DEG, int(header["FNLOC"])) if header.get("FNLOC") else "none",
        cols=len(rows[0]),
        rows=len(rows),
        pitch_x_um=float(header.get("XDIES") or 0) * um,
        pitch_y_um=float(header.get("YDIES") or 0) * um,
        dies=tuple(
            MapDie(col=col, row=row, code=code, quality=quality(code))
            for col, row, code in _places(rows)
            if code not in SINF_NULLS
        ),
        reference=_reference(header.get("COMMENT", ""), len(rows)),
    )


def _require_stated(header: dict[str, str], rows: Sequence[tuple[str, ...]]) -> None:
    """Raise DatasetError for other numbers of rows or columns than stated."""
    for name, n in (("ROWCT", len(rows)), ("COLCT", len(rows[0]))):
        if header.get(name) and int(header[name]) != n:
            raise DatasetError(f"it states {name} {header[name]} and has {n}: export it again.")
