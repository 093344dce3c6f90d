"""Motions by hand: jog at a velocity that must be renewed, and drives that keep the objective clear of the sample."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from wafer_viewer.acquire.motion import ARRIVED_WITHIN_UM, at_um, come_to_rest, device_errors, move
from wafer_viewer.model.acquisition.devices import Rig
from wafer_viewer.model.acquisition.plan import Axis
from wafer_viewer.model.errors import RigError
from wafer_viewer.model.progress import ShouldStop


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
