"""Motions of the stage with a deadline; an axis that does not arrive in time is stopped and reported."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from contextlib import contextmanager

from wafer_viewer.model.acquisition.devices import Position, Rig
from wafer_viewer.model.acquisition.plan import Axis
from wafer_viewer.model.errors import MotionStopped, RigError, RigTimeout, WaferViewerError
from wafer_viewer.model.progress import ShouldStop

SPARE_FRACTION = 0.5
"""Margin of the deadline of a motion for slow drivers, as a fraction of its expected duration."""
SPARE_S = 2.0
"""Further margin of a deadline for slow controllers, s."""
HOMING_SPEED_FRACTION = 0.1
"""Assumed speed of an axis during homing, as a fraction of its full speed."""
ARRIVED_WITHIN_UM = 1.0
"""Distance from the goal at which an axis has arrived."""
LOOK_S = 0.01
"""Time between two looks at the position of the stage, s."""


class Deadline:
    """Deadline of a motion to `goal_um`, from its distance, speed, acceleration and settling time."""

    def __init__(self, rig: Rig, goal_um: Mapping[Axis, float], speed_um_s: float | None = None) -> None:
        self._rig, self._goal_um = rig, goal_um
        here = rig.stage.position()
        travels_um: dict[Axis, float] = {axis: abs(um - at_um(here, axis)) for axis, um in goal_um.items()}
        times_s = {axis: rig.limits.axis(axis).move_s(travel_um, speed_um_s) for axis, travel_um in travels_um.items()}
        self._expected_s = max(times_s.values())
        self._longest: Axis = max(travels_um, key=lambda axis: (travels_um[axis] > 0, times_s[axis]))
        """Axis expected to arrive last."""
        if not rig.stage.homed():
            self._expected_s += max(_homing_s(rig, axis) for axis in goal_um)
        self._begun_s = rig.clock.now_s()

    @property
    def passed(self) -> bool:
        """True if the deadline has passed."""
        return self._gone_s > self._expected_s * (1 + SPARE_FRACTION) + SPARE_S

    @property
    def arrived(self) -> bool:
        """True if every axis is at its goal according to the stage's position."""
        return self._farthest()[1] <= ARRIVED_WITHIN_UM

    def give_up(self) -> RigTimeout:
        """Stop pulses and stage; return the error that names the axis, its position and its goal."""
        gone_s = self._gone_s
        self._rig.box.halt()
        self._rig.stage.stop()
        axis, away_um = self._farthest()
        if away_um <= ARRIVED_WITHIN_UM:
            axis = self._longest
        position_um, goal = at_um(self._rig.stage.position(), axis), self._goal_um[axis]
        late = f"{gone_s:.1f} s after it set out, where {self._expected_s:.1f} s were expected"
        where = (
            f"The {axis} axis did not arrive: {late}, it stands at {position_um:.2f} um instead of {goal:.2f} um."
            if away_um > ARRIVED_WITHIN_UM
            else f"The stage does not report the end of its motion: {late}, the {axis} axis stands at "
            f"{position_um:.2f} um and should be at {goal:.2f} um."
        )
        return RigTimeout(
            f"{where} It was stopped and the pulse box disarmed. Check the drive, the cable and the limit switches of "
            f"the {axis} axis, home the stage and continue."
        )

    @property
    def _gone_s(self) -> float:
        return self._rig.clock.now_s() - self._begun_s

    def _farthest(self) -> tuple[Axis, float]:
        """Return the axis farthest from its goal and its distance in um."""
        here = self._rig.stage.position()
        away: dict[Axis, float] = {axis: abs(um - at_um(here, axis)) for axis, um in self._goal_um.items()}
        return max(away.items(), key=lambda item: item[1])


def move(rig: Rig, goal_um: Mapping[Axis, float], should_stop: ShouldStop) -> None:
    """Move to a position and settle there.

    Raises MotionStopped if `should_stop` returns True, RigTimeout if the goal is not reached in time.
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
    """Wait for a stage that reported the end of its motion before it reached its goal."""
    while not deadline.arrived:
        if should_stop():
            come_to_rest(rig)
            here = rig.stage.position()
            raise MotionStopped.at(here.x_um, here.y_um, here.z_um)
        if deadline.passed:
            raise deadline.give_up()
        rig.clock.sleep(LOOK_S)


def come_to_rest(rig: Rig) -> None:
    """Stop every axis and wait until all are at rest and settled. Raises RigTimeout if that takes too long."""
    stage, axes = rig.stage, (rig.limits.x, rig.limits.y, rig.limits.z)
    stage.stop()
    halt_s = max(axis.speed_um_s / axis.acceleration_um_s2 for axis in axes)
    begun_s = rig.clock.now_s()
    while stage.moving():
        if rig.clock.now_s() - begun_s > halt_s * (1 + SPARE_FRACTION) + SPARE_S:
            now = stage.position()
            raise RigTimeout(
                f"The stage still reports motion {rig.clock.now_s() - begun_s:.1f} s after the stop command; it "
                f"stands at x {now.x_um:.2f}, y {now.y_um:.2f}, z {now.z_um:.2f} um. Use the emergency stop if it "
                "truly moves; check its drives, and home it before the next scan."
            )
        rig.clock.sleep(LOOK_S)
    rig.clock.sleep(max(axis.settle_s for axis in axes))


def at_um(position: Position, axis: Axis) -> float:
    """Return the position of one axis."""
    return {"x": position.x_um, "y": position.y_um, "z": position.z_um}[axis]


@contextmanager
def device_errors(device: str, kind: type[Exception] = Exception) -> Generator[None]:
    """Raise what a device's driver raises as a RigError of that device, an OSError not as a disk error.

    kind: of the errors, narrower where more than calls of the driver is guarded.
    """
    try:
        yield
    except WaferViewerError:
        raise
    except kind as fault:
        why = (fault.strerror if isinstance(fault, OSError) else None) or str(fault) or type(fault).__name__
        raise RigError(
            f"The {device} failed ({why.rstrip('.')}): check its cable and its power, and continue."
        ) from fault


def _homing_s(rig: Rig, axis: Axis) -> float:
    limits = rig.limits.axis(axis)
    return (limits.high_um - limits.low_um) / (limits.speed_um_s * HOMING_SPEED_FRACTION)
