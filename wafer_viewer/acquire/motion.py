"""Motions of the stage with a deadline: what does not arrive in time is stopped and named."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from contextlib import contextmanager

from wafer_viewer.model.acquisition.devices import Position, Rig
from wafer_viewer.model.acquisition.plan import Axis
from wafer_viewer.model.errors import MotionStopped, RigError, RigTimeout
from wafer_viewer.model.progress import ShouldStop

SPARE_FRACTION = 0.5
SPARE_S = 2.0
"""A motion may take half as long again as its way at its speed, and two seconds: drivers and controllers are slow."""
HOMING_SPEED_FRACTION = 0.1
"""An axis that looks for its reference first may cross its range at a tenth of its speed."""
ARRIVED_WITHIN_UM = 1.0
"""An axis this near to its goal has arrived."""
LOOK_S = 0.01


class Deadline:
    """The time by which a motion to `goal_um` should be over, from its way, speed, acceleration and settling."""

    def __init__(self, rig: Rig, goal_um: Mapping[Axis, float], speed_um_s: float | None = None) -> None:
        self._rig, self._goal_um = rig, goal_um
        here = rig.stage.position()
        ways_um: dict[Axis, float] = {axis: abs(um - at_um(here, axis)) for axis, um in goal_um.items()}
        times_s = {axis: rig.limits.axis(axis).move_s(way_um, speed_um_s) for axis, way_um in ways_um.items()}
        self._expected_s = max(times_s.values())
        self._longest: Axis = max(ways_um, key=lambda axis: (ways_um[axis] > 0, times_s[axis]))
        """The axis that should be the last to arrive."""
        if not rig.stage.homed():
            self._expected_s += max(_homing_s(rig, axis) for axis in goal_um)
        self._begun_s = rig.clock.now_s()

    @property
    def passed(self) -> bool:
        """Whether the motion should have been over."""
        return self._gone_s > self._expected_s * (1 + SPARE_FRACTION) + SPARE_S

    @property
    def arrived(self) -> bool:
        """Whether every axis stands at its goal by the stage's own position."""
        return self._farthest()[1] <= ARRIVED_WITHIN_UM

    def give_up(self) -> RigTimeout:
        """Stop pulses and stage; returns the error that names the axis, where it stands and where it should."""
        gone_s = self._gone_s
        self._rig.box.halt()
        self._rig.stage.stop()
        axis, away_um = self._farthest()
        if away_um <= ARRIVED_WITHIN_UM:
            axis = self._longest
        at, goal = at_um(self._rig.stage.position(), axis), self._goal_um[axis]
        late = f"{gone_s:.1f} s after it set out, where {self._expected_s:.1f} s were expected"
        where = (
            f"The {axis} axis did not arrive: {late}, it stands at {at:.2f} um instead of {goal:.2f} um."
            if away_um > ARRIVED_WITHIN_UM
            else f"The stage does not report the end of its motion: {late}, the {axis} axis stands at {at:.2f} um "
            f"and should be at {goal:.2f} um."
        )
        return RigTimeout(
            f"{where} It was stopped and the pulse box disarmed. Check the drive, the cable and the limit switches of "
            f"the {axis} axis, home the stage and continue."
        )

    @property
    def _gone_s(self) -> float:
        return self._rig.clock.now_s() - self._begun_s

    def _farthest(self) -> tuple[Axis, float]:
        """The axis that is farthest from its goal, and how far, in um."""
        here = self._rig.stage.position()
        away: dict[Axis, float] = {axis: abs(um - at_um(here, axis)) for axis, um in self._goal_um.items()}
        return max(away.items(), key=lambda item: item[1])


def move(rig: Rig, goal_um: Mapping[Axis, float], should_stop: ShouldStop) -> None:
    """Go to a place and settle there.

    Raises MotionStopped where `should_stop` says so, RigTimeout when it is not reached in time.
    """
    if not goal_um:
        return
    deadline = Deadline(rig, goal_um)
    try:
        rig.stage.move_to(
            x_um=goal_um.get("x"),
            y_um=goal_um.get("y"),
            z_um=goal_um.get("z"),
            should_stop=lambda: should_stop() or deadline.passed,
        )
    except MotionStopped:
        if deadline.passed and not should_stop():
            raise deadline.give_up() from None
        raise
    await_arrival(rig, deadline, should_stop)


def await_arrival(rig: Rig, deadline: Deadline, should_stop: ShouldStop) -> None:
    """Wait for a stage that reported the end of its motion before it stood at its goal."""
    while not deadline.arrived:
        if should_stop():
            come_to_rest(rig)
            here = rig.stage.position()
            raise MotionStopped.at(here.x_um, here.y_um, here.z_um)
        if deadline.passed:
            raise deadline.give_up()
        rig.clock.sleep(LOOK_S)


def come_to_rest(rig: Rig) -> None:
    """Stop every axis and wait until they stand and have settled. Raises RigTimeout when they do not in time."""
    stage, axes = rig.stage, (rig.limits.x, rig.limits.y, rig.limits.z)
    stage.stop()
    halt_s = max(axis.speed_um_s / axis.acceleration_um_s2 for axis in axes)
    begun_s = rig.clock.now_s()
    while stage.moving():
        if rig.clock.now_s() - begun_s > halt_s * (1 + SPARE_FRACTION) + SPARE_S:
            at = stage.position()
            raise RigTimeout(
                f"The stage still reports motion {rig.clock.now_s() - begun_s:.1f} s after it was told to stop; it "
                f"stands at x {at.x_um:.2f}, y {at.y_um:.2f}, z {at.z_um:.2f} um. Use the emergency stop if it truly "
                "moves; check its drives, and home it before the next scan."
            )
        rig.clock.sleep(LOOK_S)
    rig.clock.sleep(max(axis.settle_s for axis in axes))


def at_um(position: Position, axis: Axis) -> float:
    """The position of one axis."""
    return {"x": position.x_um, "y": position.y_um, "z": position.z_um}[axis]


@contextmanager
def device_errors(device: str) -> Generator[None]:
    """Tell an operating system's error in a device's driver as that device's, and not as one of the disk."""
    try:
        yield
    except OSError as fault:
        raise RigError(
            f"The {device} failed ({fault.strerror or fault}): check its cable and its power, and continue."
        ) from fault


def _homing_s(rig: Rig, axis: Axis) -> float:
    limits = rig.limits.axis(axis)
    return (limits.high_um - limits.low_um) / (limits.speed_um_s * HOMING_SPEED_FRACTION)
