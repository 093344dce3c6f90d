"""GigE Vision and USB3 Vision cameras, through the Aravis library.

Every run has a stream of its own, so that packets of an earlier run cannot enter it. Frames with missing packets are
reported without an image. Their frame numbers and times may be those of an earlier frame in the same buffer, so
numbers are read from complete frames only.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
import threading
import time
import warnings
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any

from wafer_viewer.model.acquisition.devices import CameraImage
from wafer_viewer.model.acquisition.focus_stack import FrameStatus
from wafer_viewer.model.acquisition.rig_limits import CameraLimits
from wafer_viewer.model.errors import RigError
from wafer_viewer.model.spec import Within
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

MEND = "as root: apt-get install gir1.2-aravis-0.8 python3-gi"
SYSTEM_GI = Path("/usr/lib/python3/dist-packages/gi/__init__.py")
"""Debian's PyGObject, which a virtual environment with the same Python version can load."""
SOCKET_BYTES = 4 << 20
"""Receive buffer of a stream; the limit of the system (`net.core.rmem_max`) applies."""


class AravisOptions(GenICamOptions, frozen=True, kw_only=True):
    """Settings of a camera on Aravis.

    packet_bytes: of a GigE Vision stream; 0 for the largest one that the network passes.
    """

    packet_bytes: Annotated[int, Within(0, 16_000)] = 0


def import_aravis() -> Any:
    """Import Aravis through PyGObject. Raises RigError with the remedy when it is missing."""
    _use_system_gi()
    gi = import_library("gi", "PyGObject, which Aravis cameras need,", f"{MEND}, or pip install PyGObject")
    try:
        gi.require_version("Aravis", "0.8")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ImportWarning)  # older PyGObject has an importer of an older style
            return importlib.import_module("gi.repository.Aravis")
    except (ImportError, ValueError) as fault:
        raise RigError(f"Aravis 0.8 is not installed ({fault}): {MEND}.") from fault


def _use_system_gi() -> None:
    """Load Debian's PyGObject if the environment has none of its own."""
    if "gi" in sys.modules or importlib.util.find_spec("gi") is not None:
        return
    extension = f"_gi.{sys.implementation.cache_tag}-*.so"
    if not any(SYSTEM_GI.parent.glob(extension)):
        return
    spec = importlib.util.spec_from_file_location("gi", SYSTEM_GI, submodule_search_locations=[str(SYSTEM_GI.parent)])
    if spec is None or spec.loader is None:
        return
    sys.modules["gi"] = module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except ImportError:
        del sys.modules["gi"]


class AravisCamera(CameraHead):
    """Implementation of ConnectedCamera for GigE Vision and USB3 Vision."""

    def __init__(self, options: AravisOptions) -> None:
        super().__init__("The Aravis camera", options.trigger_kind)
        format_of(options.pixel_format)
        self._options = options
        self._aravis = import_aravis()
        self._glib = importlib.import_module("gi.repository.GLib")
        self._lost = threading.Event()
        self._camera: Any = None
        self._stream: Any = None
        self._numbers = FrameNumbers()
        self._last_us = NO_TIME
        with self._errors():
            self._camera = self._aravis.Camera.new(_find(self._aravis, options.device))
            self._name = _name_of(self._camera)
        device = self._camera.get_device()
        if self._camera.is_gv_device() and not device.is_controller():
            raise RigError(f"{self._name} is controlled by another program: close that program.")
        lost = self._lost
        device.connect("control-lost", lambda *_: lost.set())
        with self._errors():
            self._configure()
            self._limits = self._read_limits()

    def start(self, exposure_us: float) -> None:
        """Start waiting for triggers on a new stream."""
        self.stop()
        self._require_exposure(exposure_us)
        self._require_connection()
        with self._errors():
            self._camera.set_exposure_time(float(exposure_us))
            if self.trigger == "free" and self._camera.is_frame_rate_available():
                self._camera.set_frame_rate(self._limits.frame_rate_hz)
            stream = self._new_stream()
            self._camera.start_acquisition()
        self._numbers, self._last_us, self._stream = FrameNumbers(), NO_TIME, stream

    def fire(self) -> None:
        """Send a software trigger."""
        self._require_software_trigger()
        with self._errors():
            self._camera.software_trigger()

    def next_image(self, timeout_s: float) -> CameraImage | None:
        """Return the next image, or None on timeout. Raises RigError when the camera is lost."""
        deadline_s = time.monotonic() + timeout_s
        while self._stream is not None:
            left_us = round(max(0.0, deadline_s - time.monotonic()) * 1e6)
            buffer = self._stream.timeout_pop_buffer(left_us) if left_us else self._stream.try_pop_buffer()
            if buffer is None:
                self._require_connection()
                return None
            try:
                if buffer.get_status() != self._aravis.BufferStatus.ABORTED:
                    return self._image(buffer)
            finally:
                self._stream.push_buffer(buffer)
        return None

    def stop(self) -> None:
        """Stop waiting for triggers; images not fetched are dropped."""
        if self._stream is None:
            return
        self._stream = None
        if not self._lost.is_set():
            with self._errors():
                self._camera.stop_acquisition()

    def close(self) -> None:
        """Stop and disconnect; a second call does nothing."""
        with suppress(RigError):
            self.stop()
        self._camera = None

    def _configure(self) -> None:
        options, camera = self._options, self._camera
        require_choice(
            self._name, "pixel format", options.pixel_format, list(camera.dup_available_pixel_formats_as_strings())
        )
        camera.set_pixel_format_from_string(options.pixel_format)
        _, widest = camera.get_width_bounds()
        _, highest = camera.get_height_bounds()
        camera.set_region(options.left, options.top, options.cols or widest, options.rows or highest)
        camera.set_acquisition_mode(self._aravis.AcquisitionMode.CONTINUOUS)
        if camera.is_exposure_auto_available():
            camera.set_exposure_time_auto(self._aravis.Auto.OFF)
        if camera.is_feature_available("ExposureMode"):
            camera.set_string("ExposureMode", "Timed")
        if options.gain is not None:
            self._set_gain(options.gain)
        self._set_trigger()
        if camera.is_gv_device():
            self._configure_network()

    def _set_gain(self, gain: float) -> None:
        camera = self._camera
        low, high = camera.get_gain_bounds()
        if not low <= gain <= high:
            raise RigError(f"{self._name} has no gain {gain:g}: its range is {low:g} to {high:g}.")
        if camera.is_gain_auto_available():
            camera.set_gain_auto(self._aravis.Auto.OFF)
        camera.set_gain(gain)

    def _set_trigger(self) -> None:
        if self.trigger == "free":
            self._camera.clear_triggers()
            return
        sources = list(self._camera.dup_available_trigger_sources())
        require_choice(self._name, "trigger source", self._options.trigger, sources)
        self._camera.set_trigger(self._options.trigger)

    def _configure_network(self) -> None:
        """Set the packets; packet sockets need privileges and receive nothing on some interfaces."""
        self._camera.gv_set_stream_options(self._aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
        if self._options.packet_bytes:
            self._camera.gv_set_packet_size(self._options.packet_bytes)
        else:
            self._camera.gv_auto_packet_size()

    def _read_limits(self) -> CameraLimits:
        camera, region = self._camera, self._camera.get_region()
        shortest_us, longest_us = camera.get_exposure_time_bounds()
        highest_hz = camera.get_frame_rate_bounds()[1] if camera.is_frame_rate_available() else 1e6 / shortest_us
        return self._options.limits_of(region.height, region.width, (shortest_us, longest_us), highest_hz)

    def _new_stream(self) -> Any:
        stream = self._camera.create_stream(None, None)
        if self._camera.is_gv_device():
            stream.set_property("socket-buffer", self._aravis.GvStreamSocketBuffer.FIXED)
            stream.set_property("socket-buffer-size", SOCKET_BYTES)
        payload = self._camera.get_payload()
        for _ in range(self._options.buffers):
            stream.push_buffer(self._aravis.Buffer.new_allocate(payload))
        return stream

    def _image(self, buffer: Any) -> CameraImage:
        time_us = (buffer.get_timestamp() or buffer.get_system_timestamp()) // 1000
        if buffer.get_status() != self._aravis.BufferStatus.SUCCESS:
            self._numbers.skip()
            return CameraImage(None, None, time_us if time_us > self._last_us else NO_TIME, FrameStatus.INCOMPLETE)
        self._last_us = time_us
        limits = self._limits
        image = decode_image(buffer.get_data(), self._options.pixel_format, limits.rows, limits.cols)
        return CameraImage(image, self._numbers.count(buffer.get_frame_id()), time_us, FrameStatus.OK)

    def _require_connection(self) -> None:
        if self._camera is None:
            raise RigError(f"{self._name} is closed.")
        if self._lost.is_set():
            raise RigError(f"{self._name} no longer answers: check its power and its cable, then open the rig again.")

    @contextmanager
    def _errors(self) -> Generator[None]:
        try:
            yield
        except self._glib.Error as fault:
            raise RigError(
                f"{self._name} refuses or does not answer ({fault.message}): check its power, its cable and that no "
                "other program uses it."
            ) from fault


def _find(aravis: Any, wanted: str) -> str:
    """Return the identifier of the wanted camera; an IP address is used as it is."""
    if wanted and all(part.isdigit() for part in wanted.split(".")) and wanted.count(".") == 3:
        return wanted
    aravis.update_device_list()
    found = [
        (aravis.get_device_id(i), aravis.get_device_serial_nbr(i) or "", aravis.get_device_address(i) or "")
        for i in range(aravis.get_n_devices())
    ]
    return found[select_device(wanted, found, "by Aravis")][0]


def _name_of(camera: Any) -> str:
    return f"{camera.get_vendor_name()} {camera.get_model_name()} {camera.get_device_serial_number() or ''}".strip()
