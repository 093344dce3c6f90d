"""Pixel formats of monochrome cameras, by their names in the GenICam pixel format naming convention.

Values of more than 8 bits are expanded to the full range of uint16 by repeating their leading bits, which loses
nothing and makes white 65535 for every bit depth.

References
----------
EMVA, GenICam Pixel Format Naming Convention; AIA, GigE Vision (formats ending in "Packed").
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.errors import RigError

Bytes = NDArray[np.uint8]
Values = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """Bits per value, pixels and bytes of a packed group, and the function that unpacks groups [group, byte]."""

    bits: int
    group_pixels: int
    group_bytes: int
    unpack: Callable[[Bytes], Values]

    def n_bytes(self, n_pixels: int) -> int:
        """Return the size of an image; an incomplete last group ends with the byte that holds its last pixel."""
        full, rest = divmod(n_pixels, self.group_pixels)
        return full * self.group_bytes + -(-rest * self.group_bytes // self.group_pixels)


def decode_image(data: bytes | Bytes, pixel_format: str, rows: int, cols: int) -> Image:
    """Return the image of a buffer, uint8 or uint16 [row, col], as a copy.

    Raises RigError for an unknown pixel format and for too few bytes; bytes after the image are ignored.
    """
    form = format_of(pixel_format)
    raw = np.frombuffer(data, np.uint8)
    n_pixels = rows * cols
    size = form.n_bytes(n_pixels)
    if raw.size < size:
        raise RigError(
            f"The camera sent {raw.size} bytes for {cols} x {rows} pixels in {pixel_format}, which take {size}: "
            "check its region and pixel format."
        )
    raw = raw[:size]
    if short := -size % form.group_bytes:
        raw = np.concatenate([raw, np.zeros(short, np.uint8)])
    values = form.unpack(raw.reshape(-1, form.group_bytes)).reshape(-1)[:n_pixels]
    return full_range(values, form.bits).reshape(rows, cols)


def format_of(pixel_format: str) -> PixelFormat:
    """Return a pixel format by name. Raises RigError for one that cannot be read."""
    if pixel_format not in PIXEL_FORMATS:
        raise RigError(f"The pixel format {pixel_format!r} cannot be read: choose one of {', '.join(PIXEL_FORMATS)}.")
    return PIXEL_FORMATS[pixel_format]


def full_range(values: Values, bits: int) -> Image:
    """Expand values of up to 16 bits to the full range of uint8 or uint16, as a copy."""
    if bits == 8:
        return values.astype(np.uint8)
    wide = values.astype(np.uint16)
    if bits < 16:
        wide = (wide << np.uint16(16 - bits)) | (wide >> np.uint16(2 * bits - 16))
    return wide


def _one_byte(groups: Bytes) -> Values:
    return groups


def _two_bytes(groups: Bytes) -> Values:
    return groups.view("<u2")


def _bit_stream_10(groups: Bytes) -> Values:
    """Unpack four values of 10 bits from 5 bytes, lowest bits first."""
    b: Any = groups.astype(np.uint16)
    out = np.empty((len(b), 4), np.uint16)
    for i in range(4):
        out[:, i] = (b[:, i] >> 2 * i) | ((b[:, i + 1] << (8 - 2 * i)) & 0x3FF)
    return out


def _bit_stream_12(groups: Bytes) -> Values:
    """Unpack two values of 12 bits from 3 bytes, lowest bits first."""
    b: Any = groups.astype(np.uint16)
    return np.stack([b[:, 0] | ((b[:, 1] & 0xF) << 8), (b[:, 1] >> 4) | (b[:, 2] << 4)], axis=1)


def _shared_byte_10(groups: Bytes) -> Values:
    """Unpack two values of 10 bits from 3 bytes, the middle one with the lowest bits of both."""
    b: Any = groups.astype(np.uint16)
    return np.stack([(b[:, 0] << 2) | (b[:, 1] & 0x3), (b[:, 2] << 2) | ((b[:, 1] >> 4) & 0x3)], axis=1)


def _shared_byte_12(groups: Bytes) -> Values:
    """Unpack two values of 12 bits from 3 bytes, the middle one with the lowest bits of both."""
    b: Any = groups.astype(np.uint16)
    return np.stack([(b[:, 0] << 4) | (b[:, 1] & 0xF), (b[:, 2] << 4) | (b[:, 1] >> 4)], axis=1)


PIXEL_FORMATS = {
    "Mono8": PixelFormat(8, 1, 1, _one_byte),
    "Mono10": PixelFormat(10, 1, 2, _two_bytes),
    "Mono10p": PixelFormat(10, 4, 5, _bit_stream_10),
    "Mono10Packed": PixelFormat(10, 2, 3, _shared_byte_10),
    "Mono12": PixelFormat(12, 1, 2, _two_bytes),
    "Mono12p": PixelFormat(12, 2, 3, _bit_stream_12),
    "Mono12Packed": PixelFormat(12, 2, 3, _shared_byte_12),
    "Mono14": PixelFormat(14, 1, 2, _two_bytes),
    "Mono16": PixelFormat(16, 1, 2, _two_bytes),
}
"""Formats that can be read; colour formats are not among them."""
