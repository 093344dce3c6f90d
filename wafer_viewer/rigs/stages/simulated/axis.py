"""Simulated controllers and their axes, which move the virtual stage and count in the units of the controller."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping

from wafer_viewer.rigs.stages.motion_controller import AxisConfig
from wafer_viewer.rigs.virtual.clock import VirtualClock
from wafer_viewer.rigs.virtual.stage import VirtualStage

HOMING_SPEED_FRACTION = 0.2
"""Speed of a search as a fraction of the full speed."""


class SimulatedAxis:
    """Axis with a counter that starts at 0 wherever the stage stands at power-up, and knows its zero once homed.

    Its travel is the range of its configuration. The reference lies at its low end, or in its middle.
    """

    def __init__(
        self, clock: VirtualClock, stage: VirtualStage, name: str, config: AxisConfig, *, middle: bool = False
    ) -> None:
        self._clock, self._stage, self._config = clock, stage, config
        self._name = name
        self._reference_um = (config.low_um + config.high_um) / 2 if middle else config.low_um
        self._searching = False
        self.switch_on()

    def switch_on(self) -> None:
        """Lose the reference: the counter starts at 0 here."""
        self.homed = self._searching = self.stalled = self.endless = False
        self._zero_um = self._true_um()
        self._zero_units = 0.0

    @property
    def units(self) -> float:
        """Position on the counter of the controller."""
        return self._zero_units + (self._true_um() - self._zero_um) * self._config.units_per_um

    @property
    def moving(self) -> bool:
        """True while the axis reports motion, for ever with `endless`; the end of a search sets the counter."""
        moving = self.endless or self._stage.axis(self._name).moving(self._clock.now_s())
        if self._searching and not moving:
            self._searching, self.homed = False, True
            self._zero_um, self._zero_units = 0.0, self._config.zero_units
        return moving

    @property
    def searching(self) -> bool:
        """True while the axis searches its reference."""
        return self.moving and self._searching

    def reachable(self, units: float) -> bool:
        """Return whether a position lies in the travel; anything does before the axis is homed."""
        inside = self._config.low_um - 1e-3 <= self._config.position_at(units) <= self._config.high_um + 1e-3
        return inside or not self.homed

    def end(self, direction: float) -> float:
        """Return the end of the travel in a direction of the counter."""
        ends = self._config.units_at(self._config.low_um), self._config.units_at(self._config.high_um)
        return max(ends) if direction > 0 else min(ends)

    def move(self, units: float, speed: float) -> None:
        """Begin a motion to a position, at a speed in units/s."""
        to_um = self._zero_um + (units - self._zero_units) / self._config.units_per_um
        self.stalled = False
        self._stage.redirect(self._name, to_um, min(speed / abs(self._config.units_per_um), self._config.speed_um_s))

    def search(self) -> None:
        """Begin to search the reference."""
        self.homed = self.stalled = False
        self._stage.redirect(self._name, self._reference_um, self._config.speed_um_s * HOMING_SPEED_FRACTION)
        self._searching = True

    def stop(self) -> None:
        """Decelerate to a halt; a search that is interrupted has found nothing."""
        if self.moving:
            self._searching = self.endless = False
            self._stage.halt(self._name)

    def stall(self) -> None:
        """Run against something: the axis stops and its controller notices."""
        self.stop()
        self.stalled = True

    def _true_um(self) -> float:
        return self._stage.axis(self._name).profile.position_at(self._clock.now_s())


class SimulatedController(ABC):
    """Implementation of Device: the far end of a serial cable.

    Parameters
    ----------
    clock, stage : of the virtual rig.
    axes : the axes of the stage and the positioners that this controller moves.
    middle : true if the reference of an axis lies in the middle of its travel, else at its low end.
    """

    def __init__(
        self, clock: VirtualClock, stage: VirtualStage, axes: Mapping[str, AxisConfig], *, middle: bool = False
    ) -> None:
        self.axes: dict[str, SimulatedAxis] = {
            name: SimulatedAxis(clock, stage, name, axes[name], middle=middle) for name in axes
        }
        self._clock = clock
        self._inbox, self._processing = b"", False
        self._deliver: Callable[[bytes, float], None] = lambda data, time_s: None

    def connect(self, deliver: Callable[[bytes, float], None]) -> None:
        """Set what sends bytes that answer no command."""
        self._deliver = deliver

    def receive(self, data: bytes, time_s: float) -> bytes:
        """Process bytes; return the immediate answer.

        Starting a motion lets due events run, so that more bytes may arrive in the middle; they wait for their turn.
        """
        self._inbox += data
        if self._processing:
            return b""
        self._processing, answer = True, b""
        while self._inbox:
            data, self._inbox = self._inbox, b""
            answer += self.process(data)
        self._processing = False
        return answer

    @abstractmethod
    def process(self, data: bytes) -> bytes:
        """Process bytes; return the immediate answer."""
