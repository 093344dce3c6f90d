"""STL, OBJ and GLB: triangles between neighbouring measured pixels, facing up. Export only."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.store.formats.point_gridding import eight_bits, points_of
from wafer_viewer.store.formats.reader_support import about, caveats, heading
from wafer_viewer.store.formats.surface_strips import Strips

_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_TITLE_BYTES = 80
_FLOAT, _UBYTE, _UINT = 5126, 5121, 5125
_ARRAY, _ELEMENTS = 34962, 34963
_GLB, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
_LARGEST_BYTES = 2**32 - 1
_M = 1e-6
# trimesh 5.2 holds the whole mesh: 2.4, 2.0 and 0.8 GB for STL, OBJ and GLB of 2000 x 2000 points, here below 0.05 GB.
_ROWS_AT_A_TIME = 32
Floats = NDArray[np.floating]


@dataclass(frozen=True, slots=True)
class _Piece:
    """Some rows of a mesh: vertices [n, 3] in um, stage coordinates, and triangles [m, 3] of indices into them.

    first: index of the first vertex in the whole mesh; the first `n_shared` vertices are the last of the piece before.
    grey: values of the others.
    """

    vertices: Floats
    triangles: NDArray[np.int64]
    first: int
    n_shared: int
    grey: NDArray[np.uint8]

    @property
    def new_vertices(self) -> Floats:
        """Vertices that the piece before does not have."""
        return self.vertices[self.n_shared :]


def write_stl(strips: Strips, path: Path) -> None:
    """Write binary STL in um, x and y relative to the corner of the surface, as STL numbers have seven digits."""
    n_triangles = 0
    title = f"Wafer Viewer, um, {'; '.join(caveats(strips.surface.provenance)) or 'calibrated'}"
    with path.open("wb") as file:
        file.write(title.encode("ascii", "replace")[:_TITLE_BYTES].ljust(_TITLE_BYTES) + struct.pack("<I", 0))
        for piece in _pieces(strips, path):
            record = np.zeros(len(piece.triangles), _STL)
            record["corners"] = _from_corner(strips, piece.vertices)[piece.triangles]
            a, b, c = (record["corners"][:, corner].astype(np.float64) for corner in range(3))
            normal = np.cross(b - a, c - a)
            record["normal"] = normal / np.linalg.norm(normal, axis=1, keepdims=True)
            file.write(record.tobytes())
            n_triangles += len(record)
        file.seek(_TITLE_BYTES)
        file.write(struct.pack("<I", n_triangles))


def write_obj(strips: Strips, path: Path) -> None:
    """Write text OBJ in um, stage coordinates."""
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"# {line}\n" for line in heading(strips))
        for piece in _pieces(strips, path):
            file.writelines(f"v {x:.4f} {y:.4f} {z:.5f}\n" for x, y, z in piece.new_vertices.tolist())
            file.writelines(f"f {a} {b} {c}\n" for a, b, c in (piece.triangles + (piece.first + 1)).tolist())


def write_glb(strips: Strips, path: Path) -> None:
    """Write glTF 2.0 with grey vertex colours; a node matrix converts um and z up to glTF's m and y up."""
    n_points = n_triangles = 0
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for piece in _pieces(strips, path, 0, 2):
        points = _from_corner(strips, piece.new_vertices)
        low, high = np.vstack([low, points]).min(axis=0), np.vstack([high, points]).max(axis=0)
        n_points, n_triangles = n_points + len(points), n_triangles + len(piece.triangles)
    sizes = 12 * n_points, 4 * n_points, 12 * n_triangles
    text = json.dumps(_document(strips, (low, high), sizes)).encode()
    text += b" " * (-len(text) % 4)
    n_bytes = 12 + 8 + len(text) + 8 + sum(sizes)
    if n_bytes > _LARGEST_BYTES:
        raise DatasetError(f"{path.name} would pass the 4 GB of a GLB file: take fewer points.")
    with path.open("wb") as file:
        file.write(struct.pack("<III", _GLB, 2, n_bytes) + struct.pack("<II", len(text), _JSON) + text)
        file.write(struct.pack("<II", sum(sizes), _BIN))
        places = [file.tell() + sum(sizes[:n]) for n in range(len(sizes))]
        for piece in _pieces(strips, path, 1, 2):
            grey = np.full((len(piece.grey), 4), 255, np.uint8)
            grey[:, :3] = piece.grey[:, None]
            blobs = _from_corner(strips, piece.new_vertices), grey, (piece.triangles + piece.first).astype("<u4")
            for n, blob in enumerate(blobs):
                file.seek(places[n])
                places[n] += file.write(blob.tobytes())


def _pieces(strips: Strips, path: Path, part: int = 0, of: int = 1) -> Iterator[_Piece]:
    """Yield a mesh some rows at a time. Raises DatasetError when no four neighbouring pixels have a height."""
    first = n_triangles = 0
    shared, finite_above = np.empty((0, 3)), np.empty((0, strips.shape[1]), np.bool_)
    for rows in (rows for strip in strips.maps(part, of) for rows in _few_rows(strip)):
        finite = np.isfinite(rows.z_um)
        vertices = np.concatenate([shared, points_of(rows, *np.nonzero(finite))])
        triangles = _triangles(np.concatenate([finite_above, finite]))
        yield _Piece(vertices, triangles, first, len(shared), eight_bits(rows.all_in_focus)[finite])
        n_triangles += len(triangles)
        finite_above = finite[-1:]
        n_unshared = len(vertices) - int(finite_above.sum())
        first, shared = first + n_unshared, vertices[n_unshared:]
    if n_triangles == 0:
        raise DatasetError(f"{path.name} would hold no triangle: no four neighbouring pixels have a height.")


def _few_rows(part: HeightMap) -> Iterator[HeightMap]:
    """Yield some rows of a map at a time, as triangles take 50 times the memory of heights."""
    rows, cols = part.shape
    for top in range(0, rows, _ROWS_AT_A_TIME):
        yield part.crop(slice(top, min(top + _ROWS_AT_A_TIME, rows)), slice(0, cols))


def _triangles(finite: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return two triangles for every 2 x 2 pixels without a gap, as indices of known pixels."""
    n = np.cumsum(finite).reshape(finite.shape) - 1
    square = finite[:-1, :-1] & finite[:-1, 1:] & finite[1:, :-1] & finite[1:, 1:]
    a, b, c, d = n[:-1, :-1][square], n[:-1, 1:][square], n[1:, :-1][square], n[1:, 1:][square]
    return np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])


def _corner(strips: Strips) -> Floats:
    return np.array([strips.surface.x0_um, strips.surface.y0_um, 0.0])


def _from_corner(strips: Strips, vertices: Floats) -> Floats:
    """Return vertices relative to the top left corner of the surface, where 32-bit floats are fine enough."""
    return (vertices - _corner(strips)).astype("<f4")


def _document(strips: Strips, box: tuple[Floats, Floats], sizes: tuple[int, int, int]) -> dict[str, Any]:
    """Return the JSON of a GLB file; sizes: bytes of points, colours and triangles."""
    x, y, _ = (_corner(strips) * _M).tolist()
    low, high = (corner.tolist() for corner in box)
    n_points = sizes[1] // 4
    return {
        "asset": {"version": "2.0", "generator": "Wafer Viewer", "extras": json.loads(about(strips))},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "matrix": [_M, 0, 0, 0, 0, 0, -_M, 0, 0, _M, 0, 0, x, 0, -y, 1]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}, "indices": 2}]}],
        "accessors": [
            {"bufferView": 0, "componentType": _FLOAT, "count": n_points, "type": "VEC3", "min": low, "max": high},
            {"bufferView": 1, "componentType": _UBYTE, "normalized": True, "count": n_points, "type": "VEC4"},
            {"bufferView": 2, "componentType": _UINT, "count": sizes[2] // 4, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": sum(sizes[:n]), "byteLength": size, "target": target}
            for n, (size, target) in enumerate(zip(sizes, (_ARRAY, _ARRAY, _ELEMENTS), strict=True))
        ],
        "buffers": [{"byteLength": sum(sizes)}],
    }
