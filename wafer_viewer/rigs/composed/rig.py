"""Rig composed of devices by role."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeVar, cast

import msgspec

from wafer_viewer.model.acquisition.calibration import Calibration, OpticalSetup
from wafer_viewer.model.acquisition.devices import Camera, Clock, DeviceIdentity, Overview, SerialPort
from wafer_viewer.model.acquisition.plan import ScanPlan
from wafer_viewer.model.acquisition.rig_limits import CameraLimits, RigLimits
from wafer_viewer.model.errors import RigError, WaferViewerError
from wafer_viewer.model.progress import ShouldStop
from wafer_viewer.model.spec import Spec, replace
from wafer_viewer.rigs.cameras.drivers import CAMERAS
from wafer_viewer.rigs.composed.devices import DevicesConfig, ObjectiveConfig
from wafer_viewer.rigs.pulse_box.client import PulseBoxClient
from wafer_viewer.rigs.stages.controller_stage import ControllerPositioner, ControllerStage
from wafer_viewer.rigs.stages.controllers import CONTROLLERS
from wafer_viewer.rigs.stages.motion_controller import ControllerAxis, MotionController
from wafer_viewer.rigs.virtual.positioners import SimulatedPositioner
from wafer_viewer.rigs.virtual.rig import SIZES, VirtualRig, virtual_limits
from wafer_viewer.rigs.virtual.serial_port import VirtualPort

if TYPE_CHECKING:
    from serial.tools.list_ports_common import ListPortInfo


# --------------------------------------------------------------------------------------------------------- serial ports


T = TypeVar("T")
USB_NAME = "usb:"
"""Beginning of the name of a port that is found by the product name or the serial number of its device on USB."""
WRITE_TIMEOUT_S = 1.0
"""Time after which a port that accepts no bytes has failed, s."""


class SystemClock:
    """Implementation of Clock for real devices: the monotonic clock of this machine."""

    def __init__(self) -> None:
        self._origin_s = time.monotonic()

    def now_s(self) -> float:
        """Return the seconds since the rig was opened."""
        return time.monotonic() - self._origin_s

    def sleep(self, seconds: float) -> None:
        """Wait for a number of seconds."""
        time.sleep(max(0.0, seconds))


class ReopenedPort:
    """Implementation of SerialPort that opens a lost port again when its device is back.

    A device on USB takes its port along when it restarts or its cable is pulled. Until it is back, nothing is read and
    what is written is lost, as on a line to a silent device.

    name, baud : as for `open_port`, whose RigError it raises where the port cannot be opened at first.
    """

    def __init__(self, name: str, baud: int) -> None:
        self.timeout: float | None = 0.0
        self._name, self._baud = name, baud
        self._port: SerialPort | None = open_port(name, baud)

    @property
    def in_waiting(self) -> int:
        """Number of bytes that can be read without waiting."""
        return self._attempt(lambda port: port.in_waiting) or 0

    def read(self, size: int = 1, /) -> bytes:
        """Return up to `size` bytes, fewer on timeout."""
        if self._port is None:
            time.sleep(self.timeout or 0.0)
        return self._attempt(lambda port: self._read(port, size)) or b""

    def write(self, data: bytes, /) -> int:
        """Send bytes, after opening the port again if it was lost."""
        if self._port is None:
            with suppress(RigError):
                self._port = open_port(self._name, self._baud)
        return self._attempt(lambda port: port.write(data)) or 0

    def close(self) -> None:
        """Close the port."""
        self._attempt(lambda port: port.close())

    def _read(self, port: SerialPort, size: int) -> bytes:
        port.timeout = self.timeout
        return port.read(size)

    def _attempt(self, use: Callable[[SerialPort], T]) -> T | None:
        """Use the port; None where it is lost, now or since an earlier attempt."""
        if self._port is None:
            return None
        try:
            return use(self._port)
        except OSError:
            lost, self._port = self._port, None
            with suppress(OSError):
                lost.close()
            return None


def open_port(name: str, baud: int) -> SerialPort:
    """Open a serial port for this process alone. Raises RigError that names the ports of this machine.

    name : device, as /dev/ttyACM0 or COM3, or `USB_NAME` and the product name or serial number of a device on USB.
    """
    import serial
    from serial.tools import list_ports

    ports = sorted(list_ports.comports())
    try:
        device = _device(name, ports)
        port = serial.Serial(device, baud, timeout=0.0, write_timeout=WRITE_TIMEOUT_S, exclusive=True)
    except (OSError, ValueError) as fault:
        there = ", ".join(_description(port) for port in ports) or "none"
        raise RigError(
            f"The port {name} cannot be opened ({fault}): check its name, its cable and the right to use it; close "
            f"other programs that use it. Ports of this machine: {there}."
        ) from fault
    return cast(SerialPort, port)


def _device(name: str, ports: Sequence[ListPortInfo]) -> str:
    """Return the device of a port. Raises OSError unless exactly one has the name."""
    if not name.startswith(USB_NAME):
        return name
    wanted = name.removeprefix(USB_NAME).casefold()
    found = [port.device for port in ports if wanted in (own.casefold() for own in _usb_names(port))]
    if len(found) != 1:
        several = (
            f"{', '.join(found)} have this name: use a serial number" if found else "no device on USB has this name"
        )
        raise OSError(several)
    return found[0]


def _usb_names(port: ListPortInfo) -> list[str]:
    return [own for own in (port.product, port.serial_number) if own]


def _description(port: ListPortInfo) -> str:
    names = " or ".join(USB_NAME + own for own in _usb_names(port))
    return f"{port.device} ({names})" if names else port.device


# ------------------------------------------------------------------------------------------------------------------ rig


VIRTUAL_CAMERA = "virtual"
"""Driver of the camera over a simulated stage, in a rig's file."""


class VirtualCameraOptions(Spec, frozen=True, kw_only=True):
    """Settings of the virtual camera: the scene on the simulated stage, and its size."""

    error: ClassVar[type[WaferViewerError]] = RigError
    scene: str = "wafer"
    size: Literal["small", "full"] = "small"


class DeviceOpener:
    """Opener of the devices of a rig, one by one; simulated ones belong to one virtual rig.

    name : display name of the rig; real_time, seed : of simulated devices, as in a rig's file.
    """

    def __init__(self, name: str, devices: DevicesConfig, *, real_time: bool = False, seed: int | None = None) -> None:
        self.name, self.devices = name, devices
        self._real_time, self._seed = real_time, seed

    @cached_property
    def virtual(self) -> VirtualRig | None:
        """Virtual rig at the far end of simulated ports; None where the ports are real."""
        if not self.devices.simulated:
            return None
        options = _options(self.devices.camera.options)
        devices = {
            name: SimulatedPositioner.resting(config.limits) for name, config in self.devices.positioners.items()
        }
        optics = self.devices.optics({name: device.at for name, device in devices.items()})
        limits = self.devices.limits(virtual_limits(*SIZES[options.size]).camera, optics)
        return VirtualRig(
            options.scene,
            name=self.name,
            limits=limits,
            real_time=self._real_time,
            seed=self._seed,
            positioners=devices,
        )

    @cached_property
    def clock(self) -> Clock:
        """Clock of the rig."""
        return SystemClock() if self.virtual is None else self.virtual.clock

    def controller(self, name: str) -> MotionController:
        """Connect to a motion controller."""
        axes = self.devices.axes_of(name)
        driver = CONTROLLERS[self.devices.controllers[name].driver]
        port = self._controller_port(name)
        try:
            return driver.connect(port, self.clock, {axis: ControllerAxis.of(config) for axis, config in axes.items()})
        except RigError as fault:
            port.close()
            raise type(fault)(f"{driver.title} '{name}' at {self.devices.controllers[name].port}: {fault}") from fault

    def controllers(self) -> dict[str, MotionController]:
        """Connect to all controllers; those that answered are closed when one does not."""
        opened: dict[str, MotionController] = {}
        try:
            for name in self.devices.controllers:
                opened[name] = self.controller(name)
        except RigError:
            for controller in opened.values():
                controller.close()
            raise
        return opened

    def stage(self, controllers: Mapping[str, MotionController]) -> ControllerStage:
        """Return the stage on all connected controllers."""
        return ControllerStage(controllers, self.devices.axes.by_name(), self.clock)

    def positioner(self, name: str, controllers: Mapping[str, MotionController]) -> ControllerPositioner:
        """Return a positioner on a connected controller, whose position is asked for."""
        config = self.devices.positioners[name]
        return ControllerPositioner(name, config.limits, controllers[config.controller], config.axis, self.clock)

    def box(self) -> PulseBoxClient:
        """Connect to the pulse box."""
        if self.virtual is not None:
            return self.virtual.box
        config = self.devices.pulse_box
        return PulseBoxClient(ReopenedPort(config.port, config.baud), self.clock)

    def camera(self) -> ComposedCamera:
        """Connect to the camera."""
        config = self.devices.camera
        if config.driver == VIRTUAL_CAMERA:
            return _virtual_camera(self)
        if config.driver not in CAMERAS:
            raise RigError(
                f"devices.camera.driver is '{config.driver}': it must be one of "
                f"{', '.join((VIRTUAL_CAMERA, *CAMERAS))}."
            )
        if self.devices.simulated:
            raise RigError(
                f"devices.camera.driver is '{config.driver}', which does not see a simulated stage: name the "
                f"'{VIRTUAL_CAMERA}' camera, or give the devices their real ports."
            )
        camera = CAMERAS[config.driver].connect(config.options)
        if camera.trigger != "hardware":
            camera.close()
            raise RigError(
                f"The {camera.name} is set to its {camera.trigger} trigger, and a scan needs frames at the pulses of "
                "the box: set the trigger of devices.camera.options to 'hardware'."
            )
        return ComposedCamera(camera, camera.limits, camera.name, camera.close)

    def _controller_port(self, name: str) -> SerialPort:
        config, virtual = self.devices.controllers[name], self.virtual
        driver = CONTROLLERS[config.driver]
        if virtual is None:
            return open_port(config.port, config.baud or driver.baud)
        simulated = driver.simulate(virtual.clock, virtual.stage, self.devices.axes_of(name))
        port = VirtualPort(virtual.clock, simulated)
        simulated.connect(port.deliver)
        return port


@dataclass(frozen=True, slots=True)
class ComposedCamera:
    """Connected camera with its limits and its own name; `close` disconnects from it."""

    device: Camera
    limits: CameraLimits
    name: str
    close: Callable[[], None] = lambda: None


def _options(given: dict[str, Any]) -> VirtualCameraOptions:
    try:
        return msgspec.convert(given, VirtualCameraOptions)
    except msgspec.ValidationError as fault:
        raise RigError(f"devices.camera.options: {fault}: correct it in the rig's file.") from fault


def _virtual_camera(opener: DeviceOpener) -> ComposedCamera:
    if opener.virtual is None:
        raise RigError(
            f"devices.camera.driver is '{VIRTUAL_CAMERA}', which sees simulated stages only: name the driver of the "
            "camera, or give all devices the port 'simulated'."
        )
    return ComposedCamera(opener.virtual.camera, opener.virtual.limits.camera, "virtual camera")


class ComposedRig:
    """Implementation of Rig from the devices of its file."""

    def __init__(self, opener: DeviceOpener) -> None:
        self._opener = opener
        self._found: ObjectiveConfig | None = None
        self._found_at: dict[str, float | None] = {}
        self._camera = opener.camera()
        try:
            controllers = opener.controllers()
        except RigError:
            self._camera.close()
            raise
        self._stage = opener.stage(controllers)
        try:
            self._positioners = {name: opener.positioner(name, controllers) for name in opener.devices.positioners}
            self._box = opener.box()
        except RigError:
            self._stage.close()
            self._camera.close()
            raise
        for positioner in self._positioners.values():
            positioner.on_arrival(self._look_through)

    @property
    def name(self) -> str:
        """Display name of the rig."""
        return self._opener.name

    @property
    def simulated(self) -> bool:
        """True if its ports are simulated."""
        return self._opener.devices.simulated

    @property
    def limits(self) -> RigLimits:
        """Limits of the rig: those of its file, its camera, its pulse box and the objective in the light path."""
        limits = self._opener.devices.limits(self._camera.limits, self._optics)
        return replace(limits, count_rate_hz=float(self._box.identity.count_rate_hz))

    @property
    def setup(self) -> OpticalSetup:
        """Optical setup, by the last known positions of nosepiece and zoom."""
        return self._opener.devices.setup(self._optics)

    @property
    def calibration(self) -> Calibration | None:
        """Calibration of its file for the optical setup."""
        return self._opener.devices.calibration_of(self.setup)

    @property
    def positioners(self) -> Mapping[str, ControllerPositioner]:
        """Positioners of its file."""
        return self._positioners

    @property
    def _optics(self) -> ObjectiveConfig:
        """Objective in the light path, found again when a positioner has moved: limits are asked for often."""
        positions = {name: one.known for name, one in self._positioners.items()}
        if self._found is None or positions != self._found_at:
            self._found, self._found_at = self._opener.devices.optics(positions), positions
        return self._found

    def _look_through(self) -> None:
        """Show the simulated sample through the objective that is in the light path now."""
        if self._opener.virtual is not None:
            self._opener.virtual.look_through(self.limits)

    @property
    def clock(self) -> Clock:
        """Clock of the rig."""
        return self._opener.clock

    @property
    def stage(self) -> ControllerStage:
        """Stage of the rig."""
        return self._stage

    @property
    def box(self) -> PulseBoxClient:
        """Pulse box of the rig."""
        return self._box

    @property
    def camera(self) -> Camera:
        """Camera of the rig."""
        return self._camera.device

    def identities(self) -> tuple[DeviceIdentity, ...]:
        """Ask the controllers and the pulse box what they are; the camera was asked when it was opened."""
        devices = self._opener.devices
        return (
            *(
                DeviceIdentity(role=f"controller '{name}'", driver=devices.controllers[name].driver, identity=identity)
                for name, identity in self._stage.identities().items()
            ),
            DeviceIdentity(role="pulse box", driver="WPC/2", identity=self._box.identity.name),
            DeviceIdentity(role="camera", driver=devices.camera.driver, identity=self._camera.name),
        )

    def overview(self) -> Overview | None:
        """Return the overview of a simulated sample, or None."""
        return None if self._opener.virtual is None else self._opener.virtual.overview()

    def prepare(self, plan: ScanPlan, should_stop: ShouldStop) -> None:
        """Prepare the simulated camera for a plan; real devices need no preparation."""
        if self._opener.virtual is not None:
            self._opener.virtual.prepare(plan, should_stop)

    def close(self) -> None:
        """Stop motion, stop the pulses, and close the ports. What fails does not keep the rest from being done."""
        virtual = self._opener.virtual
        ends = (self._stage.close, self._box.close if virtual is None else virtual.close)
        for step in (self._box.halt, self._stage.stop, self._camera.device.stop, self._camera.close, *ends):
            try:
                step()
            except (RigError, OSError):
                continue
