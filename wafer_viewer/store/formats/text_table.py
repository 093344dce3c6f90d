"""CSV and XYZ: one line of text per measured pixel, after header lines that begin with #."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np

from wafer_viewer.model.surface.height_map import HeightMap, Provenance
from wafer_viewer.store.formats.point_gridding import Block, PointCloud, surface_of_points, units_of
from wafer_viewer.store.formats.reader_support import (
    OURS,
    EmbeddedMetadata,
    ReadOptions,
    heading,
    parse_metadata,
    provenance_of,
)
from wafer_viewer.store.formats.surface_strips import Strips

_BYTES_AT_A_TIME = 16_000_000
_LARGEST_HEADER = 16_000_000
_LEAST_POINT_BYTES = 6
"""Bytes of the shortest line: three digits, two delimiters and the line feed."""
_COLUMN = re.compile(r"^([a-z ]+?)(?:[_\s/]*[\[(]?\s*([a-zµμ]+)\s*[\])]?)?$", re.IGNORECASE)
_AXES = {"x": "x", "y": "y", "z": "z", "height": "z", "depth": "depth", "origin": "origin"}
_DELIMITERS = (",", ";", "\t", " ")


def write_csv(strips: Strips, path: Path) -> None:
    """Write x_um, y_um, z_um and the origin code, with a line of column names."""
    _write(strips, path, ",", ("x_um,y_um,z_um,origin",), with_origin=True)


def write_xyz(strips: Strips, path: Path) -> None:
    """Write x, y and z in um only."""
    _write(strips, path, " ", (), with_origin=False)


def read_table(path: Path, options: ReadOptions) -> HeightMap:
    """Read the surface sampled by the points of a table; x, y, z by name or as the first three columns."""
    head = _head(path, options)
    most_points = path.stat().st_size // _LEAST_POINT_BYTES
    points = PointCloud(
        lambda: _blocks(path, head, options), _units(head, options), head.about, head.provenance, most_points
    )
    return surface_of_points(points, options)


def _write(strips: Strips, path: Path, between: str, above: tuple[str, ...], *, with_origin: bool) -> None:
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"# {line}\n" for line in heading(strips))
        file.writelines(f"{line}\n" for line in above)
        for part in strips.maps():
            xs = [f"{x:.4f}{between}" for x in part.x_um]
            for row, y_um in enumerate(part.y_um):
                file.write(_line(part, row, xs, f"{y_um:.4f}{between}", between if with_origin else ""))


def _line(part: HeightMap, row: int, xs: list[str], y: str, before_origin: str) -> str:
    """Return the points of a row, each with its line break."""
    z_um = part.z_um[row]
    cols = np.flatnonzero(np.isfinite(z_um))
    ends = (
        [f"{before_origin}{code}\n" for code in part.origin[row][cols].tolist()]
        if before_origin
        else ["\n"] * len(cols)
    )
    heights = z_um[cols].tolist()
    return "".join([f"{xs[col]}{y}{z:.5f}{end}" for col, z, end in zip(cols.tolist(), heights, ends, strict=True)])


@dataclass(frozen=True, slots=True)
class _Head:
    """Column indices by quantity, their units, and the delimiter."""

    columns: dict[str, int]
    units: dict[str, str]
    delimiter: str
    about: EmbeddedMetadata | None
    provenance: Provenance | None
    begin: int


def _head(path: Path, options: ReadOptions) -> _Head:
    parts, texts, begin = defaultdict[str, list[str]](list), list[str](), 0
    with path.open("rb") as file:
        while begin < _LARGEST_HEADER and (raw := file.readline(_LARGEST_HEADER)):
            line = raw.decode("utf-8-sig" if begin == 0 else "utf-8", "replace").strip()
            if line and not line.startswith("#"):
                break
            begin += len(raw)
            name, _, value = line.lstrip("# ").partition(":")
            parts[name.strip().lower()].append(value.strip())
            texts += [] if name.strip() == OURS else [line]
        else:
            raise options.refuse("holds no points: give a table with the columns x, y and z.")
    comments = {name: "".join(values) for name, values in parts.items()}
    delimiter = next((d for d in _DELIMITERS if d in line), " ")
    cells = line.split(delimiter if delimiter != " " else None)
    columns, units = _names(cells, options)
    begin += 0 if _is_number(cells[0]) else len(raw)
    if (unit := comments.get("unit")) is not None:
        _require_consistent_units(units, unit, options)
        units = units or dict.fromkeys("xyz", unit)
    about = parse_metadata(embedded := comments.get(OURS.lower()))
    return _Head(columns, units, delimiter, about, provenance_of(about, embedded, *texts), begin)


def _names(cells: list[str], options: ReadOptions) -> tuple[dict[str, int], dict[str, str]]:
    """Return columns and units from the line of names; the first three columns without one."""
    if _is_number(cells[0]):
        if len(cells) < 3:
            raise options.refuse("has fewer than three columns: give a table with x, y and z.")
        return {"x": 0, "y": 1, "z": 2}, {}
    columns, units = dict[str, int](), dict[str, str]()
    for index, cell in enumerate(cells):
        match = _COLUMN.match(cell.strip().strip('"').strip())
        axis = _AXES.get(match[1].strip().lower()) if match else None
        if match and axis and axis not in columns:
            columns[axis] = index
            if match[2]:
                units[axis] = match[2]
    if "depth" in columns and "z" not in columns:
        options.require_heights_up("depth")
        columns["z"], units["z"] = columns.pop("depth"), units.get("depth", "")
    for axis in "xyz":
        if axis not in columns:
            raise options.refuse(f"has no column {axis}: name its columns x_um, y_um and z_um.")
    return columns, {axis: unit for axis, unit in units.items() if unit}


def _units(head: _Head, options: ReadOptions) -> tuple[float, float, float]:
    """Return the units of x, y and z in um, each from its own column."""
    if not head.units:
        return units_of(None, head.about, options)
    if missing := [axis for axis in "xyz" if axis not in head.units]:
        raise options.refuse(f"gives no unit for {' and '.join(missing)}: name its columns x_um, y_um, z_um.")
    x_um, y_um = (options.lateral_um(head.units[axis]) or 1.0 for axis in "xy")
    return x_um, y_um, options.z_scale_um(head.units["z"])


def _require_consistent_units(units: dict[str, str], named_unit: str, options: ReadOptions) -> None:
    """Raise DatasetError when the units of columns and comment contradict each other."""
    for axis, unit in units.items():
        if options.lateral_um(unit) != options.lateral_um(named_unit):
            raise options.refuse(f"states the unit {named_unit}, but its {axis} is in {unit}: correct the wrong one.")


def _blocks(path: Path, head: _Head, options: ReadOptions) -> Iterator[Block]:
    n_bytes = path.stat().st_size - head.begin
    wanted = {axis: head.columns[axis] for axis in ("x", "y", "z", "origin") if axis in head.columns}
    starts = list(range(0, n_bytes, _BYTES_AT_A_TIME))
    with path.open("rb") as file:
        file.seek(head.begin)
        for _ in options.watch(starts):
            lines = file.readlines(_BYTES_AT_A_TIME)
            try:
                numbers = np.loadtxt(
                    chain(lines),
                    delimiter=None if head.delimiter == " " else head.delimiter,
                    usecols=list(wanted.values()),
                    ndmin=2,
                )
            except ValueError as fault:
                raise options.refuse("has lines without numbers in the columns x, y and z: take them out.") from fault
            yield {axis: numbers[:, index] for index, axis in enumerate(wanted)}


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
