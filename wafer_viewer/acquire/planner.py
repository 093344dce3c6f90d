"""Scan planner: prices every strategy and lays out the chosen one in legs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

import numpy as np

from wafer_viewer.acquire.passes import AXES, Pass, Task, line_obstacle, line_passes, shoot_passes, z_passes
from wafer_viewer.acquire.plan_checks import check_exposures, check_fields, check_sweep, whole_counts
from wafer_viewer.acquire.pricing import Travel, motions, predicted_s, travel_of
from wafer_viewer.model.acquisition.plan import Field, FocusSweep, Price, ScanPlan
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.errors import PlanError


@dataclass(frozen=True, slots=True)
class Strategy:
    """A scan strategy: its passes in order, and the reason why it is impossible, if any."""

    title: str
    passes: Callable[[Task], Iterable[Pass]]
    obstacle: Callable[[Task], str | None] = lambda task: None


STRATEGIES: dict[str, Strategy] = {
    "z_snake": Strategy("Z passes, up and down", partial(z_passes, snake=True)),
    "z_up": Strategy("Z passes, upward", partial(z_passes, snake=False)),
    "x_lines": Strategy(
        "X passes, one z each", partial(line_passes, line="x"), obstacle=partial(line_obstacle, line="x")
    ),
    "y_lines": Strategy(
        "Y passes, one z each", partial(line_passes, line="y"), obstacle=partial(line_obstacle, line="y")
    ),
    "stop_and_shoot": Strategy("Stop and shoot", shoot_passes),
}


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
    priced = {name: _priced(task, name) for name in STRATEGIES}
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
    return tuple(_priced(task, name)[0] for name in STRATEGIES)


def checked_task(
    fields: tuple[Field, ...], sweep: FocusSweep, exposures_us: tuple[float, ...], limits: RigLimits
) -> Task:
    """Return the task after checking it against the rig's limits; raise PlanError if it is impossible."""
    check_fields(fields, limits)
    check_exposures(exposures_us, limits)
    sweep = whole_counts(sweep, limits)
    check_sweep(fields, sweep, limits)
    return Task(fields=tuple(fields), sweep=sweep, exposures_us=tuple(exposures_us), limits=limits)


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
    return Price(strategy=name, title=strategy.title, predicted_s=seconds, motions=n_motions), passes


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
    asked = next(p for p in prices if strategy in ("auto", p.strategy))
    if asked.ruled_out is not None:
        raise PlanError(f"The strategy '{asked.title}' is ruled out: {asked.ruled_out}")
    return asked.strategy
