"""PLY: measured points, stage um as 64-bit floats, grey from the all-in-focus image, origin and confidence.

Points of a surface with uncertainties also have u_um, the standard uncertainty (k = 1) in um.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.store.formats.mesh_files import is_installed, read_mesh
from wafer_viewer.store.formats.point_gridding import (
    AT_A_TIME,
    Block,
    count,
    eight_bits,
    points_of,
    records,
    require_points,
    surface_of_comments,
    text_records,
)
from wafer_viewer.store.formats.reader_support import OURS, ReadOptions, heading, parse_metadata
from wafer_viewer.store.formats.surface_strips import Strips

_POINT = np.dtype([("xyz", "<f8", 3), ("rgb", "u1", 3), ("origin", "u1"), ("confidence", "<f4")])
_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
_LARGEST_HEADER = 1_000_000


def write_ply(strips: Strips, path: Path) -> None:
    """Write binary little-endian PLY."""
    properties = [
        *(f"double {c}" for c in "xyz"),
        *(f"uchar {c}" for c in ("red", "green", "blue", "origin")),
        "float confidence",
        *(["float u_um"] if strips.has_uncertainty else []),
    ]
    kind = np.dtype([*_POINT.descr, *([("u_um", "<f4")] if strips.has_uncertainty else [])])
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {line}" for line in heading(strips)),
        f"element vertex {count(strips, 0, 2)}",
        *(f"property {name}" for name in properties),
        "end_header",
    ]
    with path.open("wb") as file:
        file.write(("\n".join(header) + "\n").encode())
        for part in strips.maps(1, 2):
            rows, cols = np.nonzero(np.isfinite(part.z_um))
            points = np.empty(len(rows), kind)
            points["xyz"] = points_of(part, rows, cols)
            points["rgb"] = eight_bits(part.all_in_focus)[rows, cols, None]
            points["origin"], points["confidence"] = part.origin[rows, cols], part.confidence[rows, cols]
            if part.u_um is not None:
                points["u_um"] = part.u_um[rows, cols]
            file.write(points.tobytes())


def read_ply(path: Path, options: ReadOptions) -> HeightMap:
    """Read the surface sampled by the points of a PLY file, or by a mesh."""
    head = _head(path, options)
    if head.has_faces and parse_metadata(head.comments.get(OURS)) is None and is_installed():
        return read_mesh(path, options, head.comments.get("unit"))
    return surface_of_comments(lambda: _blocks(path, head, options), head.n_points, head.comments, options)


@dataclass(frozen=True, slots=True)
class _Head:
    order: str
    n_points: int
    fields: dict[str, str]
    comments: dict[str, str]
    begin: int
    has_faces: bool


def _head(path: Path, options: ReadOptions) -> _Head:
    with path.open("rb") as file:
        text, end, _ = file.read(_LARGEST_HEADER).partition(b"end_header\n")
    lines = text.decode("ascii", "replace").splitlines()
    if not end or not lines or lines[0].strip() != "ply":
        raise options.refuse("has no header of a PLY file: give a file that begins with 'ply'.")
    order, elements, fields, comments = "", list[str](), dict[str, str](), dict[str, str]()
    for line in lines[1:]:
        match line.split():
            case ["format", form, _] if form in _ORDERS:
                order = form
            case ["element", *_]:
                elements.append(line)
            case ["property", kind, name] if len(elements) == 1 and kind in _TYPES:
                fields[name] = _TYPES[kind]
            case ["property", *_] if len(elements) == 1:
                raise options.refuse("has a list among the properties of its points: write it with plain numbers.")
            case ["comment", *words]:
                name, _, value = " ".join(words).partition(":")
                comments[name.strip()] = comments.get(name.strip(), "") + value.strip()
            case _:
                pass
    n_points = elements[0].split()[-1] if elements and elements[0].split()[1:2] == ["vertex"] else ""
    if not order or not n_points.isdigit():
        raise options.refuse("does not begin with its points (element vertex): write it again with them first.")
    for axis in "xyz":
        if axis not in fields:
            raise options.refuse(f"has no {axis} among the properties of its points: write it with x, y and z.")
    require_points(path, int(n_points), options)
    has_faces = any(line.split()[1:2] == ["face"] and line.split()[-1] != "0" for line in elements)
    return _Head(order, int(n_points), fields, comments, len(text) + len(end), has_faces)


def _blocks(path: Path, head: _Head, options: ReadOptions) -> Iterator[Block]:
    starts = list(range(0, head.n_points, AT_A_TIME))
    fields = [(name, _ORDERS[head.order] + kind) for name, kind in head.fields.items()]
    read = text_records if head.order == "ascii" else records
    for block, _ in zip(read(path, head.begin, head.n_points, fields, options), options.watch(starts), strict=True):
        named = {name: block[name] for name in ("x", "y", "z", "origin", "confidence", "u_um") if name in head.fields}
        yield named | ({"grey": block["red"]} if head.fields.get("red") == "u1" else {})
