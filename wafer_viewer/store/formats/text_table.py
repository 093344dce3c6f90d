"""Surfaces as text: points, one line each, after header lines; or a matrix of heights, one line a row."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
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
from wafer_viewer.store.formats.text_lines import TextLayout, text_layout
from wafer_viewer.store.formats.text_matrix import read_matrix, states_matrix

_LEAST_POINT_BYTES = 6
"""Bytes of the shortest line: three digits, two delimiters and the line feed."""
_COLUMN = re.compile(r"^([a-z ]+?)(?:[_\s/]*(?:in\s+)?[\[(]?\s*([a-zµμ]+)\s*[\])]?)?$", re.IGNORECASE)
_AXES = {"x": "x", "y": "y", "z": "z", "height": "z", "depth": "depth", "origin": "origin"}


def write_csv(strips: Strips, path: Path) -> None:
    """Write x_um, y_um, z_um and the origin code, with a line of column names."""
    _write(strips, path, ",", ("x_um,y_um,z_um,origin",), with_origin=True)


def write_xyz(strips: Strips, path: Path) -> None:
    """Write x, y and z in um only."""
    _write(strips, path, " ", (), with_origin=False)


def read_table(path: Path, options: ReadOptions) -> HeightMap:
    """Read a surface as text: points by the columns x, y and z, or a matrix of heights, a line a row.

    Raises DatasetError where neither is sure.
    """
    layout = text_layout(path, options, _is_names)
    head = _head(layout, options)
    if head is None:
        return read_matrix(layout, options)
    points = PointCloud(
        lambda: _blocks(layout, head, options),
        _units(head, options),
        head.about,
        head.provenance,
        path.stat().st_size // _LEAST_POINT_BYTES,
    )
    return surface_of_points(points, options)


def _write(strips: Strips, path: Path, between: str, above: tuple[str, ...], *, with_origin: bool) -> None:
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"{_comment(line)}\n" for line in heading(strips))
        file.writelines(f"{line}\n" for line in above)
        for part in strips.maps():
            xs = [f"{x:.4f}{between}" for x in part.x_um]
            for row, y_um in enumerate(part.y_um):
                file.write(_line(part, row, xs, f"{y_um:.4f}{between}", between if with_origin else ""))


def _comment(line: str) -> str:
    """Return a comment of other than 3 or 6 words, which MeshLab would take for a point."""
    comment = f"# {line}"
    return comment + _FILLER if len(comment.split()) in (3, 6) else comment


_FILLER = " #"


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
    """Column indices by quantity, and their units."""

    columns: dict[str, int]
    units: dict[str, str]
    about: EmbeddedMetadata | None
    provenance: Provenance | None


def _head(layout: TextLayout, options: ReadOptions) -> _Head | None:
    """Return the columns of points; None for a matrix."""
    parts, texts = defaultdict[str, list[str]](list), list[str]()
    for line in (comment.removesuffix(_FILLER) for comment in layout.comments):
        name, _, value = line.partition(":")
        parts[name.strip().lower()].append(value.strip())
        texts += [] if name.strip() == OURS else [line]
    comments = {name: "".join(values) for name, values in parts.items()}
    about = parse_metadata(embedded := comments.get(OURS.lower()))
    named = next((line for line in (*layout.header[-1:], "") if _is_names(line)), "")
    if about is None and not named and _is_matrix(layout, options):
        return None
    columns, units = _names(_cells_of_names(named), layout.n_columns, options)
    if (unit := comments.get("unit")) is not None:
        _require_consistent_units(units, unit, options)
        units = units or dict.fromkeys("xyz", unit)
    return _Head(columns, units, about, provenance_of(about, embedded, *texts))


_FEWEST_FOR_MATRIX = 16
"""Columns without names that are certainly no points with colours, normals and the like."""
_LONGEST_MATRIX = 50
"""Rows for one column of a matrix, at most; points have more."""


def _is_matrix(layout: TextLayout, options: ReadOptions) -> bool:
    """Return whether columns without names are rows of heights. Raises DatasetError if they may be points, too."""
    n_columns, wanted = layout.n_columns, options.overrides.table
    if wanted is not None or n_columns >= _FEWEST_FOR_MATRIX or states_matrix(layout):
        return wanted != "points"
    if n_columns <= len("xyz") or layout.path.suffix.lower() == ".xyz":
        return False
    n_lines = layout.path.stat().st_size / max(1.0, float(np.mean([len(line) for line in layout.sample])))
    x, y = layout.numbers(list(layout.sample), [0, 1], options).T
    repeats = max(len(x) / len(np.unique(x)), len(y) / len(np.unique(y)))
    if n_lines > _LONGEST_MATRIX * n_columns or (repeats >= 2 and len(set(zip(x, y, strict=True))) == len(x)):
        raise options.refuse(
            f"has {n_columns} columns without names: name three of them x_um, y_um and z_um if its lines are points, "
            "or give --table matrix if they are rows of heights."
        )
    return True


def _is_names(line: str) -> bool:
    """Return whether a line names columns of coordinates."""
    return len({"x", "y", "z", "depth"}.intersection(axis for axis, _ in map(_axis, _cells_of_names(line)))) >= 2


def _cells_of_names(line: str) -> list[str]:
    cells = re.split(r"[,;\t]", line.strip().lstrip("# "))
    return cells if len(cells) > 1 else cells[0].split()


def _axis(cell: str) -> tuple[str, str]:
    """Return the quantity and the unit of a column by its name, empty if it is another."""
    match = _COLUMN.match(cell.strip().strip('"').strip())
    axis = _AXES.get(match[1].strip().lower(), "") if match else ""
    return axis, (match[2] or "") if match and axis else ""


def _names(cells: list[str], n_columns: int, options: ReadOptions) -> tuple[dict[str, int], dict[str, str]]:
    """Return columns and units from the line of names; the first three columns without one."""
    if not cells:
        if n_columns < len("xyz"):
            raise options.refuse("has fewer than three columns: give a table with x, y and z.")
        return {"x": 0, "y": 1, "z": 2}, {}
    columns, units = dict[str, int](), dict[str, str]()
    for index, cell in enumerate(cells):
        axis, unit = _axis(cell)
        if axis and axis not in columns:
            columns[axis], units[axis] = index, unit
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


def _blocks(layout: TextLayout, head: _Head, options: ReadOptions) -> Iterator[Block]:
    wanted = {axis: head.columns[axis] for axis in ("x", "y", "z", "origin") if axis in head.columns}
    for numbers in layout.blocks(list(wanted.values()), options):
        yield {axis: numbers[:, index] for index, axis in enumerate(wanted)}
