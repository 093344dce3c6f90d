"""The stage of a rig: axes of one or more motion controllers, in um."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from typing import Generic, TypeVar

from wafer_viewer.model.acquisition.devices import Clock, Position
from wafer_viewer.model.acquisition.plan import Axis
from wafer_viewer.model.acquisition.positioners import PositionerLimits
from wafer_viewer.model.errors import MotionStopped, RigError, RigTimeout
from wafer_viewer.model.progress import ShouldStop
from wafer_viewer.rigs.stages.motion_controller import AxisConfig, MotionController

POLL_S = 0.005
"""Time between two looks at moving axes and at a request to stop, s."""
SPARE_FRACTION, SPARE_S = 0.5, 2.0
"""Margin of the deadline of a motion: fraction of its expected time, and s."""
SEARCH_SPEED_FRACTION = 0.1
"""Least speed that is expected of a search for the reference, as a fraction of the full speed."""

Name = TypeVar("Name", bound=str)


class AxisGroup(ABC, Generic[Name]):
    """Axes on one or more motion controllers.

    Parameters
    ----------
    controllers : by the names that the axes refer to.
    axes : settings of the axes by name.
    clock : clock of the rig.
    arrived_within : distance from its goal at which a stopped axis had arrived already.
    """

    def __init__(
        self,
        controllers: Mapping[str, MotionController],
        axes: Mapping[Name, AxisConfig],
        clock: Clock,
        arrived_within: float,
    ) -> None:
        self._controllers, self._axes, self._clock = controllers, axes, clock
        self._arrived_within = arrived_within
        self._until_s = clock.now_s()
        """Deadline of the motions that have begun."""

    def stop(self) -> None:
        """Decelerate every axis of the controllers to a halt. This is not an emergency stop.

        A controller that fails does not keep the others from being stopped; its error is raised after that.
        """
        faults: list[RigError] = []
        for controller in self._controllers.values():
            try:
                controller.stop()
            except RigError as fault:
                faults.append(fault)
        if faults:
            raise faults[0]

    @abstractmethod
    def _stopped(self) -> MotionStopped:
        """Return the error of a motion that was stopped."""

    def _go(self, goals: Mapping[Name, float], should_stop: ShouldStop | None) -> None:
        """Move homed axes at full speed and wait until they have settled; a stop after their arrival is none."""
        self._begin(goals, {axis: self._axes[axis].speed_um_s for axis in goals})
        try:
            self._come_to_rest(should_stop)
        except MotionStopped:
            at = self._positions()
            if any(abs(at[axis] - to) > self._arrived_within for axis, to in goals.items()):
                raise

    def _home(self, axes: list[Name], should_stop: ShouldStop | None) -> None:
        """Search the references of some axes at the same time. Raises RigError when one is not found."""
        expected_s = max(
            (self._axes[axis].high_um - self._axes[axis].low_um) / (self._axes[axis].speed_um_s * SEARCH_SPEED_FRACTION)
            for axis in axes
        )
        for name, of_it in self._by_controller(axes).items():
            self._controllers[name].home(of_it)
        self._expect(expected_s)
        self._come_to_rest(should_stop)
        if lost := sorted(set(axes) - self._homed()):
            raise RigError(
                f"The {' and '.join(lost)} axis did not find its reference: check its switches and its way, and home "
                "it again."
            )

    def _begin(self, goals: Mapping[Name, float], speeds: Mapping[Name, float]) -> None:
        here = self._positions()
        expected_s = [self._axes[axis].move_s(to - here[axis], speeds[axis]) for axis, to in goals.items()]
        for name, of_it in self._by_controller(goals).items():
            self._controllers[name].move(
                {axis: self._axes[axis].units_at(goals[axis]) for axis in of_it},
                {axis: self._axes[axis].rate(speeds[axis]) for axis in of_it},
            )
        self._expect(max(expected_s, default=0.0))

    def _expect(self, duration_s: float) -> None:
        """Set the deadline of what has just begun, unless an earlier motion has a later one."""
        self._until_s = max(self._until_s, self._clock.now_s() + duration_s * (1 + SPARE_FRACTION) + SPARE_S)

    def _come_to_rest(self, should_stop: ShouldStop | None) -> None:
        """Wait until all axes are at rest and settled; stop all when one fails, is late or `should_stop` says so."""
        try:
            while moving := self._moving():
                if should_stop is not None and should_stop():
                    self.stop()
                    self._expect(max(axis.speed_um_s / axis.acceleration_um_s2 for axis in self._axes.values()))
                    self._come_to_rest(None)
                    raise self._stopped()
                if self._clock.now_s() > self._until_s:
                    raise RigTimeout(
                        f"The {' and '.join(sorted(moving))} axis still reports motion long after it should stand: it "
                        "was stopped; check its drive and its way, and home it."
                    )
                self._clock.sleep(POLL_S)
        except MotionStopped:
            raise
        except RigError:
            self._stop_after_fault()
            raise
        self._clock.sleep(max(axis.settle_s for axis in self._axes.values()))
        self._until_s = self._clock.now_s()

    def _stop_after_fault(self) -> None:
        try:
            self.stop()
        except RigError:
            return

    def _positions(self) -> dict[Name, float]:
        units = {name: at for controller in self._controllers.values() for name, at in controller.positions().items()}
        return {axis: config.position_at(units[axis]) for axis, config in self._axes.items()}

    def _moving(self) -> set[str]:
        return {axis for controller in self._controllers.values() for axis in controller.moving()}

    def _homed(self) -> set[str]:
        return {axis for controller in self._controllers.values() for axis in controller.homed()}

    def _by_controller(self, axes: Iterable[Name]) -> dict[str, list[Name]]:
        """Return axes by the names of their controllers."""
        groups: dict[str, list[Name]] = {}
        for axis in axes:
            groups.setdefault(self._axes[axis].controller, []).append(axis)
        return groups


ARRIVED_WITHIN_UM = 0.1
"""Distance from its goal at which a stopped axis had arrived already."""


class ControllerStage(AxisGroup[Axis]):
    """Implementation of Stage on motion controllers.

    Parameters
    ----------
    controllers : by the names that the axes refer to. Those of positioners are stopped with the stage.
    axes : settings of x, y and z.
    clock : clock of the rig.
    """

    def __init__(
        self, controllers: Mapping[str, MotionController], axes: Mapping[Axis, AxisConfig], clock: Clock
    ) -> None:
        super().__init__(controllers, axes, clock, ARRIVED_WITHIN_UM)

    def identities(self) -> dict[str, str]:
        """Return what each controller says that it is, by its name."""
        return {name: controller.identity() for name, controller in self._controllers.items()}

    def position(self) -> Position:
        """Return the current position."""
        at_um = self._positions()
        return Position(at_um["x"], at_um["y"], at_um["z"])

    def move_to(
        self,
        *,
        x_um: float | None = None,
        y_um: float | None = None,
        z_um: float | None = None,
        should_stop: ShouldStop | None = None,
    ) -> None:
        """Move at full speed and wait until settled; None leaves an axis at its position.

        Axes that are not homed search their reference before, z first and alone, away from the objective. Raises
        MotionStopped, with the stage at rest, when `should_stop` returns True before or during the motion.
        """
        wanted: dict[Axis, float | None] = {"x": x_um, "y": y_um, "z": z_um}
        goals_um: dict[Axis, float] = {axis: um for axis, um in wanted.items() if um is not None}
        self._require_possible(goals_um)
        if should_stop is not None and should_stop():
            raise self._stopped()
        self._find_references(goals_um, should_stop)
        self._go(goals_um, should_stop)

    def start(self, axis: Axis, to_um: float, speed_um_s: float) -> None:
        """Begin a motion of one axis at a given speed, and return at once."""
        self._require_possible({axis: to_um})
        self._axes[axis].require_speed(axis, speed_um_s)
        if axis not in self._homed():
            raise RigError(f"The {axis} axis is not homed: home the stage by a move before a motion at a given speed.")
        self._begin({axis: to_um}, {axis: speed_um_s})

    def homed(self) -> bool:
        """Return whether every axis is homed."""
        return self._homed() >= set(self._axes)

    def moving(self) -> bool:
        """Return whether any axis is moving. Raises RigError when a controller reports a fault."""
        return bool(self._moving())

    def wait(self) -> None:
        """Wait until every axis is at rest and settled. Raises RigTimeout when it does not report so in time."""
        self._come_to_rest(None)

    def close(self) -> None:
        """Close the ports."""
        for controller in self._controllers.values():
            controller.close()

    def _require_possible(self, goals_um: Mapping[Axis, float]) -> None:
        """Raise RigError when a goal is out of range or its axis is moving; nothing has moved then."""
        for axis, to_um in goals_um.items():
            self._axes[axis].require_reachable(axis, to_um)
        for axis in self._moving() & set(goals_um):
            raise RigError(f"The {axis} axis is still moving: wait for it or stop it first.")

    def _find_references(self, goals_um: Mapping[Axis, float], should_stop: ShouldStop | None) -> None:
        """Home the axes of a move that need it; z goes first, as its objective may stand low."""
        lost = set(self._axes) - self._homed() if goals_um else set[str]()
        if "z" in lost:
            self._home(["z"], should_stop)
            lost = set(self._axes) - self._homed()
        needed: list[Axis] = [axis for axis in goals_um if axis in lost]
        if needed:
            self._home(needed, should_stop)

    def _stopped(self) -> MotionStopped:
        here = self.position()
        return MotionStopped.at(here.x_um, here.y_um, here.z_um)


ARRIVED_FRACTION = 1e-4
"""Distance from its goal at which a stopped positioner had arrived already, as a fraction of its range."""


class ControllerPositioner(AxisGroup[str]):
    """Implementation of Positioner on a motion controller.

    Parameters
    ----------
    name : name in the rig's file, by which the controller knows the axis.
    limits : role, range and named positions.
    controller : the controller; a stop stops all of its axes.
    axis : settings of the axis, with the unit of the role in place of um.
    clock : clock of the rig.
    """

    def __init__(
        self, name: str, limits: PositionerLimits, controller: MotionController, axis: AxisConfig, clock: Clock
    ) -> None:
        arrived_within = ARRIVED_FRACTION * (limits.high - limits.low)
        super().__init__({axis.controller: controller}, {name: axis}, clock, arrived_within)
        self._name, self._limits = name, limits
        self.known: float | None = None
        """Position when it was last asked for or moved; None while that means nothing."""
        self._listener: Callable[[], None] = lambda: None
        self._note()

    def on_arrival(self, listener: Callable[[], None]) -> None:
        """Call `listener` after every motion, also one that did not reach its goal."""
        self._listener = listener

    @property
    def limits(self) -> PositionerLimits:
        """Role, range and named positions."""
        return self._limits

    def position(self) -> float:
        """Return the current position in the unit of the role; it means nothing before the axis is homed."""
        self._note()
        return self._positions()[self._name]

    def move_to(self, position: float, should_stop: ShouldStop | None = None) -> None:
        """Move and wait until it has settled; an axis that is not homed searches its reference before.

        Raises MotionStopped, with the axis at rest, when `should_stop` returns True before or during the motion.
        """
        goal = self._limits.goal(self._name, position)
        if self._name in self._moving():
            raise RigError(f"The positioner '{self._name}' is still moving: wait for it or stop it first.")
        if should_stop is not None and should_stop():
            raise self._stopped()
        self.known = None
        try:
            if not self.homed():
                self._home([self._name], should_stop)
            self._go({self._name: goal}, should_stop)
        finally:
            self._note_if_it_answers()
            self._listener()

    def homed(self) -> bool:
        """Return whether the axis knows where it is."""
        return self._name in self._homed()

    def _note(self) -> None:
        self.known = self._positions()[self._name] if self.homed() else None

    def _note_if_it_answers(self) -> None:
        try:
            self._note()
        except RigError:
            self.known = None

    def _stopped(self) -> MotionStopped:
        where = self._limits.words(self._positions()[self._name]) if self.homed() else "an unknown position"
        return MotionStopped(f"The positioner '{self._name}' was stopped at {where}.")
