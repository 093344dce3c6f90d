"""Checks of the devices of a rig: what answers, whether the pulse box counts what the stage moves, and index marks."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

from wafer_viewer.model.acquisition.devices import PulseBox, Stage
from wafer_viewer.model.acquisition.plan import Axis
from wafer_viewer.model.acquisition.positioners import Positioner, PositionerState, read_position
from wafer_viewer.model.acquisition.rig_limits import AxisLimits
from wafer_viewer.model.errors import RigError
from wafer_viewer.rigs.composed.rig import DeviceOpener
from wafer_viewer.rigs.pulse_box.client import PulseBoxClient
from wafer_viewer.rigs.stages.motion_controller import MotionController

ORDER: tuple[Axis, ...] = ("z", "x", "y")
"""Order of motions: the objective first."""
STEP_UM, STEP_FRACTION = 1_000.0, 0.05
"""Longest motion of a check in um, and as a fraction of the range."""
COUNTS_OFF, COUNTS_OFF_FRACTION = 2, 0.002
"""Difference between stage and pulse box after a motion that is allowed: counts, and fraction of the motion."""
MEND = "check its cables and its RIG.toml"


class DeviceCheck(NamedTuple):
    """Result of a check; `mend` says what to do, empty if nothing is wrong."""

    what: str
    found: str
    mend: str = ""


def check_devices(opener: DeviceOpener, *, move: bool) -> Iterator[DeviceCheck]:
    """Connect to each device of a composed rig and check it; a device that fails does not hide the others.

    move: home the stage, move each axis by a mm at most and over its index mark, and compare the counts.
    """
    devices = opener.devices
    controllers: dict[str, MotionController] = {}
    boxes: list[PulseBoxClient] = []

    def connect(name: str) -> str:
        controllers[name] = opener.controller(name)
        return controllers[name].identity()

    def connect_box() -> str:
        boxes.append(opener.box())
        return "answers"

    def connect_camera() -> str:
        opener.camera().close()
        return "answers"

    try:
        for name, config in devices.controllers.items():
            yield _answer(opener, f"Controller '{name}' at {config.port}", lambda name=name: connect(name))
        yield _answer(opener, f"Pulse box at {devices.pulse_box.port}", connect_box)
        yield _answer(opener, f"Camera '{devices.camera.driver}'", connect_camera)
        if len(controllers) == len(devices.controllers):
            axes, stage = devices.axes.by_name(), opener.stage(controllers)
            yield from check_stage(stage, boxes[0] if boxes else None, axes, move=move)
            if boxes:
                safe_z_um = min(objective.safe_z_um for objective in devices.objectives)
                yield from check_index_marks(stage, boxes[0], axes, safe_z_um, move=move)
            for name in devices.positioners:
                yield _answer(opener, f"Positioner '{name}'", lambda name=name: _found(opener, name, controllers))
    finally:
        for device in (*controllers.values(), *boxes):
            device.close()


def check_stage(
    stage: Stage, box: PulseBox | None, axes: Mapping[Axis, AxisLimits], *, move: bool
) -> Iterator[DeviceCheck]:
    """Check a stage and, if there is a pulse box, its counts against the positions; an interruption stops the stage."""
    with _stopped_by_interruption(stage):
        try:
            if move:
                _home(stage, axes)
            yield _position(stage)
            if box is None:
                return
            for axis in ORDER if move else ORDER if stage.homed() else ():
                yield (_motion if move else _count)(stage, box, axis, axes[axis])
        except RigError as fault:
            yield DeviceCheck("Stage", str(fault), MEND)


def check_index_marks(
    stage: Stage, box: PulseBox, axes: Mapping[Axis, AxisLimits], safe_z_um: float, *, move: bool
) -> Iterator[DeviceCheck]:
    """Check the axes whose limits name an index mark; an interruption stops the stage.

    move: pass each mark upward, with z at its lower end for the others, and return to the start.
    """
    marked: list[Axis] = [axis for axis in ORDER if axes[axis].index_um is not None]
    if not marked:
        return
    with _stopped_by_interruption(stage):
        try:
            identity = box.hello()
            if not identity.has_index:
                for axis in marked:
                    yield _without_inputs(axis, axes[axis], identity.name)
            elif not move:
                yield from (_at_rest(axis, axes[axis]) for axis in marked)
            else:
                yield from _passed(stage, box, axes, marked, safe_z_um, identity.count_rate_hz)
        except RigError as fault:
            yield DeviceCheck("Index marks", str(fault), MEND)


@contextmanager
def _stopped_by_interruption(stage: Stage) -> Generator[None]:
    """Context manager that stops the stage unless its body comes to its end."""
    with ExitStack() as on_interruption:
        on_interruption.callback(stage.stop)
        yield
        on_interruption.pop_all()


def _without_inputs(axis: Axis, limits: AxisLimits, name: str) -> DeviceCheck:
    return DeviceCheck(
        f"Index mark of {axis}",
        f"at {limits.index_um:.2f} um by the rig's file, but the pulse box ({name}) has no inputs for index marks",
        "update its firmware, or leave index_um out of the rig's file",
    )


def _at_rest(axis: Axis, limits: AxisLimits) -> DeviceCheck:
    found = f"at {limits.index_um:.2f} um by the rig's file; the pulse box has an input for it; --move passes it"
    return DeviceCheck(f"Index mark of {axis}", found)


def _passed(
    stage: Stage,
    box: PulseBox,
    axes: Mapping[Axis, AxisLimits],
    marked: list[Axis],
    safe_z_um: float,
    count_rate_hz: float,
) -> Iterator[DeviceCheck]:
    starts_um: dict[Axis, float] = {axis: _at_um(stage, axis) for axis in ("x", "y", "z")}
    _move(stage, "z", axes["z"].low_um)
    for axis in marked:
        yield _pass(stage, box, axis, axes[axis], safe_z_um, count_rate_hz)
        _move(stage, axis, axes["z"].low_um if axis == "z" else starts_um[axis])
    _move(stage, "z", starts_um["z"])


def _pass(
    stage: Stage, box: PulseBox, axis: Axis, limits: AxisLimits, safe_z_um: float, count_rate_hz: float
) -> DeviceCheck:
    """Pass the mark of an axis upward, and compare the count that it sets with the stage."""
    what, mark_um, way_um = f"Index mark of {axis}", limits.index_um, limits.over_index_um(_highest(axis, safe_z_um))
    if mark_um is None or way_um is None:
        return DeviceCheck(what, "none by the rig's file")
    _move(stage, axis, way_um[0])
    box.reference_by_index(axis, limits.counts(mark_um))
    stage.start(axis, way_um[1], limits.index_speed_um_s(count_rate_hz))
    stage.wait()
    if box.latched(axis) is None:
        return DeviceCheck(
            what,
            f"not met between {way_um[0]:.2f} and {way_um[1]:.2f} um",
            "check its cable, and index_um of the axis in the rig's file",
        )
    counted, expected = box.count(axis), limits.counts(_at_um(stage, axis))
    found_um = mark_um + limits.position_um(expected - counted)
    found = f"met at {found_um:.2f} um by the position of the stage, {mark_um:.2f} um by the rig's file"
    if abs(counted - expected) <= COUNTS_OFF:
        return DeviceCheck(what, found)
    return DeviceCheck(what, found, f"home the stage, or set index_um of the {axis} axis to {found_um:.2f}")


def _highest(axis: Axis, safe_z_um: float) -> float | None:
    return safe_z_um if axis == "z" else None


def _answer(opener: DeviceOpener, what: str, ask: Callable[[], object]) -> DeviceCheck:
    try:
        found = f"{ask()}"
    except RigError as fault:
        return DeviceCheck(what, str(fault), MEND)
    return DeviceCheck(what, f"SIMULATED, {found}" if opener.devices.simulated else found)


def positioner_words(name: str, positioner: Positioner) -> str:
    """Return title, position, range and named positions of a positioner."""
    return PositionerState(positioner.limits, read_position(name, positioner)).words


def _found(opener: DeviceOpener, name: str, controllers: Mapping[str, MotionController]) -> str:
    return positioner_words(name, opener.positioner(name, controllers))


def _position(stage: Stage) -> DeviceCheck:
    at, homed = stage.position(), stage.homed()
    words = (
        "homed" if homed else "not homed, so that positions mean nothing; --move, or the first move of a scan, homes it"
    )
    return DeviceCheck("Stage", f"at x {at.x_um:.2f}, y {at.y_um:.2f}, z {at.z_um:.2f} um, {words}")


def _home(stage: Stage, axes: Mapping[Axis, AxisLimits]) -> None:
    """Home a stage that is not homed: z goes to its lower end, then x and y to the middle of their ranges."""
    if not stage.homed():
        stage.move_to(z_um=axes["z"].low_um)
        x, y = axes["x"], axes["y"]
        stage.move_to(x_um=(x.low_um + x.high_um) / 2, y_um=(y.low_um + y.high_um) / 2)


def _count(stage: Stage, box: PulseBox, axis: Axis, limits: AxisLimits) -> DeviceCheck:
    counted, expected = box.count(axis), limits.counts(_at_um(stage, axis))
    words = "as the stage" if abs(counted - expected) <= COUNTS_OFF else "a scan sets it before its first pass"
    return DeviceCheck(f"Count of {axis}", f"{counted}, by the position of the stage {expected}: {words}")


def _motion(stage: Stage, box: PulseBox, axis: Axis, limits: AxisLimits) -> DeviceCheck:
    """Move an axis there and back, down if there is room, and compare what the box counted."""
    here_um, before = _at_um(stage, axis), box.count(axis)
    step_um = min(STEP_UM, STEP_FRACTION * (limits.high_um - limits.low_um))
    there_um = here_um - step_um if here_um - step_um >= limits.low_um else here_um + step_um
    _move(stage, axis, there_um)
    moved_um, counted = _at_um(stage, axis) - here_um, box.count(axis) - before
    _move(stage, axis, here_um)
    expected = moved_um * limits.counts_per_um
    found = f"the stage moved by {moved_um:+.2f} um, the box counted {counted:+d}, expected were {expected:+.0f}"
    off = abs(counted - expected)
    if off <= max(COUNTS_OFF, COUNTS_OFF_FRACTION * abs(expected)):
        return DeviceCheck(f"Count of {axis}", found)
    return DeviceCheck(f"Count of {axis}", found, _mend_of_counts(axis, counted / moved_um, limits.counts_per_um))


def _mend_of_counts(axis: Axis, found_per_um: float, counts_per_um: float) -> str:
    if found_per_um == 0:
        return f"connect the scale of the {axis} axis to its input of the pulse box"
    if abs(found_per_um + counts_per_um) <= 2 * COUNTS_OFF_FRACTION * counts_per_um:
        return f"swap the channels A and B of the scale of the {axis} axis, or the sign of its units_per_um"
    return (
        f"counts_per_um of the {axis} axis is {counts_per_um:g} in the rig's file and {found_per_um:.4f} by this "
        "motion: correct it or units_per_um, or check the scale and its cable"
    )


def _move(stage: Stage, axis: Axis, to_um: float) -> None:
    x_um, y_um, z_um = (to_um if axis == name else None for name in ("x", "y", "z"))
    stage.move_to(x_um=x_um, y_um=y_um, z_um=z_um)


def _at_um(stage: Stage, axis: Axis) -> float:
    at = stage.position()
    return {"x": at.x_um, "y": at.y_um, "z": at.z_um}[axis]
