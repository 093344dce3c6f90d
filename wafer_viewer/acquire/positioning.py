"""Motions of positioners: z goes to the safe z before anything turns over the sample, or turns the sample."""

from __future__ import annotations

from wafer_viewer.acquire.motion import device_errors, move
from wafer_viewer.model.acquisition.devices import Rig
from wafer_viewer.model.acquisition.positioners import Positioner, PositionerReading, PositionerState, read_position
from wafer_viewer.model.errors import RigError
from wafer_viewer.model.progress import ShouldStop


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
