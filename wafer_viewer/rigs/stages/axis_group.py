"""Axes of motion controllers that move together: references, deadlines, arrival and stops."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from typing import Generic, TypeVar

from wafer_viewer.model.acquisition.devices import Clock
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
