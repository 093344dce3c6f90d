"""How long a strategy takes: the time of its passes and of the moves between them, from trapezoidal motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.acquire.passes import AXES, Pass, Task
from wafer_viewer.model.limits import AxisLimits, RigLimits

PASS_OVERHEAD_S = 0.02
"""Arming the box, starting the camera and fetching the last image of a pass."""

Floats = NDArray[np.float64]


def predicted_s(task: Task, passes: Sequence[Pass]) -> float:
    """Seconds from the start of the first pass to the end of the last; the way to the first is not counted."""
    begin, end = travel_um(task.limits, passes)
    moves = move_s(task.limits, end[:-1], begin[1:])
    return float(_pass_s(task, passes).sum() + moves.sum() + PASS_OVERHEAD_S * len(passes))


def travel_um(limits: RigLimits, passes: Sequence[Pass]) -> tuple[Floats, Floats]:
    """Where each pass begins and ends with its run-up and run-out: two arrays [pass, axis]."""
    first = np.array([p.start_um for p in passes])
    last = np.array([p.end_um(limits) for p in passes])
    run_up = np.array([p.direction * run_up_um(limits, p) for p in passes])
    axis = np.array([AXES.index(p.axis) for p in passes])
    rows = np.arange(len(passes))
    first[rows, axis] -= run_up
    last[rows, axis] += run_up
    return first, last


def run_up_um(limits: RigLimits, one: Pass) -> float:
    """The way before the first pulse, and past the last."""
    return limits.axis(one.axis).run_up_um(one.speed_um_s) if one.speed_um_s else 0.0


def move_s(limits: RigLimits, start_um: Floats, end_um: Floats) -> Floats:
    """Seconds of moves of all axes at once, each settling: [move, axis] positions to [move] times."""
    by_axis = [travel_s(limits.axis(name), np.abs(end_um[:, i] - start_um[:, i])) for i, name in enumerate(AXES)]
    return np.max(by_axis, axis=0) if len(start_um) else np.zeros(0)


def travel_s(axis: AxisLimits, distance_um: Floats) -> Floats:
    """Seconds of one axis' move over each distance with its settling; none where it stays."""
    ramps_um = 2 * axis.ramp_um(axis.speed_um_s)
    short = 2 * np.sqrt(distance_um / axis.acceleration_um_s2)
    long = 2 * axis.speed_um_s / axis.acceleration_um_s2 + (distance_um - ramps_um) / axis.speed_um_s
    return np.where(distance_um > 0, np.where(distance_um < ramps_um, short, long) + axis.settle_s, 0.0)


def _pass_s(task: Task, passes: Sequence[Pass]) -> Floats:
    return np.array([_moving_s(task.limits, p) if p.speed_um_s else _shooting_s(task, p) for p in passes])


def _moving_s(limits: RigLimits, one: Pass) -> float:
    axis, speed = limits.axis(one.axis), one.speed_um_s
    length_um = axis.position_um(one.pitch_counts * (one.n_frames - 1)) + 2 * axis.run_up_um(speed)
    return length_um / speed + speed / axis.acceleration_um_s2


def _shooting_s(task: Task, one: Pass) -> float:
    axis, exposure_s = task.limits.axis(one.axis), task.exposures_us[one.exposure] * 1e-6
    step_s = float(travel_s(axis, np.array([axis.position_um(one.pitch_counts)]))[0])
    return one.n_frames * max(exposure_s + step_s, task.period_s(one.exposure))
