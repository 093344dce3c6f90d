"""Role of a motion controller, the settings of its axes, and the descriptor of its driver.

A controller counts in units of its own: microsteps on a Zaber, mm on GRBL and PI. The rig's file says how many of them
are a um; above the controllers everything is in um.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import ClassVar, Protocol

from wafer_viewer.model.acquisition.devices import Clock, SerialPort
from wafer_viewer.model.acquisition.rig_limits import AxisLimits
from wafer_viewer.model.errors import RigError, RigTimeout, WaferViewerError
from wafer_viewer.rigs.virtual.clock import VirtualClock
from wafer_viewer.rigs.virtual.serial_port import Device
from wafer_viewer.rigs.virtual.stage import VirtualStage

# ---------------------------------------------------------------------------------------------------------- serial line


REPLY_S = 0.25
"""Time in s after which a controller does not answer any more: over ten times what they take."""
TRIES = 3
"""Number of times that a command without an answer is sent. All commands name goals, so that once more does no harm."""
QUIET_S = 0.05
"""Silence in s after which no further late answer is expected."""
WAKE_S = 3.0
"""Time in s in which a controller that restarts when its port is opened begins to answer."""
MOST_READS = 100
"""Number of reads after which a controller that never falls silent is taken as it is."""
LONGEST_LINE = 4096
"""Bytes without a line end after which what arrives is no text of a controller."""


class SerialLine:
    """Sender of commands and reader of lines; errors of its port become a RigError that names the device."""

    def __init__(self, port: SerialPort, clock: Clock, device: str) -> None:
        self._port, self._clock, self.device = port, clock, device
        self._buffer = b""

    def send(self, data: bytes) -> None:
        """Send bytes."""
        with self._cable():
            self._port.write(data)

    def line(self, within_s: float = REPLY_S) -> str | None:
        """Return the next line without its line end, or None when none is complete in time."""
        until_s = self._clock.now_s() + within_s
        while b"\n" not in self._buffer:
            left_s = max(0.0, until_s - self._clock.now_s())
            with self._cable():
                self._port.timeout = left_s
                data = self._port.read(max(1, self._port.in_waiting))
            self._buffer = (self._buffer + data)[-LONGEST_LINE:]
            if left_s == 0.0 and b"\n" not in data:
                return None
        line, _, self._buffer = self._buffer.partition(b"\n")
        return line.decode("latin-1").rstrip("\r")

    def lines(self, within_s: float = REPLY_S) -> Generator[str]:
        """Yield lines until none arrives any more within a time that all of them share."""
        until_s = self._clock.now_s() + within_s
        while (line := self.line(max(0.0, until_s - self._clock.now_s()))) is not None:
            yield line
            if self._clock.now_s() > until_s:
                return

    def discard(self, quiet_s: float = 0.0) -> None:
        """Drop what has arrived, and go on until nothing arrives for a time."""
        self._buffer = b""
        with self._cable():
            self._port.timeout = quiet_s
            for _ in range(MOST_READS):
                if not self._port.read(1):
                    return
                self._port.read(self._port.in_waiting)

    def silent(self, command: str) -> RigTimeout:
        """Return the error for a command without an answer."""
        return RigTimeout(
            f"The {self.device} did not answer '{command}' in {TRIES} tries of {REPLY_S:g} s: check its power, its "
            "cable, the port and its speed in the rig's file."
        )

    def close(self) -> None:
        """Close the port."""
        with self._cable():
            self._port.close()

    @contextmanager
    def _cable(self) -> Generator[None]:
        try:
            yield
        except OSError as fault:
            raise RigError(
                f"The {self.device} was lost ({fault.strerror or fault}): check its cable and its power, and open the "
                "rig again."
            ) from fault


# ---------------------------------------------------------------------------------------------------- motion controller


class AxisConfig(AxisLimits, frozen=True, kw_only=True):
    """Axis of a stage: its limits, and its place on a controller. The tables ``[devices.axes.x]``, y and z.

    Parameters
    ----------
    controller : name of the controller in the table ``[devices.controllers]``.
    address : the axis on its controller, as its driver names it.
    units_per_um : units of the controller in a um; negative where the controller counts the other way.
    zero_units : position of the controller at 0 um.
    counts_per_um : counts of the scale that the pulse box counts, in a um.
    index_um : position of the index mark that is wired to the pulse box, which a scan then moves over; left out if
        there is none.
    low_um, high_um : range in which the axis may move. It lies within the travel of the controller.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    controller: str
    address: str
    units_per_um: float
    zero_units: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.units_per_um == 0:
            self.refuse("units_per_um", "over 0, or below 0 where the controller counts the other way")

    @property
    def limits(self) -> AxisLimits:
        """Limits of the axis, for the planner."""
        return AxisLimits(**{name: getattr(self, name) for name in AxisLimits.__struct_fields__})

    def units_at(self, position_um: float) -> float:
        """Return the position on the controller."""
        return self.zero_units + position_um * self.units_per_um

    def position_at(self, units: float) -> float:
        """Return the position in um of a position on the controller."""
        return (units - self.zero_units) / self.units_per_um

    def rate(self, per_um: float) -> float:
        """Return a speed or an acceleration on the controller, from one in um."""
        return per_um * abs(self.units_per_um)


@dataclass(frozen=True, slots=True)
class ControllerAxis:
    """Axis of a controller: its address, and its largest speed and its acceleration in units/s and units/s^2."""

    address: str
    speed: float
    acceleration: float

    @classmethod
    def of(cls, config: AxisConfig) -> ControllerAxis:
        """Return the axis of a configuration."""
        return cls(config.address, config.rate(config.speed_um_s), config.rate(config.acceleration_um_s2))


class MotionController(Protocol):
    """Axes of one controller, by the names of the rig's file, in units of the controller.

    No call waits for a motion. Each raises RigError when the controller refuses or reports a fault, and RigTimeout when
    it does not answer.
    """

    def identity(self) -> str:
        """Return what the controller says that it is."""
        ...

    def positions(self) -> Mapping[str, float]:
        """Return the position of every axis; the last known one while a controller that searches does not answer."""
        ...

    def moving(self) -> Collection[str]:
        """Return the axes that move or have not settled on their goal."""
        ...

    def homed(self) -> Collection[str]:
        """Return the axes that know where their zero is."""
        ...

    def home(self, axes: Collection[str]) -> None:
        """Begin to search the reference of some axes; a controller may take all of its axes along."""
        ...

    def move(self, goals: Mapping[str, float], speeds: Mapping[str, float]) -> None:
        """Begin to move axes to their goals, each at its speed in units/s at most."""
        ...

    def stop(self) -> None:
        """Decelerate all axes to a halt, also in the middle of a search."""
        ...

    def close(self) -> None:
        """Close the port."""
        ...


class SimulatedDevice(Device, Protocol):
    """Simulated controller at the far end of a virtual port."""

    def connect(self, deliver: Callable[[bytes, float], None], /) -> None:
        """Set what sends bytes that answer no command."""
        ...


@dataclass(frozen=True, slots=True)
class ControllerDriver:
    """Driver of a kind of controllers.

    Parameters
    ----------
    name : name in a rig's file.
    title : name of the controllers.
    baud : usual speed of the port.
    address : pattern of the address of an axis.
    address_words : the same in words.
    connect : opens a controller on a port. Raises RigError when it does not answer as this kind does.
    simulate : makes a simulated controller that moves the virtual stage and its positioners.
    """

    name: str
    title: str
    baud: int
    address: str
    address_words: str
    connect: Callable[[SerialPort, Clock, Mapping[str, ControllerAxis]], MotionController]
    simulate: Callable[[VirtualClock, VirtualStage, Mapping[str, AxisConfig]], SimulatedDevice]
