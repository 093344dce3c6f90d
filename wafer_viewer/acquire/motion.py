"""Motions with a deadline: of the stage, by hand, and of positioners, with the objective clear of the sample."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

from wafer_viewer.model.acquisition.devices import Position, Rig
from wafer_viewer.model.acquisition.plan import Axis
from wafer_viewer.model.acquisition.positioners import Positioner, PositionerReading, PositionerState, read_position
from wafer_viewer.model.errors import MotionStopped, RigError, RigTimeout, WaferViewerError
from wafer_viewer.model.progress import ShouldStop

# --------------------------------------------------------------------------------------------------------------- motion


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


# ---------------------------------------------------------------------------------------------------------- positioning


def move_positioner(rig: Rig, name: str, to: float | str, should_stop: ShouldStop) -> PositionerReading:
    """Move a positioner and wait until it has settled.

    Parameters
    ----------
    rig : Rig
        Rig whose stage is at rest.
    name : str
        Name of the positioner.
    to : float or str
        A position in the unit of its role, or the name of one.
    should_stop : ShouldStop
        Polled during the motions.

    Returns
    -------
    PositionerReading
        Position that it reports after the motion.

    Raises
    ------
    RigError
        If there is no such positioner or position; nothing has moved then. If a device fails.
    MotionStopped
        If stopped.
    RigTimeout
        If it does not arrive in time.
    """
    positioner = positioner_of(rig, name)
    goal = positioner.limits.goal(name, to)
    with device_errors(f"positioner '{name}'"):
        if positioner.limits.descriptor.lifts_z and not _is_there(positioner, goal):
            lift_z(rig, positioner, should_stop)
        positioner.move_to(goal, should_stop)
        return read_position(name, positioner)


def positioner_of(rig: Rig, name: str) -> Positioner:
    """Return a positioner by its name. Raises RigError if the rig has none of that name."""
    if name not in rig.positioners:
        names = ", ".join(rig.positioners) or "none"
        raise RigError(f"The rig has no positioner '{name}': it has {names}. They are named in the rig's file.")
    return rig.positioners[name]


def lift_z(rig: Rig, positioner: Positioner, should_stop: ShouldStop) -> None:
    """Move z up to where the objective, and any other on the nosepiece, clears the sample; never down."""
    with device_errors("stage"):
        safe_um = rig.limits.objective.safe_z_um
        if (own_um := positioner.limits.lift_z_um) is not None:
            safe_um = max(safe_um, own_um)
        safe_um = min(safe_um, rig.limits.z.high_um)
        if not rig.stage.homed() or rig.stage.position().z_um < safe_um:
            move(rig, {"z": safe_um}, should_stop)


def _is_there(positioner: Positioner, goal: float) -> bool:
    named = positioner.limits.name_at(goal)
    if not positioner.homed():
        return False
    here = positioner.position()
    return here == goal or (named != "" and positioner.limits.name_at(here) == named)


def read_positioners(rig: Rig) -> tuple[PositionerState, ...]:
    """Return all positioners with their positions. Raises RigError if one does not answer."""
    states: list[PositionerState] = []
    for name, positioner in rig.positioners.items():
        with device_errors(f"positioner '{name}'"):
            states.append(PositionerState(positioner.limits, read_position(name, positioner)))
    return tuple(states)


# ----------------------------------------------------------------------------------------------------------- hand drive


@dataclass(frozen=True, slots=True)
class JogVelocity:
    """Velocity of each axis in um/s, signed; zero on all axes means rest."""

    x_um_s: float = 0.0
    y_um_s: float = 0.0
    z_um_s: float = 0.0

    @property
    def at_rest(self) -> bool:
        """True if no axis is to move."""
        return self == REST

    def axes(self) -> dict[Axis, float]:
        """Return the velocities of the moving axes, um/s."""
        by_axis: dict[Axis, float] = {"x": self.x_um_s, "y": self.y_um_s, "z": self.z_um_s}
        return {axis: um_s for axis, um_s in by_axis.items() if um_s}


REST = JogVelocity()


def jog(rig: Rig, wanted: Callable[[], JogVelocity], highest_um: float | None, meanwhile: Callable[[], None]) -> None:
    """Move at the wanted velocity until it is zero; the stage is at rest afterwards, whatever happens.

    Parameters
    ----------
    rig : Rig
        Rig whose stage is at rest.
    wanted : callable
        Returns the wanted velocity; polled between the calls of `meanwhile`.
    highest_um : float or None
        Highest known z of the sample; z ends where the objective has its clearance above it.
    meanwhile : callable
        Called during the motion; returns within the time in which a stop must act.

    Raises
    ------
    RigError
        If a device fails or an axis is not homed.
    """
    try:
        while not (velocity := wanted()).at_rest:
            with device_errors("stage"):
                _start(rig, velocity, highest_um)
            while wanted() == velocity:
                meanwhile()
            with device_errors("stage"):
                come_to_rest(rig)
    except BaseException:
        with device_errors("stage"):
            come_to_rest(rig)
        raise


def _start(rig: Rig, velocity: JogVelocity, highest_um: float | None) -> None:
    """Start every axis towards the end of its range, within its speed."""
    here = rig.stage.position()
    for axis, um_s in velocity.axes().items():
        limits = rig.limits.axis(axis)
        low_um = rig.limits.lowest_z_um(highest_um) if axis == "z" else limits.low_um
        end_um = limits.high_um if um_s > 0 else low_um
        if (end_um - at_um(here, axis)) * um_s > ARRIVED_WITHIN_UM * abs(um_s):
            rig.stage.start(axis, end_um, min(abs(um_s), limits.speed_um_s))


def drive(rig: Rig, goal_um: Mapping[Axis, float], highest_um: float | None, should_stop: ShouldStop) -> None:
    """Move to a position; farther than a field away over the safe z, then down to z.

    Parameters
    ----------
    rig : Rig
        Rig whose stage is at rest.
    goal_um : mapping of axis to um
        Position of the named axes; the others end where they are.
    highest_um : float or None
        Highest known z of the sample, which the objective stays clear of.
    should_stop : ShouldStop
        Polled during the moves.

    Raises
    ------
    RigError
        If a position is out of range or too near to the sample; nothing has moved then. MotionStopped if stopped.
    """
    with device_errors("stage"):
        here = rig.stage.position()
        require_clear(rig, goal_um.get("z"), highest_um)
        across: dict[Axis, float] = {axis: um for axis, um in goal_um.items() if axis != "z"}
        way_um = math.hypot(*(um - at_um(here, axis) for axis, um in across.items()))
        safe_um = min(rig.limits.objective.safe_z_um, rig.limits.z.high_um)
        if way_um <= max(rig.limits.field_width_um, rig.limits.field_height_um):
            move(rig, goal_um, should_stop)
            return
        for axis, um in across.items():
            rig.limits.axis(axis).require_reachable(axis, um)
        down_um = goal_um.get("z", max(here.z_um, rig.limits.lowest_z_um(highest_um)))
        move(rig, {"z": max(here.z_um, safe_um)}, should_stop)
        move(rig, across, should_stop)
        move(rig, {"z": down_um}, should_stop)


def require_clear(rig: Rig, z_um: float | None, highest_um: float | None) -> None:
    """Raise RigError if the objective would come nearer to the highest known point than its clearance."""
    if z_um is None:
        return
    rig.limits.z.require_reachable("z", z_um)
    if highest_um is not None and z_um < (lowest_um := rig.limits.lowest_z_um(highest_um)):
        raise RigError(
            f"z cannot go to {z_um:.1f} um: it stops at {lowest_um:.1f} um, where the objective is "
            f"{rig.limits.objective.clearance_um:g} um over the highest known point of the sample, {highest_um:.1f} um."
        )
