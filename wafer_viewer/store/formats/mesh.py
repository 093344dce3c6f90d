"""STL, OBJ and GLB: triangles between neighbouring measured pixels, facing up. Export only."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.store.formats.embedded_metadata import about, caveats, heading
from wafer_viewer.store.formats.point_gridding import eight_bits, points_of
from wafer_viewer.store.formats.surface_strips import Strips

_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_TITLE_BYTES = 80
_FLOAT, _UBYTE, _UINT = 5126, 5121, 5125
_ARRAY, _ELEMENTS = 34962, 34963
_GLB, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
_LARGEST_BYTES = 2**32 - 1
_M = 1e-6
_ROWS_AT_A_TIME = 256
Triangles = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class _Mesh:
    """Vertices [n, 3] in um, stage coordinates; their grey values; and the number of triangles."""

    part: HeightMap
    known: NDArray[np.bool_]
    number: NDArray[np.int64]

    @property
    def n_triangles(self) -> int:
        return 2 * int(_squares(self.known).sum())

    def vertices(self) -> NDArray[np.float64]:
        return points_of(self.part, *np.nonzero(self.known))

    def triangles(self) -> Iterator[Triangles]:
        """Yield the vertex indices of the triangles, strip by strip."""
        rows = self.known.shape[0]
        for top, bottom in pairwise([*range(0, rows - 1, _ROWS_AT_A_TIME), rows - 1]):
            whole = _squares(self.known[top : bottom + 1])
            n = self.number[top : bottom + 1]
            a, b, c, d = n[:-1, :-1][whole], n[:-1, 1:][whole], n[1:, :-1][whole], n[1:, 1:][whole]
            yield np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])


def write_stl(strips: Strips, path: Path) -> None:
    """Write binary STL in um, x and y relative to the corner of the surface, as STL numbers have seven digits."""
    mesh = _mesh(strips, path)
    corner = np.array([mesh.part.x0_um, mesh.part.y0_um, 0.0])
    vertices = (mesh.vertices() - corner).astype(np.float32)
    title = f"Wafer Viewer, um, {'; '.join(caveats(strips.surface.provenance)) or 'calibrated'}"
    with path.open("wb") as file:
        file.write(title.encode("ascii", "replace")[:_TITLE_BYTES].ljust(_TITLE_BYTES))
        file.write(struct.pack("<I", mesh.n_triangles))
        for triangles in mesh.triangles():
            record = np.zeros(len(triangles), _STL)
            record["corners"] = vertices[triangles]
            a, b, c = (record["corners"][:, at].astype(np.float64) for at in range(3))
            normal = np.cross(b - a, c - a)
            record["normal"] = normal / np.linalg.norm(normal, axis=1, keepdims=True)
            file.write(record.tobytes())


def write_obj(strips: Strips, path: Path) -> None:
    """Write text OBJ in um, stage coordinates."""
    mesh = _mesh(strips, path)
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"# {line}\n" for line in heading(strips))
        for x, y, z in mesh.vertices().tolist():
            file.write(f"v {x:.4f} {y:.4f} {z:.5f}\n")
        for triangles in mesh.triangles():
            file.writelines(f"f {a} {b} {c}\n" for a, b, c in (triangles + 1).tolist())


def write_glb(strips: Strips, path: Path) -> None:
    """Write glTF 2.0 with grey vertex colours; a node matrix converts um and z up to glTF's m and y up."""
    mesh = _mesh(strips, path)
    corner = np.array([mesh.part.x0_um, mesh.part.y0_um, 0.0])
    points = (mesh.vertices() - corner).astype("<f4")
    grey = np.full((len(points), 4), 255, np.uint8)
    grey[:, :3] = eight_bits(mesh.part.all_in_focus)[mesh.known][:, None]
    blobs = [points.tobytes(), grey.tobytes(), b"".join(t.astype("<u4").tobytes() for t in mesh.triangles())]
    text = json.dumps(_document(strips, corner, points, blobs, mesh.n_triangles)).encode()
    text += b" " * (-len(text) % 4)
    data = b"".join(blobs)
    whole = 12 + 8 + len(text) + 8 + len(data)
    if whole > _LARGEST_BYTES:
        raise DatasetError(f"{path.name} would pass the 4 GB of a GLB file: take fewer points.")
    with path.open("wb") as file:
        file.write(struct.pack("<III", _GLB, 2, whole) + struct.pack("<II", len(text), _JSON) + text)
        file.write(struct.pack("<II", len(data), _BIN) + data)


def _mesh(strips: Strips, path: Path) -> _Mesh:
    """Return the mesh of a surface. Raises DatasetError when no four neighbouring pixels have a height."""
    parts = list(strips.maps())
    layers: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("z_um", "z_raw_um", "confidence", "all_in_focus", "origin")
    }
    first = parts[0]
    whole = HeightMap(**layers, pixel_um=first.pixel_um, x0_um=first.x0_um, y0_um=first.y0_um)
    known = np.isfinite(whole.z_um)
    if not _squares(known).any():
        raise DatasetError(f"{path.name} would hold no triangle: no four neighbouring pixels have a height.")
    return _Mesh(whole, known, np.cumsum(known).reshape(known.shape) - 1)


def _squares(known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the mask of 2 x 2 pixel squares without gaps, indexed by their top left pixel."""
    return known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1] & known[1:, 1:]


def _document(
    strips: Strips, corner: NDArray[np.float64], points: NDArray[np.float32], blobs: list[bytes], n_triangles: int
) -> dict[str, Any]:
    x, y, _ = (float(v) * _M for v in corner)
    starts = [sum(len(blob) for blob in blobs[:at]) for at in range(len(blobs))]
    targets = (_ARRAY, _ARRAY, _ELEMENTS)
    n = len(points)
    box = {"min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()}
    return {
        "asset": {"version": "2.0", "generator": "Wafer Viewer", "extras": json.loads(about(strips))},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "matrix": [_M, 0, 0, 0, 0, 0, -_M, 0, 0, _M, 0, 0, x, 0, -y, 1]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}, "indices": 2}]}],
        "accessors": [
            {"bufferView": 0, "componentType": _FLOAT, "count": n, "type": "VEC3", **box},
            {"bufferView": 1, "componentType": _UBYTE, "normalized": True, "count": n, "type": "VEC4"},
            {"bufferView": 2, "componentType": _UINT, "count": 3 * n_triangles, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": len(blob), "target": target}
            for start, blob, target in zip(starts, blobs, targets, strict=True)
        ],
        "buffers": [{"byteLength": sum(map(len, blobs))}],
    }
