"""Binary glTF 2.0 with one unlit, textured mesh, which the browser draws exactly as baked."""

from __future__ import annotations

import io
import json
import struct
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from wafer_viewer.draw.surface.mesh import Mesh
from wafer_viewer.draw.surface.tone_curve import GAIN, to_texture

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
