"""PCD 0.7: measured points as 32-bit floats, x and y relative to the corner given in a comment.

Most programs that read PCD do not support 64-bit floats (Open3D reads zeros for them), and as 32-bit floats the stage
coordinates on a wafer would be off by a tenth of a pixel.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.store.formats.point_gridding import (
    AT_A_TIME,
    Block,
    count,
    points_of,
    records,
    require_points,
    surface_of_comments,
    text_records,
)
from wafer_viewer.store.formats.reader_support import OURS, ReadOptions, heading
from wafer_viewer.store.formats.surface_strips import Strips

_POINT = np.dtype([("xyz", "<f4", 3)])
_LARGEST_HEADER = 1_000_000
_KINDS = {"F": "f", "U": "u", "I": "i"}


def write_pcd(strips: Strips, path: Path) -> None:
    """Write binary PCD."""
    n_points, surface = count(strips, 0, 2), strips.surface
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        *(f"# {line}" for line in heading(strips)),
        f"# corner: {surface.x0_um!r} {surface.y0_um!r}",
        "VERSION 0.7",
        "FIELDS x y z",
        "SIZE 4 4 4",
        "TYPE F F F",
        "COUNT 1 1 1",
        f"WIDTH {n_points}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {n_points}",
        "DATA binary",
    ]
    corner = np.array([surface.x0_um, surface.y0_um, 0.0])
    with path.open("wb") as file:
        file.write(("\n".join(header) + "\n").encode())
        for part in strips.maps(1, 2):
            rows, cols = np.nonzero(np.isfinite(part.z_um))
            points = np.empty(len(rows), _POINT)
            points["xyz"] = points_of(part, rows, cols) - corner
            file.write(points.tobytes())


def read_pcd(path: Path, options: ReadOptions) -> HeightMap:
    """Read the surface sampled by the points of a PCD file."""
    head = _head(path, options)
    return surface_of_comments(lambda: _blocks(path, head, options), head.n_points, head.comments, options)


@dataclass(frozen=True, slots=True)
class _Head:
    form: str
    n_points: int
    fields: dict[str, str]
    comments: dict[str, str]
    corner: tuple[float, float]
    begin: int


def _head(path: Path, options: ReadOptions) -> _Head:
    header, comments, begin = dict[str, list[str]](), dict[str, str](), 0
    with path.open("rb") as file:
        while "DATA" not in header and begin < _LARGEST_HEADER and (line := file.readline(_LARGEST_HEADER)):
            begin += len(line)
            if line.startswith(b"#"):
                name, _, value = line[1:].decode("utf-8", "replace").partition(":")
                comments[name.strip()] = comments.get(name.strip(), "") + value.strip()
            elif words := line.decode("ascii", "replace").split():
                header[words[0]] = words[1:]
    names, sizes, kinds = (header.get(name, []) for name in ("FIELDS", "SIZE", "TYPE"))
    if (
        "DATA" not in header
        or not len(names) == len(sizes) == len(kinds)
        or not header.get("POINTS", [""])[0].isdigit()
    ):
        raise options.refuse("has no header of a PCD file: give a file with FIELDS, SIZE, TYPE, POINTS and DATA.")
    if header["DATA"] not in (["binary"], ["ascii"]):
        raise options.refuse(f"has its points as {' '.join(header['DATA'])}: write it as binary or ascii.")
    if set(header.get("COUNT", ["1"])) != {"1"} or not set(kinds) <= _KINDS.keys():
        raise options.refuse("has fields of several numbers: write it with one number per field.")
    for axis in "xyz":
        if axis not in names:
            raise options.refuse(f"has no {axis} among its fields: write it with x, y and z.")
    require_points(path, int(header["POINTS"][0]), options)
    fields = {name: f"<{_KINDS[kind]}{size}" for name, kind, size in zip(names, kinds, sizes, strict=True)}
    corner = [float(number) for number in comments.get("corner", "0 0").split()] if OURS in comments else [0.0, 0.0]
    return _Head(header["DATA"][0], int(header["POINTS"][0]), fields, comments, (corner[0], corner[1]), begin)


def _blocks(path: Path, head: _Head, options: ReadOptions) -> Iterator[Block]:
    starts = list(range(0, head.n_points, AT_A_TIME))
    read = text_records if head.form == "ascii" else records
    for block, _ in zip(
        read(path, head.begin, head.n_points, list(head.fields.items()), options), options.watch(starts), strict=True
    ):
        x, y = (block[axis].astype(np.float64) + from_um for axis, from_um in zip("xy", head.corner, strict=True))
        yield {"x": x, "y": y, "z": block["z"]}
