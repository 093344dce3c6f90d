"""Common parts of the camera drivers: their protocol, their options and the errors that they share."""

from __future__ import annotations

import importlib
from typing import Annotated, Any, ClassVar, Literal, Protocol

from wafer_viewer.model.acquisition.devices import Camera
from wafer_viewer.model.acquisition.rig_limits import CameraLimits
from wafer_viewer.model.errors import RigError, WaferViewerError
from wafer_viewer.model.spec import NonNegative, Spec, Within
from wafer_viewer.rigs.cameras.pixel_formats import format_of

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
