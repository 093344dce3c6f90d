"""Duration of a strategy: its passes and the moves between them, with trapezoidal velocity profiles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.acquire.passes import AXES, Pass, Task
from wafer_viewer.model.acquisition.rig_limits import AxisLimits, RigLimits

PASS_OVERHEAD_S = 0.02
"""Overhead of a pass: arming the box, starting the camera and fetching the last image."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Travel:
    """Start and end positions of the passes in um, [pass, axis], including run-up and run-out."""

    begin_um: Floats
    end_um: Floats


def predicted_s(task: Task, passes: Sequence[Pass], travel: Travel) -> float:
    """Return the seconds from the start of the first pass to the end of the last, without the move to the first."""
    moves = move_s(task.limits, travel.end_um[:-1], travel.begin_um[1:])
    return float(_pass_s(task, passes).sum() + moves.sum() + PASS_OVERHEAD_S * len(passes))


def motions(passes: Sequence[Pass], travel: Travel) -> int:
    """Return the number of motions that take frames: passes and returns, or every step of stop and shoot."""
    steps = sum(p.n_frames for p in passes if not p.speed_um_s)
    return steps or len(passes) + _returns(passes, travel)


def travel_of(limits: RigLimits, passes: Sequence[Pass]) -> Travel:
    """Return the travel of each pass."""
    first = np.array([p.start_um for p in passes])
    last = np.array([p.end_um(limits) for p in passes])
    run_up = np.array([p.direction * run_up_um(limits, p) for p in passes])
    rows, axis = _moving_axis(passes)
    first[rows, axis] -= run_up
    last[rows, axis] += run_up
    return Travel(first, last)


def run_up_um(limits: RigLimits, one: Pass) -> float:
    """Return the run-up of a pass in um, which equals its run-out."""
    return limits.axis(one.axis).run_up_um(one.speed_um_s) if one.speed_um_s else 0.0


def move_s(limits: RigLimits, start_um: Floats, end_um: Floats) -> Floats:
    """Return the durations in s of moves of all axes with settling: positions [move, axis] to times [move]."""
    by_axis = [travel_s(limits.axis(name), np.abs(end_um[:, i] - start_um[:, i])) for i, name in enumerate(AXES)]
    return np.max(by_axis, axis=0) if len(start_um) else np.zeros(0)


def travel_s(axis: AxisLimits, distance_um: Floats) -> Floats:
    """Return the duration in s of one axis' moves with settling; 0 for zero distance."""
    ramps_um = 2 * axis.ramp_um(axis.speed_um_s)
    short = 2 * np.sqrt(distance_um / axis.acceleration_um_s2)
    long = 2 * axis.speed_um_s / axis.acceleration_um_s2 + (distance_um - ramps_um) / axis.speed_um_s
    return np.where(distance_um > 0, np.where(distance_um < ramps_um, short, long) + axis.settle_s, 0.0)


def _returns(passes: Sequence[Pass], travel: Travel) -> int:
    """Return how often the axis must return over most of its pass before the next one can start."""
    moving = _moving_axis(passes)
    begin_um, end_um = travel.begin_um[moving], travel.end_um[moving]
    back_um = np.abs(begin_um[1:] - end_um[:-1])
    return int(np.count_nonzero(back_um > np.abs(end_um - begin_um)[:-1] / 2))


def _moving_axis(passes: Sequence[Pass]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the index of each pass' own axis in positions [pass, axis]."""
    return np.arange(len(passes)), np.array([AXES.index(p.axis) for p in passes])


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
