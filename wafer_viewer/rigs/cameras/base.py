"""Common parts of the camera drivers: their protocol, their options and the errors that they share.

Values of more than 8 bits are expanded to the full range of uint16 by repeating their leading bits, which loses
nothing and makes white 65535 for every bit depth.

References
----------
EMVA, GenICam Pixel Format Naming Convention; AIA, GigE Vision (formats ending in "Packed").
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.devices import Camera
from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.acquisition.rig_limits import CameraLimits
from wafer_viewer.model.errors import RigError, WaferViewerError
from wafer_viewer.model.spec import NonNegative, Spec, Within

# -------------------------------------------------------------------------------------------------------- pixel formats


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


# ----------------------------------------------------------------------------------------------------------------- base


Trigger = Literal["hardware", "software", "free"]
"""Start of an exposure: an edge on the trigger input, `fire`, or the camera by itself."""
MIN_BUFFERS = 30
"""Smallest number of frame buffers: half a second at 60 frames/s, for pauses of the reader."""
NO_TIME = -1
"""Device time of an incomplete frame whose time did not arrive."""


class ConnectedCamera(Camera, Protocol):
    """A camera connected to this computer. Only one with a hardware trigger can scan."""

    @property
    def name(self) -> str:
        """Maker, model and serial number."""
        ...

    @property
    def limits(self) -> CameraLimits:
        """Limits at the current region and pixel format."""
        ...

    @property
    def trigger(self) -> Trigger:
        """Start of an exposure."""
        ...

    def fire(self) -> None:
        """Take one frame now. Raises RigError unless the trigger is "software"."""
        ...

    def close(self) -> None:
        """Stop and disconnect; a second call does nothing."""
        ...


class CameraOptions(Spec, frozen=True, kw_only=True):
    """Settings of every connected camera in a rig file.

    left, top, cols, rows: region in pixels, 0 columns or rows for the whole sensor; buffers: frames that can wait to
    be fetched; readout_us: dead time after an exposure, from the data sheet; frame_rate_hz: highest rate of triggers,
    0 for that of the camera.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    left: Annotated[int, Within(0)] = 0
    top: Annotated[int, Within(0)] = 0
    cols: Annotated[int, Within(0)] = 0
    rows: Annotated[int, Within(0)] = 0
    buffers: Annotated[int, Within(MIN_BUFFERS)] = 32
    readout_us: NonNegative = 0.0
    frame_rate_hz: NonNegative = 0.0


class GenICamOptions(CameraOptions, frozen=True, kw_only=True):
    """Settings of a GenICam camera.

    device: identifier, serial number or address, empty if only one camera is connected; trigger: name of the input
    line, `Software` or `Free`; gain: in the camera's unit, left as it is if not given; pixel_format: a name of the
    GenICam pixel format naming convention.
    """

    device: str = ""
    trigger: str = "Line0"
    gain: float | None = None
    pixel_format: str = "Mono8"

    @property
    def trigger_kind(self) -> Trigger:
        """Start of an exposure."""
        if self.trigger == "Software":
            return "software"
        return "free" if self.trigger == "Free" else "hardware"

    def limits_of(self, rows: int, cols: int, exposure_us: tuple[float, float], highest_hz: float) -> CameraLimits:
        """Return the limits of a camera with these options, whose highest rate of triggers they may lower."""
        return CameraLimits(
            frame_rate_hz=min(self.frame_rate_hz, highest_hz) if self.frame_rate_hz else highest_hz,
            exposure_min_us=exposure_us[0],
            exposure_max_us=exposure_us[1],
            readout_us=self.readout_us,
            rows=rows,
            cols=cols,
            queue_frames=self.buffers,
            bits=format_of(self.pixel_format).bits,
        )


def import_library(module: str, what: str, mend: str) -> Any:
    """Import a camera library. Raises RigError with the remedy when it is missing."""
    try:
        return importlib.import_module(module)
    except (ImportError, OSError) as fault:
        raise RigError(f"{what} is not installed ({fault}): {mend}.") from fault


def select_device(wanted: str, found: list[tuple[str, ...]], where: str) -> int:
    """Return the index of the wanted camera in a list of identifiers, the first of each its display name."""
    names = ", ".join(identifiers[0] for identifiers in found)
    if not found:
        raise RigError(f"No camera was found {where}: check its power, its cable and its network address.")
    if not wanted and len(found) > 1:
        raise RigError(f"{len(found)} cameras were found {where}: choose one as device: {names}.")
    matches = [i for i, identifiers in enumerate(found) if not wanted or wanted in identifiers]
    if not matches:
        raise RigError(f"The camera {wanted!r} was not found {where}; found are: {names}.")
    return matches[0]


def require_choice(name: str, what: str, wanted: str, choices: list[str]) -> None:
    """Raise RigError if a camera does not offer a setting."""
    if wanted not in choices:
        raise RigError(f"{name} has no {what} {wanted!r}: choose one of {', '.join(choices) or 'none'}.")


class CameraHead:
    """Common part of the connected cameras: name, limits and trigger, and what they refuse."""

    _limits: CameraLimits
    _trigger: Trigger

    def __init__(self, name: str, trigger: Trigger) -> None:
        self._name, self._trigger = name, trigger

    @property
    def name(self) -> str:
        """Maker, model and serial number, as far as the driver tells."""
        return self._name

    @property
    def limits(self) -> CameraLimits:
        """Limits at the current region and pixel format."""
        return self._limits

    @property
    def trigger(self) -> Trigger:
        """Start of an exposure."""
        return self._trigger

    def _require_exposure(self, exposure_us: float) -> None:
        """Raise RigError if an exposure is outside the range of the camera."""
        shortest_us, longest_us = self._limits.exposure_min_us, self._limits.exposure_max_us
        if not shortest_us <= exposure_us <= longest_us:
            raise RigError(
                f"The camera cannot expose for {exposure_us:g} us: its range is {shortest_us:g} to {longest_us:g} us."
            )

    def _require_software_trigger(self) -> None:
        """Raise RigError if frames are not taken on command."""
        if self._trigger != "software":
            raise RigError(f"{self._name} takes no frame on command: its trigger is {self._trigger!r}.")


ID_CYCLE = 65535
"""Period of 16-bit frame numbers, which continue with 1 after 65535."""


class FrameNumbers:
    """Counts frames from 0 by their numbers, which may have 16 bits and need not start anew with each run."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._count = 0

    def count(self, frame_id: int) -> int:
        """Return the count of a complete frame, including the frames missing since the one before."""
        if self._last is None:
            step = 0
        elif frame_id > self._last:
            step = frame_id - self._last
        else:
            step = (frame_id - self._last) % ID_CYCLE
        self._last = frame_id
        self._count += step
        return self._count

    def skip(self) -> None:
        """Record an incomplete frame before the first complete one."""
        if self._last is None:
            self._count += 1
