"""Positioners on motion controllers: one axis each, in the unit of its role."""

from __future__ import annotations

from collections.abc import Callable

from wafer_viewer.model.acquisition.devices import Clock
from wafer_viewer.model.acquisition.positioners import PositionerLimits
from wafer_viewer.model.errors import MotionStopped, RigError
from wafer_viewer.model.progress import ShouldStop
from wafer_viewer.rigs.stages.axis_group import AxisGroup
from wafer_viewer.rigs.stages.motion_controller import AxisConfig, MotionController

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
