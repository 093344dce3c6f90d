"""Checks of the stage alone: homing, soft limits, arrival, repeatability, stop and deadline."""

from __future__ import annotations

import math

from wafer_viewer.acquire.conformance.bench import (
    CheckOutcome,
    ConformanceBench,
    ConformanceCheck,
    DeviceRole,
    TravelWindow,
    figure,
    outcome,
)
from wafer_viewer.acquire.motion import ARRIVED_WITHIN_UM, SPARE_FRACTION, SPARE_S, at_um, device_errors
from wafer_viewer.model.acquisition.plan import AXES, Axis
from wafer_viewer.model.acquisition.rig_limits import AxisLimits
from wafer_viewer.model.errors import MotionStopped, RigError

BEYOND_UM = 1.0
"""Distance of a forbidden goal from the soft limit, um."""
TOO_FAST = 10.0
"""Forbidden speed as a multiple of the limit."""
GOALS = (0.0, 1.0, 0.25, 0.75, 0.5)
"""Goals as fractions of the range."""
N_APPROACHES = 5
"""Approaches of the same goal from either side."""
APPROACH_FROM = (0.1, 0.9)
"""Beginnings of these approaches, as fractions of the range."""
STOP_AT = 0.4
"""Place of the request to stop, as a fraction of the range."""
LATE_S = 0.1
"""Time in s that a driver may let pass between two looks at the request to stop."""
STEADY_S = 0.2
"""Time in s after a stop over which the stage has to stand."""


def homed(bench: ConformanceBench) -> CheckOutcome:
    """Home a stage that is not homed: z to its lower end, then x and y to the middle of their ranges."""
    rig = bench.rig
    before = rig.stage.homed()
    if not before:
        limits = rig.limits
        bench.go("z", limits.z.low_um)
        for axis in ("x", "y"):
            one = limits.axis(axis)
            bench.go(axis, (one.low_um + one.high_um) / 2)
    figures = (figure(f"{axis} at", bench.position_um(axis), "um") for axis in AXES)
    lost = (
        "" if rig.stage.homed() else "The stage does not report that it is homed after its search for the references."
    )
    return outcome(figures, lost)


def soft_limits(bench: ConformanceBench) -> CheckOutcome:
    """Ask for goals outside of the range and for a speed over the limit; a stop is requested from the beginning."""
    tried, faults = 0, list[str]()
    for axis in bench.windows:
        limits = bench.rig.limits.axis(axis)
        ends_um = (limits.low_um - BEYOND_UM, limits.high_um + BEYOND_UM)
        for goal_um in ends_um[:1] if axis == "z" else ends_um:
            tried += 1
            before_um = bench.position_um(axis)
            accepted = _accepts_goal(bench, axis, goal_um)
            moved_um = abs(bench.position_um(axis) - before_um)
            if accepted:
                faults.append(f"The {axis} axis accepted a goal at {goal_um:.1f} um, outside of its range.")
            if moved_um > ARRIVED_WITHIN_UM:
                faults.append(f"The {axis} axis moved by {moved_um:.1f} um at a goal that it had to refuse.")
        tried += 1
        if _accepts_speed(bench, axis, limits):
            faults.append(f"The {axis} axis accepted a speed of {TOO_FAST * limits.speed_um_s:.0f} um/s.")
    return outcome((figure("goals and speeds to refuse", tried, "1"),), *faults)


def arrives(bench: ConformanceBench) -> CheckOutcome:
    """Go to several goals on every axis."""
    figures, faults = [], list[str]()
    for axis, window in bench.windows.items():
        others: list[Axis] = [one for one in AXES if one != axis]
        before = {one: bench.position_um(one) for one in others}
        worst_um, worst_at_um, worst_goal_um = 0.0, 0.0, window.at_um(GOALS[0])
        for goal_um in map(window.at_um, GOALS):
            bench.go(axis, goal_um)
            here_um = bench.position_um(axis)
            if abs(here_um - goal_um) > worst_um:
                worst_um, worst_at_um, worst_goal_um = abs(here_um - goal_um), here_um, goal_um
        drift_um = max(abs(bench.position_um(one) - before[one]) for one in others)
        figures += [figure(f"{axis} off by", worst_um, "um"), figure(f"others moved, with {axis}", drift_um, "um")]
        if worst_um > ARRIVED_WITHIN_UM:
            faults.append(
                f"The {axis} axis stands at {worst_at_um:.2f} um instead of {worst_goal_um:.2f} um: it missed its goal "
                f"by {worst_um:.2f} um."
            )
        if drift_um > ARRIVED_WITHIN_UM:
            faults.append(f"Another axis moved by {drift_um:.2f} um with a motion of the {axis} axis alone.")
    return outcome(figures, *faults)


def repeats(bench: ConformanceBench) -> CheckOutcome:
    """Approach the middle of every range from both sides."""
    figures, faults = [], list[str]()
    for axis, window in bench.windows.items():
        means_um, spreads_um = list[float](), list[float]()
        for begin in APPROACH_FROM:
            found = [_approach(bench, window, begin) for _ in range(N_APPROACHES)]
            means_um.append(sum(found) / len(found))
            spreads_um.append(max(found) - min(found))
        reversal_um = abs(means_um[1] - means_um[0])
        figures += [
            figure(f"{axis} spread from one side", max(spreads_um), "um"),
            figure(f"{axis} reversal", reversal_um, "um"),
        ]
        if max(spreads_um) > ARRIVED_WITHIN_UM:
            faults.append(f"The {axis} axis came to rest in places {max(spreads_um):.2f} um apart from the same side.")
        if reversal_um > ARRIVED_WITHIN_UM:
            faults.append(f"The {axis} axis came to rest {reversal_um:.2f} um apart from its two sides.")
    return outcome(figures, *faults)


def stops(bench: ConformanceBench) -> CheckOutcome:
    """Request a stop in the middle of a motion of every axis."""
    figures, faults = [], list[str]()
    for axis, window in bench.windows.items():
        bench.go(axis, window.low_um)
        halt = _HaltInMidMove(bench, window)
        found_um, allowed_um = halt.run()
        figures += [figure(f"{axis} halted in", found_um, "um"), figure(f"{axis} allowed", allowed_um, "um")]
        if halt.fault:
            faults.append(halt.fault)
    return outcome(figures, *faults)


def in_time(bench: ConformanceBench) -> CheckOutcome:
    """Time motions over every range at full speed."""
    figures, faults = [], list[str]()
    for axis, window in bench.windows.items():
        bench.go(axis, window.low_um)
        for to_um in (window.high_um, window.low_um):
            expected_s = window.limits.move_s(to_um - bench.position_um(axis))
            began_s = bench.rig.clock.now_s()
            bench.go(axis, to_um)
            took_s = bench.rig.clock.now_s() - began_s
            limit_s = expected_s * (1 + SPARE_FRACTION) + SPARE_S
            if took_s > limit_s:
                faults.append(
                    f"The {axis} axis took {took_s:.2f} s for a motion that is given up after {limit_s:.2f} s."
                )
        figures += [figure(f"{axis} took", took_s, "s"), figure(f"{axis} expected", expected_s, "s")]
    return outcome(figures, *faults)


class _HaltInMidMove:
    """A motion over a range that is stopped on its way."""

    def __init__(self, bench: ConformanceBench, window: TravelWindow) -> None:
        self._bench, self._window = bench, window
        self._asked_um: float | None = None
        self.fault = ""

    def run(self) -> tuple[float, float]:
        """Return the distance to rest after the request, and the one that is allowed, um."""
        bench, window, axis = self._bench, self._window, self._window.axis
        goal: dict[Axis, float | None] = {"x": None, "y": None, "z": None, axis: window.high_um}
        ended = False
        try:
            with device_errors("stage"):
                bench.rig.stage.move_to(x_um=goal["x"], y_um=goal["y"], z_um=goal["z"], should_stop=self._should_stop)
            ended = True
        except MotionStopped:
            bench.require_running()
        rest_um = bench.position_um(axis)
        still_moving = bench.rig.stage.moving()
        bench.rig.clock.sleep(STEADY_S)
        crept_um = abs(bench.position_um(axis) - rest_um)
        top_um_s = min(window.limits.speed_um_s, math.sqrt(window.length_um * window.limits.acceleration_um_s2))
        allowed_um = window.limits.ramp_um(top_um_s) + top_um_s * LATE_S
        found_um = 0.0 if self._asked_um is None else rest_um - self._asked_um
        self.fault = self._faults(axis, found_um, allowed_um, ended, still_moving or crept_um > ARRIVED_WITHIN_UM)
        return found_um, allowed_um

    def _faults(self, axis: Axis, found_um: float, allowed_um: float, ended: bool, moving: bool) -> str:
        if self._asked_um is None:
            return f"The driver of the {axis} axis did not ask on the way whether to stop."
        if ended:
            return f"The {axis} axis went on to its goal after the request to stop."
        if moving:
            return f"The {axis} axis still moved when the driver reported that it was stopped."
        if found_um > allowed_um:
            return (
                f"The {axis} axis stopped {found_um:.1f} um after the request, where {allowed_um:.1f} um are allowed."
            )
        return ""

    def _should_stop(self) -> bool:
        if self._bench.should_stop():
            return True
        here_um = self._bench.position_um(self._window.axis)
        if self._asked_um is None and here_um >= self._window.at_um(STOP_AT):
            self._asked_um = here_um
        return self._asked_um is not None


def _approach(bench: ConformanceBench, window: TravelWindow, begin: float) -> float:
    """Return the place where an axis comes to rest in the middle of its range."""
    bench.go(window.axis, window.at_um(begin))
    bench.go(window.axis, window.at_um(0.5))
    return bench.position_um(window.axis)


def _accepts_goal(bench: ConformanceBench, axis: Axis, goal_um: float) -> bool:
    """Return whether a goal is accepted. The request to stop from the beginning keeps a wrong driver from moving."""
    goal: dict[Axis, float | None] = {"x": None, "y": None, "z": None, axis: goal_um}
    try:
        with device_errors("stage"):
            bench.rig.stage.move_to(x_um=goal["x"], y_um=goal["y"], z_um=goal["z"], should_stop=lambda: True)
    except MotionStopped:
        return True
    except RigError:
        return False
    return True


def _accepts_speed(bench: ConformanceBench, axis: Axis, limits: AxisLimits) -> bool:
    """Return whether a speed over the limit is accepted, for a motion to where the axis stands."""
    stage = bench.rig.stage
    here_um = min(max(at_um(stage.position(), axis), limits.low_um), limits.high_um)
    try:
        with device_errors("stage"):
            stage.start(axis, here_um, TOO_FAST * limits.speed_um_s)
    except RigError:
        return False
    stage.stop()
    stage.wait()
    return True


STAGE: tuple[DeviceRole, ...] = ("stage",)
CHECKS = (
    ConformanceCheck(
        "stage_homed",
        "Homing",
        "stage",
        STAGE,
        True,
        "The stage reports that it is homed; if it is not, it finds its references when it is told to move, z first.",
        homed,
    ),
    ConformanceCheck(
        "stage_soft_limits",
        "Soft limits",
        "stage",
        STAGE,
        True,
        f"A goal {BEYOND_UM:g} um outside of the range and a speed over the limit are refused before anything moves. "
        "The z axis is tried at its lower end only.",
        soft_limits,
    ),
    ConformanceCheck(
        "stage_arrives",
        "Arrival",
        "stage",
        STAGE,
        True,
        f"Every axis stands within {ARRIVED_WITHIN_UM:g} um of its goal after a move, and the others stay where they "
        "are.",
        arrives,
    ),
    ConformanceCheck(
        "stage_repeats",
        "Repeatability",
        "stage",
        STAGE,
        True,
        f"{N_APPROACHES} approaches of one goal from either side end within {ARRIVED_WITHIN_UM:g} um of each other, by "
        "the position that the stage reports.",
        repeats,
    ),
    ConformanceCheck(
        "stage_stops",
        "Stop in mid-move",
        "stage",
        STAGE,
        True,
        f"A move that is stopped on its way ends within its braking distance and {LATE_S:g} s of full speed, and the "
        "stage stands then.",
        stops,
    ),
    ConformanceCheck(
        "stage_in_time",
        "Deadline",
        "stage",
        STAGE,
        True,
        f"A motion at full speed ends within {1 + SPARE_FRACTION:g} times its expected time and {SPARE_S:g} s, and the "
        "stage says so.",
        in_time,
    ),
)
"""Demands on the stage."""
