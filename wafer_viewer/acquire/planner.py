"""Scan planner: checks a scan, prices every strategy and lays out the chosen one in legs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.acquire.passes import (
    Pass,
    Task,
    alternating_passes,
    alternation_obstacle,
    line_obstacle,
    line_passes,
    shoot_passes,
    z_passes,
)
from wafer_viewer.model.acquisition.plan import AXES, Field, FocusSweep, Price, ScanPlan
from wafer_viewer.model.acquisition.rig_limits import AxisLimits, RigLimits
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.spec import replace

STEP_TOLERANCE = 0.01
"""Permitted relative deviation of a z step from whole counts of the scale."""


def check_fields(fields: tuple[Field, ...], limits: RigLimits) -> None:
    """Raise PlanError without fields, for a repeated number, or for a field outside the stage's range."""
    if not fields:
        raise PlanError("The plan has 0 fields: at least 1 is needed; lay a grid over the sample or list fields.")
    number, times = Counter(f.number for f in fields).most_common(1)[0]
    if times > 1:
        raise PlanError(f"Field number {number} is there {times} times: every field needs a number of its own.")
    for field in fields:
        _check_place(field, limits)


def check_exposures(exposures_us: tuple[float, ...], limits: RigLimits) -> None:
    """Raise PlanError without exposures, or for one that the camera cannot take."""
    if not exposures_us:
        raise PlanError("The plan has 0 exposures: at least 1 is needed; give an exposure time in us.")
    low_us, high_us = limits.camera.exposure_min_us, limits.camera.exposure_max_us
    for exposure_us in exposures_us:
        if not low_us <= exposure_us <= high_us:
            raise PlanError(
                f"The exposure of {exposure_us:g} us is out of the camera's range, {low_us:g} to {high_us:g} us: "
                "choose one within it and correct the brightness with the light."
            )


def check_sweep(fields: tuple[Field, ...], sweep: FocusSweep, limits: RigLimits) -> None:
    """Raise PlanError if a sweep leaves the z range or brings the objective too close to the sample."""
    for field in fields:
        _check_height(field, sweep, limits)
    _check_clearance(fields, sweep, limits)


def whole_counts(sweep: FocusSweep, limits: RigLimits) -> FocusSweep:
    """Return the sweep with its step in whole counts; raise PlanError if that changes it by over 1 %."""
    counts, count_um = limits.z.counts(sweep.z_step_um), 1 / limits.z.counts_per_um
    step_um = counts * count_um
    if abs(step_um - sweep.z_step_um) <= STEP_TOLERANCE * sweep.z_step_um:
        return replace(sweep, z_step_um=round(step_um, 9))
    below = int(sweep.z_step_um / count_um)
    nearest = " or ".join(f"{n * count_um:g} um" for n in sorted({max(1, below), below + 1}))
    raise PlanError(
        f"The z step of {sweep.z_step_um:g} um is {sweep.z_step_um / count_um:.2f} counts of the z scale and may be at "
        f"most {STEP_TOLERANCE:.0%} off whole counts: choose {nearest}."
    )


def _check_place(field: Field, limits: RigLimits) -> None:
    for name, at_um in (("x", field.x_um), ("y", field.y_um)):
        axis = limits.axis("x" if name == "x" else "y")
        if not axis.low_um <= at_um <= axis.high_um:
            raise PlanError(
                f"Field {field.number} lies at {name} {at_um:.1f} um, out of the stage's range "
                f"{axis.low_um:g} to {axis.high_um:g} um: move the grid or take fewer fields."
            )


def _check_height(field: Field, sweep: FocusSweep, limits: RigLimits) -> None:
    low_um, high_um = field.z_start_um, sweep.top_um(field)
    if low_um < limits.z.low_um or high_um > limits.z.high_um:
        raise PlanError(
            f"Field {field.number} sweeps z {low_um:.1f} to {high_um:.1f} um, out of the stage's range "
            f"{limits.z.low_um:g} to {limits.z.high_um:g} um: change its z start or take a shorter sweep."
        )


def _check_clearance(fields: tuple[Field, ...], sweep: FocusSweep, limits: RigLimits) -> None:
    """Check the clearance: at the start of the lowest sweep the lens is closest to the highest point of the sample."""
    lowest = min(fields, key=lambda f: f.z_start_um)
    drop_um = max(map(sweep.top_um, fields)) - lowest.z_start_um
    objective = limits.objective
    free_um = objective.working_distance_um - objective.clearance_um
    if drop_um > free_um:
        raise PlanError(
            f"Field {lowest.number} begins {drop_um:.1f} um under the highest focus of the scan, and the objective may "
            f"come down {free_um:g} um (working distance {objective.working_distance_um:g} um less clearance "
            f"{objective.clearance_um:g} um): take a shorter sweep."
        )


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
    axis, exposure_s = task.limits.axis(one.axis), task.exposures_us[one.exposures[0]] * 1e-6
    step_s = float(travel_s(axis, np.array([axis.position_um(one.pitch_counts)]))[0])
    return one.n_frames * max(exposure_s + step_s, task.period_s(one.exposures[0]))


@dataclass(frozen=True, slots=True)
class Strategy:
    """A scan strategy: its passes in order, and the reason why it is impossible, if any.

    min_exposures: number of exposures from which it differs from the others and is priced.
    """

    title: str
    passes: Callable[[Task], Iterable[Pass]]
    obstacle: Callable[[Task], str | None] = lambda task: None
    min_exposures: int = 1


STRATEGIES: dict[str, Strategy] = {
    "z_snake": Strategy("Z passes, up and down", partial(z_passes, snake=True)),
    "z_up": Strategy("Z passes, upward", partial(z_passes, snake=False)),
    "x_lines": Strategy(
        "X passes, one z each", partial(line_passes, line="x"), obstacle=partial(line_obstacle, line="x")
    ),
    "y_lines": Strategy(
        "Y passes, one z each", partial(line_passes, line="y"), obstacle=partial(line_obstacle, line="y")
    ),
    "z_alternating": Strategy(
        "Z passes, exposures in turn", alternating_passes, obstacle=alternation_obstacle, min_exposures=2
    ),
    "stop_and_shoot": Strategy("Stop and shoot", shoot_passes),
}
"""Strategies by name; those that take exposures in turn are for two exposures or more."""


def plan_scan(
    fields: tuple[Field, ...],
    sweep: FocusSweep,
    exposures_us: tuple[float, ...],
    limits: RigLimits,
    strategy: str = "auto",
) -> ScanPlan:
    """Plan a scan: price all strategies and use the named one, or the fastest feasible one.

    Every (field, k, exposure) is in exactly one leg. The plan's z step is rounded to whole counts.
    Raises PlanError if a field, the sweep or an exposure is beyond the rig's limits, if the step is over 1 % off whole
    counts, and if the strategy is unknown or ruled out.
    """
    task = checked_task(fields, sweep, exposures_us, limits)
    priced = {name: _priced(task, name) for name in _strategies_of(task)}
    prices = tuple(price for price, _ in priced.values())
    price, passes = priced[_chosen(prices, strategy)]
    return ScanPlan(
        fields=task.fields,
        sweep=task.sweep,
        exposures_us=task.exposures_us,
        strategy=price.strategy,
        legs=tuple(p.leg(limits) for p in passes),
        predicted_s=price.predicted_s or 0.0,
        prices=prices,
        rows=limits.camera.rows,
        cols=limits.camera.cols,
        pixel_um=limits.pixel_um,
        depth_of_field_um=limits.depth_of_field_um,
    )


def price_all(
    fields: tuple[Field, ...], sweep: FocusSweep, exposures_us: tuple[float, ...], limits: RigLimits
) -> tuple[Price, ...]:
    """Return the price of every strategy, or the reason against it. Raises PlanError as plan_scan does."""
    task = checked_task(fields, sweep, exposures_us, limits)
    return tuple(_priced(task, name)[0] for name in _strategies_of(task))


def checked_task(
    fields: tuple[Field, ...], sweep: FocusSweep, exposures_us: tuple[float, ...], limits: RigLimits
) -> Task:
    """Return the task after checking it against the rig's limits; raise PlanError if it is impossible."""
    check_fields(fields, limits)
    check_exposures(exposures_us, limits)
    sweep = whole_counts(sweep, limits)
    check_sweep(fields, sweep, limits)
    return Task(fields=tuple(fields), sweep=sweep, exposures_us=tuple(exposures_us), limits=limits)


def _strategies_of(task: Task) -> list[str]:
    return [name for name, strategy in STRATEGIES.items() if len(task.exposures_us) >= strategy.min_exposures]


def _priced(task: Task, name: str) -> tuple[Price, list[Pass]]:
    strategy = STRATEGIES[name]
    obstacle = strategy.obstacle(task)
    if obstacle is not None:
        return Price(strategy=name, title=strategy.title, ruled_out=obstacle), []
    passes = list(strategy.passes(task))
    travel = travel_of(task.limits, passes)
    obstacle = _out_of_range(task.limits, travel)
    if obstacle is not None:
        return Price(strategy=name, title=strategy.title, ruled_out=obstacle), []
    seconds, n_motions = predicted_s(task, passes, travel), motions(passes, travel)
    n_frames = sum(one.n_frames for one in passes)
    price = Price(strategy=name, title=strategy.title, predicted_s=seconds, motions=n_motions, n_frames=n_frames)
    return price, passes


def _out_of_range(limits: RigLimits, travel: Travel) -> str | None:
    """Return a sentence if the run-up or run-out of a pass leaves the stage's range, else None."""
    for i, name in enumerate(AXES):
        axis, at_um = limits.axis(name), np.append(travel.begin_um[:, i], travel.end_um[:, i])
        low_um, high_um = at_um.min(), at_um.max()
        if low_um < axis.low_um or high_um > axis.high_um:
            return (
                f"its run-up and run-out need {name} {low_um:.2f} to {high_um:.2f} um, "
                f"and the stage goes from {axis.low_um:g} to {axis.high_um:g} um."
            )
    return None


def _chosen(prices: tuple[Price, ...], strategy: str) -> str:
    feasible = [p for p in prices if p.ruled_out is None]
    if strategy != "auto" and strategy not in STRATEGIES:
        raise PlanError(f"There is no strategy '{strategy}': choose auto or one of {', '.join(STRATEGIES)}.")
    if strategy == "auto" and feasible:
        return min(feasible, key=lambda p: p.predicted_s or 0.0).strategy
    price = next((p for p in prices if strategy in ("auto", p.strategy)), None)
    if price is None:
        title, least = STRATEGIES[strategy].title, STRATEGIES[strategy].min_exposures
        raise PlanError(f"The strategy '{title}' is for {least} exposures or more: choose auto, or add an exposure.")
    if price.ruled_out is not None:
        raise PlanError(f"The strategy '{price.title}' is ruled out: {price.ruled_out}")
    return price.strategy
