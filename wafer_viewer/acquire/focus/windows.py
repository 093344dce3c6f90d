"""Windows of the fields of a scan that follows the focus, their price, and wider ones where a focus touches an end.

Every window is a part of the field's sweep: its frames lie at the heights where those of the whole sweep would.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.acquire.focus.coarse_look import LOOK, LookForFocus, first_places, spread
from wafer_viewer.acquire.focus.surface import FocusRange, predicted_ranges
from wafer_viewer.acquire.planner import plan_scan, price_all, whole_counts
from wafer_viewer.model.acquisition.plan import (
    FOLLOW_FOCUS,
    FOLLOW_TITLE,
    CoarseLook,
    Field,
    FocusSweep,
    FollowFocus,
    Price,
    ScanPlan,
)
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.spec import replace

Floats = NDArray[np.float64]
LEAST_FRAMES = 12
"""Shortest window: with fewer frames the reconstruction tests less."""
MARGIN_DEPTHS = 2.5
"""Depths of field that a window has beyond the asked depth, so that focus curves show their flanks.

With 20 um of margin about the true heights, 4 % of the pixels were lost on seed 1, with 30 um under 0.5 %.
"""
TELLING_PLACES = 4
"""Number of places in focus from which the range of their heights bounds that of the sample."""
ASSUMED_U_DEPTHS = 1.0
"""Standard uncertainty of the prediction, in depths of field, that is assumed before the look."""


def plan_following(
    fields: tuple[Field, ...],
    sweep: FocusSweep,
    exposures_us: tuple[float, ...],
    limits: RigLimits,
    strategy: str,
    follow: FollowFocus,
    look: CoarseLook | None = None,
) -> ScanPlan:
    """Plan a scan, with following the focus as one more strategy; its price contains the coarse look.

    Before the look its windows are a guess of their usual length, and such a plan is not for scanning.

    Parameters
    ----------
    fields : tuple of Field
        Fields of the scan, each with the start of its whole sweep.
    sweep : FocusSweep
        Range in which the focus is searched.
    exposures_us : tuple of float
        Exposures, us.
    limits : RigLimits
        Limits of the rig.
    strategy : str
        Name of a strategy, or ``auto`` for the fastest.
    follow : FollowFocus
        Depth about the focus and coverage factor.
    look : CoarseLook, optional
        Findings of the coarse look.

    Returns
    -------
    ScanPlan
        Plan with all prices.

    Raises
    ------
    PlanError
        As by the planner.
    """
    sweep = whole_counts(sweep, limits)
    own = fields_in_focus(fields, sweep, limits, follow, look) if look else assumed(fields, sweep, limits, follow)
    plan = plan_scan(own, sweep, exposures_us, limits, "z_snake")
    look_s = look.duration_s if look is not None else assumed_look_s(fields, sweep, exposures_us, limits)
    price = next(price for price in plan.prices if price.strategy == plan.strategy)
    price = replace(
        price,
        strategy=FOLLOW_FOCUS,
        title=FOLLOW_TITLE,
        predicted_s=plan.predicted_s + look_s,
        look_s=look_s,
        estimated=look is None,
    )
    prices = (price, *price_all(fields, sweep, exposures_us, limits))
    if _chosen(prices, strategy) != FOLLOW_FOCUS:
        return replace(plan_scan(fields, sweep, exposures_us, limits, strategy), prices=prices)
    return replace(plan, strategy=FOLLOW_FOCUS, predicted_s=price.predicted_s, prices=prices, coarse_look=look)


def fields_in_focus(
    fields: tuple[Field, ...], sweep: FocusSweep, limits: RigLimits, follow: FollowFocus, look: CoarseLook
) -> tuple[Field, ...]:
    """Return the fields with their windows by a coarse look; a field without focus keeps the whole sweep.

    A field that was looked at has the window of what was found in it. No other window reaches farther beyond all that
    was found than its own length, however little a few places tell: focus beyond that shows at an end of the window.

    Parameters
    ----------
    fields : tuple of Field
        Fields with the start of the whole sweep.
    sweep : FocusSweep
        The whole sweep.
    limits : RigLimits
        Limits of the rig.
    follow : FollowFocus
        Depth about the focus and coverage factor.
    look : CoarseLook
        Findings of the coarse look.

    Returns
    -------
    tuple of Field
        Fields with their windows, in the same order.

    Raises
    ------
    RigError
        If the look found no focus anywhere.
    """
    ranges = ranges_of(fields, look, limits)
    low_um, high_um = _within_reach(look, follow.coverage_factor, *ranges.reach(follow.coverage_factor))
    margin_um = MARGIN_DEPTHS * limits.depth_of_field_um
    lows, highs = low_um - follow.below_um - margin_um, high_um + follow.above_um + margin_um
    blank = {place.field for place in look.places if not place.found}
    return tuple(
        field if field.number in blank else windowed(field, sweep, low, high)
        for field, low, high in zip(fields, lows.tolist(), highs.tolist(), strict=True)
    )


def ranges_of(fields: tuple[Field, ...], look: CoarseLook, limits: RigLimits) -> FocusRange:
    """Return the range in focus of fields by a coarse look: what was found in them, otherwise as predicted.

    Parameters
    ----------
    fields : tuple of Field
        Fields.
    look : CoarseLook
        Findings of the coarse look.
    limits : RigLimits
        Limits of the rig.

    Returns
    -------
    FocusRange
        Range in focus of each field, in the same order.

    Raises
    ------
    RigError
        If the look found no focus anywhere.
    """
    x_um, y_um = (np.array([getattr(field, f"{axis}_um") for field in fields]) for axis in "xy")
    ranges = predicted_ranges(look.places, x_um, y_um, (limits.field_width_um, limits.field_height_um))
    looked_at = {place.field: place for place in look.found}
    for i, field in enumerate(fields):
        if (place := looked_at.get(field.number)) is not None:
            ranges.low_um[i], ranges.high_um[i] = place.low_um, place.high_um
            ranges.u_low_um[i] = ranges.u_high_um[i] = place.u_um
    return ranges


def _within_reach(look: CoarseLook, factor: float, low_um: Floats, high_um: Floats) -> tuple[Floats, Floats]:
    """Return predicted ends no farther beyond all heights that a look found than their range, or their uncertainty.

    They are as predicted where the look found too few places to tell a range.
    """
    if len(look.found) < TELLING_PLACES:
        return low_um, high_um
    lowest_um, highest_um = min(p.low_um for p in look.found), max(p.high_um for p in look.found)
    range_um = max(highest_um - lowest_um, factor * max(p.u_um for p in look.found))
    return np.maximum(low_um, lowest_um - range_um), np.minimum(high_um, highest_um + range_um)


def windowed(field: Field, sweep: FocusSweep, low_um: float, high_um: float) -> Field:
    """Return a field with the part of its whole sweep from low_um to high_um, at least `LEAST_FRAMES` long."""
    last, least = sweep.n_frames - 1, min(LEAST_FRAMES, sweep.n_frames)
    step_um = sweep.z_step_um
    first = math.floor((low_um - field.z_start_um) / step_um + 1e-6)
    end = math.ceil((high_um - field.z_start_um) / step_um - 1e-6)
    short = max(0, least - (end - first + 1))
    first, end = first - (short + 1) // 2, end + short // 2
    first = min(max(first, 0), last - least + 1)
    end = max(min(end, last), first + least - 1)
    if end - first >= last:
        return replace(field, n_frames=None)
    return replace(field, z_start_um=round(field.z_start_um + first * step_um, 9), n_frames=end - first + 1)


def widened(field: Field, whole: Field, sweep: FocusSweep, ends: tuple[bool, bool]) -> Field:
    """Return a field with its window longer by its own length at the touched ends (low, high), within the whole sweep.

    Parameters
    ----------
    field : Field
        Field with its window.
    whole : Field
        The same field with the start of its whole sweep.
    sweep : FocusSweep
        The whole sweep.
    ends : tuple of bool
        Whether heights in focus touch the low and the high end.

    Returns
    -------
    Field
        Field with its wider window; `field` itself where both touched ends are those of the whole sweep.
    """
    low_um, high_um = field.z_start_um, sweep.top_um(field)
    length_um = high_um - low_um
    wide = windowed(whole, sweep, low_um - length_um * ends[0], high_um + length_um * ends[1])
    same = (wide.z_start_um, sweep.frames_of(wide)) == (field.z_start_um, sweep.frames_of(field))
    return field if same else wide


def replanned(plan: ScanPlan, wider: Mapping[int, Field], limits: RigLimits) -> ScanPlan:
    """Return the plan with other windows of some fields; only these are in its legs.

    Parameters
    ----------
    plan : ScanPlan
        Plan of the scan.
    wider : mapping of int to Field
        Fields by number.
    limits : RigLimits
        Limits of the rig.

    Returns
    -------
    ScanPlan
        Plan with all fields, and with the legs of the given ones.
    """
    part = plan_scan(tuple(wider.values()), plan.sweep, plan.exposures_us, limits, "z_snake")
    return replace(plan, fields=tuple(wider.get(field.number, field) for field in plan.fields), legs=part.legs)


def assumed(fields: tuple[Field, ...], sweep: FocusSweep, limits: RigLimits, follow: FollowFocus) -> tuple[Field, ...]:
    """Return the fields with windows of the length that is assumed before the look, in the middle of the sweep."""
    depth_um = limits.depth_of_field_um
    half_um = depth_um * (MARGIN_DEPTHS + follow.coverage_factor * ASSUMED_U_DEPTHS)
    middle_um = sweep.range_um / 2
    return tuple(
        windowed(
            field,
            sweep,
            field.z_start_um + middle_um - half_um - follow.below_um,
            field.z_start_um + middle_um + half_um + follow.above_um,
        )
        for field in fields
    )


def assumed_look_s(
    fields: tuple[Field, ...], sweep: FocusSweep, exposures_us: tuple[float, ...], limits: RigLimits
) -> float:
    """Return the duration of a coarse look at its first places, and half as long again for those added."""
    at_um = np.array([(field.x_um, field.y_um) for field in fields])
    places = tuple(fields[i] for i in spread(at_um, first_places(len(fields))))
    look = LookForFocus(fields, sweep, exposures_us[0], parameters=LOOK)
    coarse = look.coarse_sweep(limits)
    return 1.5 * plan_scan(places, coarse, exposures_us[:1], limits, "z_snake").predicted_s


def _chosen(prices: Iterable[Price], strategy: str) -> str:
    if strategy != "auto":
        return strategy
    return min((p for p in prices if p.ruled_out is None), key=lambda p: p.predicted_s or 0.0).strategy
