"""References of the pulse box's counts: the position of the stage at rest, or the index mark of a scale."""

from __future__ import annotations

from wafer_viewer.acquire.motion import Deadline, at_um, await_arrival, device_errors, move
from wafer_viewer.model.acquisition.devices import Rig
from wafer_viewer.model.acquisition.plan import AXES, Axis
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.errors import RigError
from wafer_viewer.model.progress import ShouldStop

COUNT_TOLERANCE = 2
"""Permitted difference of pulse box and stage at rest in counts, if the position of the stage cannot tell fewer."""
MARK_ORDER: tuple[Axis, ...] = ("z", "x", "y")
"""Order of the motions over the index marks: the objective first, which then stays away for the others."""


def reference_axes(rig: Rig, should_stop: ShouldStop = lambda: False) -> None:
    """Set the counts of the pulse box from the position of the stage at rest, or by the index marks of its axes.

    An axis with an index mark moves over it upward, after z went to its lower end. Raises RigError if the box meets no
    mark, or then counts otherwise than the stage; MotionStopped if `should_stop` returns True on the way.
    """
    marked = marked_axes(rig.limits)
    if marked:
        with device_errors("stage"):
            move(rig, {"z": rig.limits.z.low_um}, should_stop)
    for axis in AXES:
        if axis not in marked:
            rig.box.reference(axis, stage_count(rig, axis))
    for axis in marked:
        _reference_by_index(rig, axis, should_stop)
        if axis == "z":
            with device_errors("stage"):
                move(rig, {"z": rig.limits.z.low_um}, should_stop)


def marked_axes(limits: RigLimits) -> list[Axis]:
    """Return the axes with an index mark, in the order of their motions."""
    return [axis for axis in MARK_ORDER if limits.axis(axis).index_um is not None]


def stage_count(rig: Rig, axis: Axis) -> int:
    """Return the scale count of an axis by the position of the stage."""
    with device_errors("stage"):
        return rig.limits.axis(axis).counts(at_um(rig.stage.position(), axis))


def _reference_by_index(rig: Rig, axis: Axis, should_stop: ShouldStop) -> None:
    limits = rig.limits.axis(axis)
    mark_um, way_um = limits.index_um, limits.over_index_um(rig.limits.objective.safe_z_um if axis == "z" else None)
    if mark_um is None or way_um is None:
        return
    before_um, behind_um = way_um
    with device_errors("stage"):
        move(rig, {axis: before_um}, should_stop)
    rig.box.reference_by_index(axis, limits.counts(mark_um))
    speed_um_s = limits.index_speed_um_s(rig.limits.count_rate_hz)
    with device_errors("stage"):
        deadline = Deadline(rig, {axis: behind_um}, speed_um_s)
        rig.stage.start(axis, behind_um, speed_um_s)
        await_arrival(rig, deadline, should_stop)
        rig.stage.wait()
    if rig.box.latched(axis) is None:
        raise RigError(
            f"The pulse box met no index mark of the {axis} axis between {before_um:.2f} and {behind_um:.2f} um: check "
            "the cable of the mark, and index_um of the axis in the rig's file."
        )
    _require_agreement(rig, axis)


def _require_agreement(rig: Rig, axis: Axis) -> None:
    counted, expected = rig.box.count(axis), stage_count(rig, axis)
    if abs(counted - expected) <= COUNT_TOLERANCE:
        return
    limits = rig.limits.axis(axis)
    raise RigError(
        f"After its index mark the pulse box counts the {axis} axis at {limits.position_um(counted):.2f} um "
        f"({counted} counts), and the stage says {limits.position_um(expected):.2f} um ({expected} counts): home the "
        "stage, or correct index_um of the axis in the rig's file."
    )
