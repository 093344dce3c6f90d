"""Virtual positioners: lamp and tilts of the virtual rig, and the effect of all on the pictures of its camera.

A rig with simulated controllers moves the same axes through its drivers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from wafer_viewer.model.acquisition.positioners import PositionerLimits, Role
from wafer_viewer.model.acquisition.rig_limits import AxisLimits
from wafer_viewer.model.errors import MotionStopped, RigError, RigTimeout
from wafer_viewer.model.progress import ShouldStop
from wafer_viewer.rigs.virtual.clock import VirtualClock
from wafer_viewer.rigs.virtual.stage import VirtualStage

POLL_S = 0.005
SPARE_FRACTION, SPARE_S = 0.5, 2.0
"""Margin of the deadline of a motion: fraction of its expected time, and s."""
Slopes = tuple[float, float]
"""Rise of the sample along x and along y."""


@dataclass(frozen=True, slots=True)
class SimulatedPositioner:
    """Positioner of a simulated rig: its limits, and its position when the rig is switched on."""

    limits: PositionerLimits
    at: float

    @classmethod
    def resting(cls, limits: PositionerLimits) -> SimulatedPositioner:
        """Return a positioner at its first named position, else where its role rests."""
        within_range = min(max(limits.descriptor.rest, limits.low), limits.high)
        return cls(limits, next(iter(limits.named.values()), within_range))


LAMP = PositionerLimits(role="light", low=0.0, high=100.0)
TILT_A = PositionerLimits(role="tilt_a", low=-2.0, high=2.0)
TILT_B = PositionerLimits(role="tilt_b", low=-2.0, high=2.0)
OWN = {name: SimulatedPositioner.resting(its) for name, its in (("lamp", LAMP), ("tilt_a", TILT_A), ("tilt_b", TILT_B))}
"""Positioners of the virtual rig by name."""
RANGE_S, RAMP_S = 0.5, 0.05
"""Time in which a simulated positioner crosses its range, and in which it comes to this speed."""


class VirtualPositioners:
    """Axes of the positioners of a simulated rig, which its stage moves, and their effect on the pictures."""

    def __init__(self, clock: VirtualClock, stage: VirtualStage, devices: Mapping[str, SimulatedPositioner]) -> None:
        self._clock, self._stage = clock, stage
        self._roles: dict[str, Role] = {name: device.limits.role for name, device in devices.items()}
        for name, device in devices.items():
            stage.add(name, _axis_limits(device.limits), device.at)
        self.by_name = {name: VirtualPositioner(name, its.limits, stage, clock) for name, its in devices.items()}

    def light_at(self, time_s: float) -> float:
        """Return the light as a fraction of all lamps at 100 %; 1 without a lamp."""
        lamps = (name for name, role in self._roles.items() if role == "light")
        return math.prod(self._stage.axis(name).profile.position_at(time_s) / 100.0 for name in lamps)

    def slopes(self) -> Slopes:
        """Return the slopes of the sample: A turns it about x, B about y, both right-handed through (0, 0)."""
        now_s = self._clock.now_s()
        rises = {"tilt_a": 0.0, "tilt_b": 0.0}
        for name, role in self._roles.items():
            if role in rises:
                rises[role] = math.tan(math.radians(self._stage.axis(name).profile.position_at(now_s)))
        return 0.0 - rises["tilt_b"], rises["tilt_a"]


class VirtualPositioner:
    """Implementation of Positioner without a controller."""

    def __init__(self, name: str, limits: PositionerLimits, stage: VirtualStage, clock: VirtualClock) -> None:
        self._name, self._limits, self._stage, self._clock = name, limits, stage, clock

    @property
    def limits(self) -> PositionerLimits:
        """Role, range and named positions."""
        return self._limits

    def position(self) -> float:
        """Return the current position."""
        return self._stage.axis(self._name).profile.position_at(self._clock.now_s())

    def move_to(self, position: float, should_stop: ShouldStop | None = None) -> None:
        """Move and wait until it has settled. Raises MotionStopped, at rest, when `should_stop` returns True."""
        goal, axis = self._limits.goal(self._name, position), self._stage.axis(self._name)
        if axis.moving(self._clock.now_s()):
            raise RigError(f"The positioner '{self._name}' is still moving: wait for it or stop it first.")
        if should_stop is not None and should_stop():
            raise self._stopped()
        if goal == self.position():
            return
        expected_s = axis.limits.move_s(goal - self.position())
        until_s = self._clock.now_s() + expected_s * (1 + SPARE_FRACTION) + SPARE_S
        self._stage.redirect(self._name, goal, axis.limits.speed_um_s)
        while self._stage.moving():
            if should_stop is not None and should_stop() and self._stage.moving():
                self.stop()
                self._stage.wait()
                raise self._stopped()
            if self._clock.now_s() > until_s:
                self.stop()
                raise RigTimeout(
                    f"The positioner '{self._name}' still reports motion long after it should stand: it was stopped; "
                    "check its drive."
                )
            self._clock.sleep(POLL_S)
        self._clock.sleep(axis.limits.settle_s)

    def homed(self) -> bool:
        """Return True, as its scale is absolute."""
        return True

    def stop(self) -> None:
        """Decelerate to a halt, with all axes of the stage."""
        self._stage.stop()

    def _stopped(self) -> MotionStopped:
        return MotionStopped(f"The positioner '{self._name}' was stopped at {self._limits.words(self.position())}.")


def _axis_limits(limits: PositionerLimits) -> AxisLimits:
    """Return the limits of the axis, with the unit of the role in place of um."""
    speed = (limits.high - limits.low) / RANGE_S
    return AxisLimits(
        low_um=limits.low,
        high_um=limits.high,
        speed_um_s=speed,
        acceleration_um_s2=speed / RAMP_S,
        settle_s=0.05,
        counts_per_um=1.0,
    )
