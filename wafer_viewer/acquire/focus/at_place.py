"""Focus at a place without a page: the drive there, the exposure, and the search."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from wafer_viewer.acquire.auto_exposure import exposure_at
from wafer_viewer.acquire.focus.search import FOCUS_SEARCH, FocusFound, GoToFocus
from wafer_viewer.acquire.hand_drive import drive
from wafer_viewer.model.acquisition.devices import Position, Rig
from wafer_viewer.model.acquisition.plan import Axis
from wafer_viewer.model.acquisition.procedure import ProcedureControl, ProcedureStep
from wafer_viewer.model.errors import RigError

FEWEST_LOOKED_AT = 5
"""Fewest positions in z of a frame for the exposure; otherwise they are a depth of field apart."""


@dataclass(frozen=True, slots=True)
class FocusedPlace:
    """Focus found at a place of the stage, in um, and the exposure of its frames."""

    x_um: float
    y_um: float
    exposure_us: float
    focus: FocusFound


@dataclass(frozen=True, slots=True, kw_only=True)
class FocusAtPlace:
    """Procedure that drives to a place, finds the exposure if none is given, and goes to the focus.

    x_um, y_um, z_um: place and middle of the search; None for where the stage stands. z_range_um: range of z about it
    that the search looks at; None for a few depths of field, and farther if nothing is in focus there. exposure_us:
    None to find it. highest_um: highest z of the sample, which the objective stays clear of; None for the middle of the
    search.
    """

    x_um: float | None = None
    y_um: float | None = None
    z_um: float | None = None
    z_range_um: float | None = None
    exposure_us: float | None = None
    highest_um: float | None = None

    @property
    def title(self) -> str:
        """Title in the list of running work."""
        return "Go to focus"

    def run(self, rig: Rig, control: ProcedureControl) -> FocusedPlace:
        """Drive to the place, find its exposure and its focus, and end there.

        Raises RigError if nothing is in focus, or the place is out of range or too near to the sample; MotionStopped if
        stopped.
        """
        start = self._start(rig)
        highest_um = start.z_um if self.highest_um is None else self.highest_um
        goal_um: dict[Axis, float] = {"x": start.x_um, "y": start.y_um, "z": start.z_um}
        control.report(ProcedureStep(0.0, "Drive to the place"))
        drive(rig, goal_um, highest_um, control.should_stop)
        half_um = None if self.z_range_um is None else self.z_range_um / 2
        exposure_us = self.exposure_us or _exposure_us(rig, start, half_um, highest_um, control)
        within_um = None if half_um is None else (start.z_um - half_um, start.z_um + half_um)
        found = GoToFocus(exposure_us, highest_um, within_um).run(rig, control)
        return FocusedPlace(start.x_um, start.y_um, exposure_us, found)

    def _start(self, rig: Rig) -> Position:
        """Return the place and the middle of the search. Raises RigError for a lost stage and for an empty range."""
        if self.z_range_um is not None and self.z_range_um <= 0:
            raise RigError(f"z_range_um is {self.z_range_um:g}: it must be more than 0 um.")
        wanted = {"x_um": self.x_um, "y_um": self.y_um, "z_um": self.z_um}
        given = {name: um for name, um in wanted.items() if um is not None}
        if len(given) < len(wanted) and not rig.stage.homed():
            lacking = ", ".join(name for name in wanted if name not in given)
            raise RigError(
                f"The stage is not homed, so that the place where it stands means nothing: give {lacking} too; the "
                "drive there homes it."
            )
        return replace(rig.stage.position(), **given)


def _exposure_us(
    rig: Rig, start: Position, half_um: float | None, highest_um: float, control: ProcedureControl
) -> float:
    """Return the exposure at which the brightest pixels over the nearest range of z are below white."""
    dof_um = rig.limits.depth_of_field_um
    reach_um = FOCUS_SEARCH.half_range * dof_um if half_um is None else half_um
    low_um = max(rig.limits.lowest_z_um(highest_um), start.z_um - reach_um)
    high_um = min(rig.limits.z.high_um, start.z_um + reach_um)
    positions_um = np.linspace(low_um, high_um, max(FEWEST_LOOKED_AT, round((high_um - low_um) / dof_um)))

    def tell(exposure_us: float) -> None:
        control.report(ProcedureStep(0.0, f"Exposure of {exposure_us:.0f} us"))

    return exposure_at(rig, start.x_um, start.y_um, positions_um, control.should_stop, tell)
