"""Role of a motion controller, the settings of its axes, and the descriptor of its driver.

A controller counts in units of its own: microsteps on a Zaber, mm on GRBL and PI. The rig's file says how many of them
are a um; above the controllers everything is in um.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import ClassVar, Protocol

from wafer_viewer.model.acquisition.devices import Clock, SerialPort
from wafer_viewer.model.acquisition.rig_limits import AxisLimits
from wafer_viewer.model.errors import RigError, WaferViewerError
from wafer_viewer.rigs.virtual.clock import VirtualClock
from wafer_viewer.rigs.virtual.serial_port import Device
from wafer_viewer.rigs.virtual.stage import VirtualStage


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
