"""Places of fields as people have them: running numbers along a grid, and tables of tiles.

Tables: Fiji's TileConfiguration, MIST's global positions, Micro-Manager's position list, and CSV with a header.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wafer_viewer.model.acquisition.image_source import ImageOptions, Mirror
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.images.image_files import NOTHING_WRITTEN
from wafer_viewer.store.images.name_pattern import Cell

_FIJI = re.compile(r"^(?P<name>[^;#]+);[^;]*;\s*\((?P<x>[^,()]+),(?P<y>[^,()]+)(?:,[^()]+)?\)\s*$")
_MIST = re.compile(r"^file:\s*(?P<name>[^;]+);.*position:\s*\((?P<x>[^,()]+),(?P<y>[^,()]+)\)")
_LENGTH = re.compile(
    r"^(?:pos(?:ition)?[\s_]*)?(?P<axis>[xy])[\s_]*[\[(]?\s*(?P<unit>px|pixels?|nm|um|µm|μm|mm)\s*[\])]?$"
)
_NAME, _NUMBER = ("file", "name", "filename", "tile", "image", "label"), ("n", "number", "index", "series")
_ROW, _COL = ("row", "r"), ("col", "column", "c")
_UM = {"nm": 1e-3, "um": 1.0, "µm": 1.0, "μm": 1.0, "mm": 1e3}
_SHOWN = 3


@dataclass(frozen=True, slots=True)
class TilePlace:
    """Place of a tile: in um on the stage, y up; or in px of the mosaic, y down, if `in_px`."""

    x: float
    y: float
    in_px: bool = False

    def um(self, pixel_um: float) -> tuple[float, float]:
        """Return x and y on the stage in um."""
        return (self.x * pixel_um, -self.y * pixel_um) if self.in_px else (self.x, self.y)


# --- running numbers


def numbered_cells(numbers: Sequence[int], options: ImageOptions) -> dict[int, Cell]:
    """Return row, from the top, and column of each running number, by the choices of the user.

    Raises
    ------
    DatasetError
        If the order needs the number of columns and it is not given.
    """
    first, n = min(numbers), max(numbers) - min(numbers) + 1
    columns = options.columns
    if columns is None:
        if options.order != "rows" or options.corner != "top-left":
            raise DatasetError(f"The fields are numbered along {options.order}: say how many --columns the grid has.")
        columns = n
    rows = -(-n // columns)
    return {number: _cell(number - first, rows, columns, options) for number in numbers}


def _cell(n: int, rows: int, columns: int, options: ImageOptions) -> Cell:
    along_rows = options.order.endswith("rows")
    line, at = divmod(n, columns if along_rows else rows)
    if options.order.startswith("snake") and line % 2:
        at = (columns if along_rows else rows) - 1 - at
    row, col = (line, at) if along_rows else (at, line)
    return (
        rows - 1 - row if options.corner.startswith("bottom") else row,
        columns - 1 - col if options.corner.endswith("right") else col,
    )


def mirrored(x: float, y: float, mirror: Mirror) -> tuple[float, float]:
    """Return a place with the axes reversed that the user has mirrored."""
    return (-x if mirror in ("x", "both") else x, -y if mirror in ("y", "both") else y)


# --- tables


def places_of(path: Path) -> dict[str, TilePlace]:
    """Return the places of a table by file name, label, ``n`` or ``row,col``.

    Raises
    ------
    DatasetError
        If the file cannot be read, is no table of places, or a line of it is damaged.
    """
    try:
        text = path.read_text("utf-8-sig", errors="replace")
    except OSError as fault:
        raise DatasetError(f"{path} cannot be read ({fault.strerror}): check the path of --places.") from fault
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    readers: tuple[Callable[[list[str]], Iterator[tuple[str, TilePlace]]], ...] = (_in_px(_FIJI), _in_px(_MIST))
    found: dict[str, TilePlace] = {}
    if text.lstrip().startswith("{"):
        pairs = list(_micro_manager(text, path.name))
    else:
        pairs = next((pairs for read in readers if (pairs := list(read(lines)))), None) or list(_csv(lines, path.name))
    for key, place in pairs:
        if key in found and found[key] != place:
            raise DatasetError(f"{path.name} has two places for {key}: take one out. {NOTHING_WRITTEN}")
        found[key] = place
    return found


def matched(places: Mapping[str, TilePlace], names: Sequence[Sequence[str]], table: str) -> list[TilePlace]:
    """Return the place of each field, which the table may call by any of its names.

    Raises
    ------
    DatasetError
        If the table lacks a field.
    """
    keys = {key.casefold(): place for key, place in places.items()}
    found = [next((keys[name.casefold()] for name in own if name.casefold() in keys), None) for own in names]
    lacking = [own[0] for own, place in zip(names, found, strict=True) if place is None]
    if lacking:
        shown = ", ".join(lacking[:_SHOWN]) + (" ..." if len(lacking) > _SHOWN else "")
        raise DatasetError(
            f"{table} has no place for {shown}; it names {', '.join(list(places)[:_SHOWN])} ... . {NOTHING_WRITTEN} "
            "Name the files as they are called, or leave those out with --only."
        )
    return [place for place in found if place is not None]


def _in_px(line_of: re.Pattern[str]) -> Callable[[list[str]], Iterator[tuple[str, TilePlace]]]:
    def read(lines: list[str]) -> Iterator[tuple[str, TilePlace]]:
        for line in lines:
            if (match := line_of.match(line)) is not None:
                yield Path(match["name"].strip()).name, TilePlace(float(match["x"]), float(match["y"]), in_px=True)

    return read


def _micro_manager(text: str, name: str) -> Iterator[tuple[str, TilePlace]]:
    """Yield the places of a position list, of Micro-Manager 1.4 or 2."""
    try:
        known = json.loads(text)
        if "POSITIONS" in known:
            for one in known["POSITIONS"]:
                stage = next(device for device in one["DEVICES"] if device["AXES"] == 2)
                yield one["LABEL"], TilePlace(float(stage["X"]), float(stage["Y"]))
            return
        for one in known["map"]["StagePositions"]["array"]:
            devices = [device["Position_um"]["array"] for device in one["DevicePositions"]["array"]]
            x_um, y_um = next(values for values in devices if len(values) == 2)
            yield one["Label"]["scalar"], TilePlace(float(x_um), float(y_um))
    except (ValueError, KeyError, TypeError, StopIteration, RuntimeError) as fault:
        raise DatasetError(f"{name} is no position list of Micro-Manager: save it anew, or give a CSV.") from fault


def _csv(lines: list[str], name: str) -> Iterator[tuple[str, TilePlace]]:
    heading = lines[0] if lines else ""
    separator = max(";\t,", key=heading.count)
    rows = list(csv.reader(lines, delimiter=separator))
    words = [word.strip().casefold() for word in rows[0]] if rows else []
    lengths = {match["axis"]: (n, match["unit"]) for n, word in enumerate(words) if (match := _LENGTH.match(word))}
    key_of = _key_columns(words)
    if len(lengths) < 2 or key_of is None:
        raise DatasetError(
            f"{name} is no table of places: its first line names the columns 'file' (or 'n', or 'row' and 'col') and "
            "'x_um' and 'y_um' (or 'x_px' and 'y_px')."
        )
    for number, row in enumerate(rows[1:], 2):
        try:
            key = ",".join(row[n].strip() if len(key_of) == 1 else str(int(row[n])) for n in key_of)
            x, y = (float(row[lengths[axis][0]].replace(",", ".")) for axis in "xy")
        except (ValueError, IndexError) as fault:
            raise DatasetError(f"{name}, line {number}: {separator.join(row)!r} has no place: mend it.") from fault
        unit = lengths["x"][1]
        in_px = unit.startswith("p")
        scale = 1.0 if in_px else _UM[unit]
        yield Path(key).name if len(key_of) == 1 else key, TilePlace(x * scale, y * scale, in_px)


def _key_columns(words: list[str]) -> tuple[int, ...] | None:
    def column(names: tuple[str, ...]) -> Any:
        return next((n for n, word in enumerate(words) if word in names), None)

    if (named := column(_NAME)) is not None:
        return (named,)
    row, col = column(_ROW), column(_COL)
    if row is not None and col is not None:
        return row, col
    return None if (number := column(_NUMBER)) is None else (number,)
