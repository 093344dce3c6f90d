"""The stage of a rig: axes of one or more motion controllers, in um."""

from __future__ import annotations

from collections.abc import Mapping

from wafer_viewer.model.acquisition.devices import Clock, Position
from wafer_viewer.model.acquisition.plan import Axis
from wafer_viewer.model.errors import MotionStopped, RigError
from wafer_viewer.model.progress import ShouldStop
from wafer_viewer.rigs.stages.axis_group import AxisGroup
from wafer_viewer.rigs.stages.motion_controller import AxisConfig, MotionController

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
