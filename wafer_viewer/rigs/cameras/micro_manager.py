"""Cameras with a Micro-Manager device adapter, through pymmcore."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Generator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

import msgspec

from wafer_viewer.model.acquisition.devices import CameraImage
from wafer_viewer.model.acquisition.focus_stack import FrameStatus, Image
from wafer_viewer.model.acquisition.rig_limits import CameraLimits
from wafer_viewer.model.errors import RigError
from wafer_viewer.model.spec import Positive
from wafer_viewer.rigs.cameras.base import CameraHead, CameraOptions, Trigger, full_range, import_library

MEND = "pip install 'wafer-viewer[micro-manager]'"
LABEL = "Camera"
POLL_S = 0.0005
ENDLESS = 2**31 - 1
"""Number of images of a sequence; unlike a continuous one it stops when the buffer is full, and loses none."""
ARRIVAL, CAMERA_MS = "TimeReceivedByCore", "ElapsedTime-ms"
"""Metadata with the time of an image: of its arrival at this computer, and from the device adapter."""


class MicroManagerOptions(CameraOptions, frozen=True, kw_only=True):
    """Settings of a camera with a Micro-Manager device adapter.

    adapters: folder of the device adapters; config: hardware configuration file of Micro-Manager with the camera, or
    library and device: adapter and name of the camera; properties: set before the first frame; trigger: `hardware`
    needs the property that selects it in `properties`; time: `camera` if its adapter reports times of the camera;
    frame_rate_hz: from the data sheet, since adapters do not report it; exposure_min_us, exposure_max_us: narrow the
    range of the adapter.
    """

    adapters: str
    config: str = ""
    library: str = ""
    device: str = ""
    properties: dict[str, str] = msgspec.field(default_factory=dict[str, str])
    trigger: Trigger = "hardware"
    time: Literal["computer", "camera"] = "computer"
    frame_rate_hz: Positive = 10.0
    exposure_min_us: Positive = 10.0
    exposure_max_us: Positive = 10_000_000.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if bool(self.config) == bool(self.library and self.device):
            self.refuse("config", "a hardware configuration file, or else library and device must be given")
        if self.trigger == "hardware" and not self.properties:
            self.refuse("properties", "the property of the camera that selects its trigger input, and its value")


def import_core() -> Any:
    """Import Micro-Manager's core. Raises RigError with the remedy when it is missing."""
    return import_library("pymmcore", "pymmcore, which Micro-Manager cameras need,", MEND)


class MicroManagerCamera(CameraHead):
    """Implementation of ConnectedCamera on Micro-Manager's core.

    With a software trigger every frame is a snap; otherwise frames come from a sequence acquisition.
    """

    def __init__(self, options: MicroManagerOptions) -> None:
        super().__init__(f"The Micro-Manager camera {options.device or options.config}", options.trigger)
        library = import_core()
        self._options = options
        self._metadata: Any = library.Metadata
        self._core: Any = library.CMMCore()
        self._armed = False
        self._snaps: deque[CameraImage] = deque()
        self._n_snaps = 0
        with self._errors():
            self._load()
            self._limits = self._configure()

    def start(self, exposure_us: float) -> None:
        """Start a run with an empty buffer."""
        self.stop()
        self._require_exposure(exposure_us)
        self._require_open()
        self._n_snaps = 0
        with self._errors():
            self._core.setExposure(exposure_us / 1000)
            if self.trigger != "software":
                self._core.startSequenceAcquisition(ENDLESS, 0.0, True)
        self._armed = True

    def fire(self) -> None:
        """Take one frame now and wait for it."""
        self._require_software_trigger()
        if not self._armed:
            return
        time_us = time.monotonic_ns() // 1000
        with self._errors():
            self._core.snapImage()
            image = self._image(self._core.getImage())
        self._snaps.append(CameraImage(image, self._n_snaps, time_us, FrameStatus.OK))
        self._n_snaps += 1

    def next_image(self, timeout_s: float) -> CameraImage | None:
        """Return the next image, or None on timeout. Raises RigError when images were lost in a full buffer."""
        deadline_s = time.monotonic() + timeout_s
        while self._armed:
            if self._snaps:
                return self._snaps.popleft()
            if self._n_waiting():
                return self._pop()
            if time.monotonic() >= deadline_s:
                return None
            time.sleep(POLL_S)
        return None

    def stop(self) -> None:
        """End the run; images not fetched are dropped."""
        self._snaps.clear()
        if not self._armed:
            return
        self._armed = False
        if self.trigger != "software":
            with self._errors():
                self._core.stopSequenceAcquisition()
                self._core.clearCircularBuffer()

    def close(self) -> None:
        """Stop and unload the adapter; a second call does nothing."""
        if self._core is None:
            return
        with suppress(RigError):
            self.stop()
        with suppress(RigError), self._errors():
            self._core.unloadAllDevices()
        self._core = None

    def _load(self) -> None:
        options, core = self._options, self._core
        if not Path(options.adapters).is_dir():
            raise RigError(f"The folder of Micro-Manager device adapters {options.adapters!r} does not exist.")
        core.setDeviceAdapterSearchPaths([options.adapters])
        if options.config:
            core.loadSystemConfiguration(options.config)
        else:
            core.loadDevice(LABEL, options.library, options.device)
            core.initializeDevice(LABEL)
            core.setCameraDevice(LABEL)
        if not core.getCameraDevice():
            raise RigError(f"{options.config} selects no camera: set Core, Camera in it.")
        for key, value in options.properties.items():
            core.setProperty(core.getCameraDevice(), key, value)

    def _configure(self) -> CameraLimits:
        options, core = self._options, self._core
        core.clearROI()
        full_cols, full_rows = core.getImageWidth(), core.getImageHeight()
        cols, rows = options.cols or full_cols, options.rows or full_rows
        if options.left + cols > full_cols or options.top + rows > full_rows:
            raise RigError(
                f"{self._name} has {full_cols} x {full_rows} pixels: its region of {cols} x {rows} at "
                f"({options.left}, {options.top}) lies outside."
            )
        if (cols, rows) != (full_cols, full_rows):
            core.setROI(options.left, options.top, cols, rows)
        bits = core.getImageBitDepth()
        if core.getNumberOfComponents() != 1 or core.getBytesPerPixel() > 2:
            raise RigError(f"{self._name} sends colour or 32 bits per pixel: choose a monochrome type of 8 to 16 bits.")
        core.setCircularBufferMemoryFootprint(options.buffers * rows * cols * core.getBytesPerPixel() // 2**20 + 1)
        low_ms, high_ms = self._exposure_range_ms()
        return CameraLimits(
            frame_rate_hz=options.frame_rate_hz,
            exposure_min_us=max(options.exposure_min_us, low_ms * 1000),
            exposure_max_us=min(options.exposure_max_us, high_ms * 1000),
            readout_us=options.readout_us,
            rows=core.getImageHeight(),
            cols=core.getImageWidth(),
            queue_frames=options.buffers,
            bits=bits,
        )

    def _exposure_range_ms(self) -> tuple[float, float]:
        core, label = self._core, self._core.getCameraDevice()
        if core.hasProperty(label, "Exposure") and core.hasPropertyLimits(label, "Exposure"):
            return core.getPropertyLowerLimit(label, "Exposure"), core.getPropertyUpperLimit(label, "Exposure")
        return 0.0, float("inf")

    def _n_waiting(self) -> int:
        """Return the number of images in the buffer."""
        if self.trigger == "software":
            return 0
        with self._errors():
            if self._core.isBufferOverflowed():
                raise RigError(
                    f"{self._name} sent images faster than they were fetched, and the buffer of "
                    f"{self._options.buffers} frames is full: lower the frame rate or raise buffers."
                )
            waiting = self._core.getRemainingImageCount()
            if not waiting and not self._core.isSequenceRunning():
                raise RigError(f"{self._name} ended its sequence by itself: check its power and its cable.")
        return waiting

    def _pop(self) -> CameraImage:
        """Fetch an image. Its number is the core's, which counts arrivals, so it is no trigger counter."""
        metadata = self._metadata()
        with self._errors():
            image = self._image(self._core.popNextImageMD(metadata))
            time_us = self._time_us(metadata)
        return CameraImage(image, None, time_us, FrameStatus.OK)

    def _time_us(self, metadata: Any) -> int:
        if self._options.time == "camera":
            return round(float(metadata.GetSingleTag(CAMERA_MS).GetValue()) * 1000)
        arrival = datetime.fromisoformat(metadata.GetSingleTag(ARRIVAL).GetValue())
        return round(arrival.timestamp() * 1e6)

    def _image(self, values: Any) -> Image:
        limits = self._limits
        if values.shape != (limits.rows, limits.cols):
            raise RigError(
                f"{self._name} sent an image of {values.shape[1]} x {values.shape[0]} pixels instead of "
                f"{limits.cols} x {limits.rows}: do not change its settings during a run."
            )
        return full_range(values, limits.bits)

    def _require_open(self) -> None:
        if self._core is None:
            raise RigError(f"{self._name} is closed.")

    @contextmanager
    def _errors(self) -> Generator[None]:
        try:
            yield
        except (RuntimeError, OSError) as fault:
            raise RigError(f"{self._name} refuses or does not answer ({str(fault).rstrip('.')}).") from fault
