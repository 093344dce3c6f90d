"""Cameras with a GenTL producer of their maker, through Harvesters."""

from __future__ import annotations

import importlib
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from wafer_viewer.model.acquisition.devices import CameraImage
from wafer_viewer.model.acquisition.focus_stack import FrameStatus
from wafer_viewer.model.acquisition.rig_limits import CameraLimits
from wafer_viewer.model.errors import RigError
from wafer_viewer.model.spec import NonNegative
from wafer_viewer.rigs.cameras.base import (
    NO_TIME,
    CameraHead,
    FrameNumbers,
    GenICamOptions,
    decode_image,
    format_of,
    import_library,
    require_choice,
    select_device,
)

MEND = "pip install 'wafer-viewer[gentl]'"
SHORTEST_WAIT_S = 1e-4
"""Harvesters waits without end for a timeout of 0."""


class GenTLOptions(GenICamOptions, frozen=True, kw_only=True):
    """Settings of a camera with a GenTL producer.

    producer: the .cti file of the camera's maker; exposure_us: exposure of a camera that offers no setting for it.
    """

    producer: str
    exposure_us: NonNegative = 0.0


def import_harvesters() -> Any:
    """Import Harvesters. Raises RigError with the remedy when it is missing."""
    return import_library("harvesters.core", "Harvesters, which GenTL cameras need,", MEND)


class GenTLCamera(CameraHead):
    """Implementation of ConnectedCamera on a GenTL producer; times are of arrival where it gives none."""

    def __init__(self, options: GenTLOptions) -> None:
        super().__init__(f"The camera on {Path(options.producer).name}", options.trigger_kind)
        format_of(options.pixel_format)
        core = import_harvesters()
        self._errors_of_library = tuple(
            importlib.import_module(name).GenericException for name in ("genicam.gentl", "genicam.genapi")
        )
        self._options = options
        self._numbers = FrameNumbers()
        self._n_incomplete = 0
        self._running = False
        self._acquirer: Any = None
        if not Path(options.producer).is_file():
            raise RigError(f"The GenTL producer {options.producer!r} does not exist: install the driver of the camera.")
        self._harvester: Any = core.Harvester()
        try:
            with self._errors():
                self._open(core)
        except RigError:
            self.close()
            raise

    def start(self, exposure_us: float) -> None:
        """Start waiting for triggers."""
        self.stop()
        self._require_exposure(exposure_us)
        if self._acquirer is None:
            raise RigError(f"{self._name} is closed.")
        self._numbers, self._n_incomplete = FrameNumbers(), 0
        with self._errors():
            if (exposure := self._node("ExposureTime")) is not None:
                exposure.value = exposure_us
            self._acquirer.start()
        self._running = True

    def fire(self) -> None:
        """Send a software trigger."""
        self._require_software_trigger()
        with self._errors():
            self._require("TriggerSoftware").execute()

    def next_image(self, timeout_s: float) -> CameraImage | None:
        """Return the next image, or None on timeout."""
        if not self._running:
            return None
        before = self._n_incomplete
        with self._errors():
            buffer = self._acquirer.try_fetch(timeout=max(timeout_s, SHORTEST_WAIT_S), is_raw=True)
            if buffer is not None:
                try:
                    return self._image(buffer)
                finally:
                    buffer.parent.queue_buffer(buffer)
        if self._n_incomplete == before:
            return None
        self._numbers.skip()
        return CameraImage(None, None, NO_TIME, FrameStatus.INCOMPLETE)

    def stop(self) -> None:
        """Stop waiting for triggers; images not fetched are dropped."""
        if not self._running:
            return
        self._running = False
        with self._errors():
            self._acquirer.stop()

    def close(self) -> None:
        """Stop and disconnect; a second call does nothing."""
        if self._harvester is None:
            return
        with suppress(RigError):
            self.stop()
        with suppress(RigError), self._errors():
            if self._acquirer is not None:
                self._acquirer.destroy()
            self._harvester.reset()
        self._acquirer = self._harvester = None

    def _open(self, core: Any) -> None:
        self._harvester.add_file(self._options.producer)
        self._harvester.update()
        devices = self._harvester.device_info_list
        found = [(d.id_, d.serial_number or "", d.display_name or "") for d in devices]
        index = select_device(self._options.device, found, f"by {Path(self._options.producer).name}")
        self._name = f"{devices[index].vendor} {devices[index].model} {devices[index].serial_number}"
        self._acquirer = self._harvester.create(index)
        counter = type("IncompleteFrames", (core.Callback,), {"emit": self._record_incomplete})()
        self._acquirer.add_callback(self._acquirer.Events.INCOMPLETE_BUFFER, counter)
        self._configure()
        self._limits = self._read_limits()

    def _record_incomplete(self, context: object = None) -> None:
        self._n_incomplete += 1

    def _configure(self) -> None:
        options = self._options
        self._select("PixelFormat", options.pixel_format)
        for name, value in (("OffsetX", 0), ("OffsetY", 0)):
            if (node := self._node(name)) is not None:
                node.value = value
        width, height = self._require("Width"), self._require("Height")
        width.value, height.value = options.cols or width.max, options.rows or height.max
        for name, value in (("OffsetX", options.left), ("OffsetY", options.top)):
            if value:
                self._require(name).value = value
        if options.gain is not None:
            self._require("Gain").value = options.gain
        self._select("ExposureMode", "Timed", optional=True)
        self._set_trigger()
        self._acquirer.num_buffers = options.buffers

    def _set_trigger(self) -> None:
        if self.trigger == "free":
            self._select("TriggerMode", "Off", optional=True)
            if self._options.frame_rate_hz and (rate := self._node("AcquisitionFrameRate")) is not None:
                rate.value = min(self._options.frame_rate_hz, rate.max)
            return
        self._select("TriggerSelector", "FrameStart", optional=True)
        self._select("TriggerSource", self._options.trigger)
        if self.trigger == "hardware":
            self._select("TriggerActivation", "RisingEdge", optional=True)
        self._select("TriggerMode", "On")

    def _read_limits(self) -> CameraLimits:
        options, exposure, rate = self._options, self._node("ExposureTime"), self._node("AcquisitionFrameRate")
        if exposure is None and not options.exposure_us:
            raise RigError(f"{self._name} offers no exposure time: give its fixed one as exposure_us.")
        shortest_us = exposure.min if exposure is not None else options.exposure_us
        longest_us = exposure.max if exposure is not None else options.exposure_us
        highest_hz = rate.max if rate is not None else 1e6 / shortest_us
        rows, cols = self._require("Height").value, self._require("Width").value
        return options.limits_of(rows, cols, (shortest_us, longest_us), highest_hz)

    def _image(self, buffer: Any) -> CameraImage:
        limits = self._limits
        image = decode_image(buffer.raw_buffer, self._options.pixel_format, limits.rows, limits.cols)
        return CameraImage(image, self._numbers.count(buffer.frame_id), self._time_us(buffer), FrameStatus.OK)

    def _time_us(self, buffer: Any) -> int:
        try:
            return buffer.timestamp_ns // 1000
        except self._errors_of_library:
            return time.monotonic_ns() // 1000

    def _node(self, name: str) -> Any:
        """Return a feature of the camera, or None."""
        return getattr(self._acquirer.remote_device.node_map, name, None)

    def _require(self, name: str) -> Any:
        if (node := self._node(name)) is None:
            raise RigError(f"{self._name} offers no {name}: it cannot be used with these options.")
        return node

    def _select(self, name: str, value: str, *, optional: bool = False) -> None:
        if optional and self._node(name) is None:
            return
        node = self._require(name)
        require_choice(self._name, name, value, list(node.symbolics))
        node.value = value

    @contextmanager
    def _errors(self) -> Generator[None]:
        try:
            yield
        except self._errors_of_library as fault:
            raise RigError(
                f"{self._name} refuses or does not answer ({fault}): check its power, its cable and that no other "
                "program uses it."
            ) from fault
