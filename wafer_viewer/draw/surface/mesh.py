"""Triangle meshes of a height map, and the unlit glTF that the browser draws with exact colours.

Scene coordinates are mm; z is the height above a reference, in mm too: the scene scales it by the exaggeration.

The page's 3D engine, three.js, sends every material through the filmic curve of S. Hill's fit of the ACES reference
transforms (three.js, ``ACESFilmicToneMapping``): linear rgb / 0.6 -> input matrix -> (v (v + a) - b) / (v (c v + d) +
e) -> output matrix -> sRGB. A texture baked with the inverse is displayed in the intended colours. The inverse exceeds
1 for light colours; it is divided by `GAIN`, which the material multiplies back.
"""

from __future__ import annotations

import io
import json
import struct
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """vertices: float32 [n, 3] in mm; uv: float32 [n, 2] in 0 ... 1, v downwards; triangles: uint32 [m, 3]."""

    vertices: Floats
    uv: Floats
    triangles: NDArray[np.uint32]


Skirts = tuple[bool, bool, bool, bool]
"""Whether a surface has a skirt at its bottom, top, left and right edge."""
NO_SKIRTS: Skirts = (False, False, False, False)
_SKIRT_STEPS = 4
"""Half width, in vertices, of the window along an edge that sets the depth of a skirt."""
_STEEP = 1.5
"""Rise over run above which a partly measured cell is a wall, not a slope."""


def picked(n: int, step: int) -> NDArray[np.intp]:
    """Return every step-th index of n, and the last."""
    return np.unique(np.append(np.arange(0, n, step), n - 1))


def surface(
    z_um: Floats,
    measured: NDArray[np.bool_],
    x_mm: Floats,
    y_mm: Floats,
    z0_um: float,
    step: int,
    skirts: Skirts = NO_SKIRTS,
) -> Mesh:
    """Return a surface of heights without gaps, a vertex every `step` pixels; cells without a valid pixel are omitted.

    Steep cells that are only partly measured are omitted too, as they would show as ragged fragments. x_mm [col], y_mm
    [row] are the pixel positions; the texture covers the same pixels, edge to edge. Skirts extend to the lowest height
    nearby, so that no cracks show next to a tile with other vertices.
    """
    rows, cols = picked(len(y_mm), step), picked(len(x_mm), step)
    grid_y, grid_x = np.meshgrid(y_mm[rows], x_mm[cols], indexing="ij")
    height = (z_um[np.ix_(rows, cols)] - np.float32(z0_um)) * np.float32(1e-3)
    v, u = np.meshgrid((rows + 0.5) / len(y_mm), (cols + 0.5) / len(x_mm), indexing="ij")
    cells = _cells(measured, rows, cols, np.logical_or)
    ragged = cells & ~(
        _cells(measured, rows, cols, np.logical_and) & _corners(measured[np.ix_(rows, cols)]).all(axis=0)
    )
    cells &= ~(ragged & (_rise(height) > _STEEP * step * abs(float(x_mm[-1] - x_mm[0])) / max(1, len(x_mm) - 1)))
    surface = Mesh(
        np.stack([grid_x, grid_y, height], axis=-1).reshape(-1, 3).astype(np.float32),
        np.stack([u, v], axis=-1).reshape(-1, 2).astype(np.float32),
        quads(len(rows), len(cols))[cells.ravel()].reshape(-1, 3),
    )
    return _joined([surface, *_skirts(surface, height, cells, skirts)])


def _skirts(mesh: Mesh, height: Floats, cells: NDArray[np.bool_], skirts: Skirts) -> list[Mesh]:
    """Return a skirt for each requested edge, along the cells that are kept."""
    index = np.arange(height.size).reshape(height.shape)
    edges = (index[-1], cells[-1]), (index[0], cells[0]), (index[:, 0], cells[:, 0]), (index[:, -1], cells[:, -1])
    return [_skirt(mesh, line, present) for wanted, (line, present) in zip(skirts, edges, strict=True) if wanted]


def _skirt(mesh: Mesh, line: NDArray[np.intp], present: NDArray[np.bool_]) -> Mesh:
    top, width = mesh.vertices[line], 2 * _SKIRT_STEPS + 1
    around = np.lib.stride_tricks.sliding_window_view(np.pad(top[:, 2], _SKIRT_STEPS, mode="edge"), width)
    spacing = float(np.hypot(*(top[-1, :2] - top[0, :2]))) / max(1, len(line) - 1)
    foot = np.column_stack([top[:, :2], around.min(axis=1) - 0.1 * spacing])
    return Mesh(
        np.concatenate([top, foot]).astype(np.float32),
        np.concatenate([mesh.uv[line]] * 2),
        quads(2, len(line))[present].reshape(-1, 3),
    )


def _joined(parts: list[Mesh]) -> Mesh:
    """Merge several meshes into one."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])[:-1]
    return Mesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.uv for part in parts]),
        np.concatenate([part.triangles + np.uint32(start) for part, start in zip(parts, starts, strict=True)]),
    )


def _cells(
    measured: NDArray[np.bool_], rows: NDArray[np.intp], cols: NDArray[np.intp], how: np.ufunc
) -> NDArray[np.bool_]:
    """Return for each cell between picked rows and columns whether any or every pixel in it is valid.

    how: logical_or for any, logical_and for every.
    """
    by_row = how.reduceat(measured, rows[:-1], axis=0)
    return how.reduceat(by_row, cols[:-1], axis=1)


def _rise(height: Floats) -> Floats:
    """Return the largest difference between the four corners of each cell."""
    return np.ptp(_corners(height), axis=0)


def _corners(lattice: NDArray[Any]) -> NDArray[Any]:
    """Return the values at the four corners of each cell, [4, row, col]."""
    return np.stack([lattice[:-1, :-1], lattice[:-1, 1:], lattice[1:, :-1], lattice[1:, 1:]])


def quads(rows: int, cols: int) -> NDArray[np.uint32]:
    """Return the two triangles of each cell of a vertex lattice, uint32 [cell, 2, 3], anticlockwise from above."""
    i = np.arange(rows * cols, dtype=np.uint32).reshape(rows, cols)
    a, b, c, d = i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1]
    return np.stack([a, d, c, a, c, b], axis=-1).reshape(-1, 2, 3)


def flat(x0_mm: float, y0_mm: float, x1_mm: float, y1_mm: float, z_mm: float = 0.0) -> Mesh:
    """Return one horizontal rectangle at z, with the top edge of the image at y1 (the larger)."""
    corners = [(x0_mm, y1_mm), (x1_mm, y1_mm), (x1_mm, y0_mm), (x0_mm, y0_mm)]
    return Mesh(
        np.array([(x, y, z_mm) for x, y in corners], np.float32),
        np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32),
        np.array([(0, 3, 2), (0, 2, 1)], np.uint32),
    )


def plates(boxes_mm: NDArray[np.float64], z_mm: NDArray[np.float64], uv: Floats) -> Mesh:
    """Return horizontal rectangles, each at its own height: boxes [n, 4] as x low, y low, x high, y high, z [n].

    uv [n, 4]: part of the image for each, as u0, v0, u1, v1 with v downwards.
    """
    (x0, y0, x1, y1), (u0, v0, u1, v1) = boxes_mm.T, uv.T
    corners = [np.stack([x, y, z_mm], axis=1) for x, y in ((x0, y1), (x1, y1), (x1, y0), (x0, y0))]
    places = [np.stack([u, v], axis=1) for u, v in ((u0, v0), (u1, v0), (u1, v1), (u0, v1))]
    one = np.array([(0, 3, 2), (0, 2, 1)], np.uint32)
    return Mesh(
        np.stack(corners, axis=1).reshape(-1, 3).astype(np.float32),
        np.stack(places, axis=1).reshape(-1, 2).astype(np.float32),
        (one + 4 * np.arange(len(boxes_mm), dtype=np.uint32)[:, None, None]).reshape(-1, 3),
    )


WALL_SIDES = 4


def walls(edges: dict[int, tuple[Floats, Floats, Floats]], base_mm: float) -> Mesh:
    """Return walls down from the edges of a block: each edge as x_mm, y_mm, z_mm [n]; NaN in z omits the wall.

    u identifies the edge, (its key + 0.5) / `WALL_SIDES`; v runs from the top (0) to the base (1).
    """
    return _joined([_wall(x, y, z, base_mm, (k + 0.5) / WALL_SIDES) for k, (x, y, z) in edges.items()])


def _wall(x: Floats, y: Floats, z: Floats, base_mm: float, u: float) -> Mesh:
    measured = np.isfinite(z)
    top = np.stack([x, y, np.where(measured, z, base_mm)], axis=1)
    foot = np.stack([x, y, np.full(len(x), base_mm)], axis=1)
    v = np.repeat([0.0, 1.0], len(x))
    cells = measured[:-1] & measured[1:]
    return Mesh(
        np.concatenate([top, foot]).astype(np.float32),
        np.stack([np.full(2 * len(x), u), v], axis=1).astype(np.float32),
        quads(2, len(x))[cells].reshape(-1, 3),
    )


GAIN = 3.0
"""Base colour factor required of the material of these textures."""

_EXPOSURE = 0.6
_INPUT = np.array([[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777]])
_OUTPUT = np.array([[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]])
_A, _B, _C, _D, _E = 0.0245786, 0.000090537, 0.983729, 0.4329510, 0.238081
_WHITEST = 245
"""Lightest displayed grey; lighter ones would need a factor over GAIN."""
_MOST = 0.95
"""Upper limit of the curve, so that the inverse stays finite (it reaches 1 / _C only at infinity)."""


def to_texture(shown: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the texture that is displayed as `shown`, both sRGB uint8 [..., 3]; exact to 3 of 255 for Mako."""
    texture = np.empty_like(shown)
    pixels, result = shown.reshape(-1, 3), texture.reshape(-1, 3)
    for first in range(0, len(pixels), _PIXELS_AT_ONCE):
        part = slice(first, first + _PIXELS_AT_ONCE)
        result[part] = _texture_of(pixels[part])
    return texture


_PIXELS_AT_ONCE = 65_536
"""Pixels whose floats are in memory at once: 8 MB of them, where a picture of 1600 x 1600 px would take 300 MB."""


def _texture_of(shown: NDArray[np.uint8]) -> NDArray[np.uint8]:
    light = _linear_table()[np.minimum(shown, _WHITEST)]
    before_output = np.clip(light @ np.linalg.inv(_OUTPUT).T.astype(np.float32), 0, _MOST)
    texture = _inverse_curve(before_output) @ np.linalg.inv(_INPUT).T.astype(np.float32) * (_EXPOSURE / GAIN)
    return _to_srgb(texture)


def as_shown(texture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the displayed colours of a texture with base colour factor `GAIN`, for legends and tests."""
    v = (_linear_table()[texture] * (GAIN / _EXPOSURE)) @ _INPUT.T
    curve = (v * (v + _A) - _B) / (v * (_C * v + _D) + _E)
    return _to_srgb((curve @ _OUTPUT.T).astype(np.float32))


def _inverse_curve(y: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the positive root v of (1 - c y) v^2 + (a - d y) v - (b + e y) = 0."""
    p, q, r = 1 - _C * y, _A - _D * y, -(_B + _E * y)
    return ((-q + np.sqrt(q * q - 4 * p * r)) / (2 * p)).astype(np.float32)


@cache
def _linear_table() -> NDArray[np.float32]:
    """Return the linear light of every sRGB code."""
    s = np.arange(256, dtype=np.float64) / 255
    return np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4).astype(np.float32)


def _to_srgb(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    # A table of 4096 entries instead of a power for each pixel: at most one code off in the darkest tones.
    return _srgb_table()[(np.clip(linear, 0, 1) ** 0.5 * 4095 + 0.5).astype(np.uint16)]


@cache
def _srgb_table() -> NDArray[np.uint8]:
    t = (np.arange(4096, dtype=np.float64) / 4095) ** 2
    s = np.where(t <= 0.0031308, t * 12.92, 1.055 * t ** (1 / 2.4) - 0.055)
    return (s * 255 + 0.5).astype(np.uint8)


Alpha = Literal["OPAQUE", "MASK", "BLEND"]
_JPEG_QUALITY, _WEBP_QUALITY = 93, 92
_WEBP = "EXT_texture_webp"
_FLOAT, _USHORT, _UINT = 5126, 5123, 5125
_LINEAR, _MIPMAPS, _CLAMP = 9729, 9987, 33071


def jpeg(picture: NDArray[np.uint8], quality: int = _JPEG_QUALITY) -> bytes:
    """Encode an image, grey [row, col] or rgb [row, col, 3], as JPEG without chroma subsampling."""
    out = io.BytesIO()
    Image.fromarray(picture).save(out, "JPEG", quality=quality, subsampling=0)
    return out.getvalue()


def webp(picture: NDArray[np.uint8]) -> bytes:
    """Encode an image with sharp holes, rgba [row, col, 4], as WebP: a quarter of the PNG size at the same speed."""
    out = io.BytesIO()
    Image.fromarray(picture).save(out, "WEBP", quality=_WEBP_QUALITY, method=0, exact=True)
    return out.getvalue()


def png(picture: NDArray[np.uint8]) -> bytes:
    """Encode an image of any kind as PNG, for speed rather than size."""
    out = io.BytesIO()
    Image.fromarray(picture).save(out, "PNG", compress_level=1)
    return out.getvalue()


def painted(mesh: Mesh, shown: NDArray[np.uint8], *, blend: bool = False) -> bytes:
    """Return the GLB of a mesh that is displayed in the colours `shown`, uint8 rgb or rgba [row, col, 3 or 4].

    Alpha cuts holes (pixels under 128 are not drawn), or with `blend` is translucent.
    """
    texture = to_texture(shown[..., :3])
    if shown.shape[-1] == 3 or bool((shown[..., 3] == 255).all()):
        return glb(mesh, jpeg(texture), "image/jpeg", "OPAQUE")
    cut_out = np.dstack([texture, shown[..., 3]])
    if blend:
        return glb(mesh, png(cut_out), "image/png", "BLEND")
    return glb(mesh, webp(cut_out), "image/webp", "MASK")


def glb(mesh: Mesh, texture: bytes, mime_type: str, alpha: Alpha) -> bytes:
    """Return the file of a mesh and its encoded texture; uv as normalised 16-bit, indices in the smallest type."""
    indices = mesh.triangles.astype(np.uint16 if len(mesh.vertices) < 65535 else np.uint32)
    uv = (np.clip(mesh.uv, 0, 1) * 65535 + 0.5).astype("<u2")
    is_webp = mime_type == "image/webp"
    extensions = [_WEBP] if is_webp else []
    blob, views = _packed([mesh.vertices.astype("<f4").tobytes(), uv.tobytes(), indices.tobytes(), texture])
    document = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_materials_unlit", *extensions],
        **({"extensionsRequired": extensions} if extensions else {}),
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}]}],
        "materials": [_material(alpha)],
        "textures": [{"sampler": 0, "extensions": {_WEBP: {"source": 0}}} if is_webp else {"source": 0, "sampler": 0}],
        "images": [{"bufferView": 3, "mimeType": mime_type}],
        "samplers": [{"magFilter": _LINEAR, "minFilter": _MIPMAPS, "wrapS": _CLAMP, "wrapT": _CLAMP}],
        "bufferViews": views,
        "buffers": [{"byteLength": len(blob)}],
        "accessors": _accessors(mesh, indices),
    }
    return _container(json.dumps(document, separators=(",", ":")).encode(), blob)


def _material(alpha: Alpha) -> dict[str, Any]:
    surface = {"baseColorTexture": {"index": 0}, "baseColorFactor": [GAIN, GAIN, GAIN, 1], "metallicFactor": 0}
    return {
        "pbrMetallicRoughness": surface,
        "extensions": {"KHR_materials_unlit": {}},
        "alphaMode": alpha,
        "doubleSided": True,
    }


def _accessors(mesh: Mesh, indices: NDArray[np.generic]) -> list[dict[str, Any]]:
    low, high = mesh.vertices.min(axis=0).tolist(), mesh.vertices.max(axis=0).tolist()
    n = len(mesh.vertices)
    kind = _USHORT if indices.dtype == np.uint16 else _UINT
    return [
        {"bufferView": 0, "componentType": _FLOAT, "count": n, "type": "VEC3", "min": low, "max": high},
        {"bufferView": 1, "componentType": _USHORT, "normalized": True, "count": n, "type": "VEC2"},
        {"bufferView": 2, "componentType": kind, "count": int(indices.size), "type": "SCALAR"},
    ]


def _packed(parts: list[bytes]) -> tuple[bytes, list[dict[str, int]]]:
    """Concatenate the parts with 4-byte alignment, and return their buffer views."""
    blob, views = bytearray(), []
    for part in parts:
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(part)})
        blob += part + b"\0" * (-len(part) % 4)
    return bytes(blob), views


def _container(document: bytes, blob: bytes) -> bytes:
    document += b" " * (-len(document) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(document) + 8 + len(blob))
    return (
        head + struct.pack("<I4s", len(document), b"JSON") + document + struct.pack("<I4s", len(blob), b"BIN\0") + blob
    )
