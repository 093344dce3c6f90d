"""Verdicts: a measured height against its limits, by the guard band of ISO 14253-1 or by simple acceptance."""

from __future__ import annotations

import math
from collections.abc import Sequence

from wafer_viewer.measure.step import step_height
from wafer_viewer.model.alignment import Alignment
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.findings import Length
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.sample import Feature
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface import Mosaic
from wafer_viewer.model.verdict import Judged, Word

COVERAGE = 2.0
"""The factor k of every expanded uncertainty."""
LESS_WITH_REPEATS = ("noise and form of the faces", "interpolation between frames")
"""Lines of a step's budget that the mean of several scans makes smaller; the others are the same in each."""
MOST_REPEATS = 25
"""More scans than this are a matter for the engineer."""
GRAVEST: tuple[Word, ...] = ("fail", "no verdict", "inconclusive", "pass")
"""The word of a wafer is the first of these that any feature has."""


def judge_features(
    surface: Mosaic, features: Sequence[Feature], alignment: Alignment | None, *, calibration_valid: bool
) -> tuple[Judged, ...]:
    """Measure every feature that has a place, and judge it. What cannot be measured has no verdict and says why."""
    return tuple(_measured(surface, feature, alignment, calibration_valid) for feature in features if feature.has_place)


def judge(feature: Feature, height: Length) -> Judged:
    """A height against the limits of its feature.

    Guard band (ISO 14253-1): pass where all of value ± U lies within the limits, fail where all of it lies beyond one,
    else inconclusive. Simple acceptance: the value alone decides. Without an uncertainty neither gives a verdict.
    """
    if height.expanded_um is None:
        return Judged(feature=feature, height=height, word="no verdict", why=_no_uncertainty(height))
    half_um = height.expanded_um if feature.decision_rule == "guard_band" else 0.0
    low_um, high_um = height.value_um - half_um, height.value_um + half_um
    if feature.lower_limit_um <= low_um and high_um <= feature.upper_limit_um:
        return Judged(feature=feature, height=height, word="pass", why="Within the limits.")
    if high_um < feature.lower_limit_um or low_um > feature.upper_limit_um:
        beyond = "Under the lower limit." if high_um < feature.lower_limit_um else "Over the upper limit."
        return Judged(feature=feature, height=height, word="fail", why=beyond)
    return Judged(feature=feature, height=height, word="inconclusive", why=_undecided(feature, height))


def overall(items: Sequence[Judged]) -> Word:
    """The word for the wafer: fail where any feature fails, pass where all pass; nothing judged is no verdict."""
    gravest: list[Word] = [word for word in GRAVEST if any(item.word == word for item in items)]
    return gravest[0] if gravest else "no verdict"


def what_next(items: Sequence[Judged]) -> str:
    """What the operator does now."""
    match overall(items):
        case "pass":
            return "Take the next wafer."
        case "fail":
            return "Set the wafer aside, and take the next one."
        case "inconclusive":
            return _after_inconclusive([item for item in items if item.word == "inconclusive"])
        case _:
            reasons = dict.fromkeys(item.why for item in items if item.word == "no verdict")
            return " ".join(reasons) or "The job has no feature with a place to measure: ask the engineer."


def scans_needed(item: Judged) -> int | None:
    """How many scans, this one included, would decide if their mean stayed here; None where no number would."""
    height = item.height
    if height is None or not height.budget:
        return None
    to_limit_um = _nearest_limit_um(item.feature, height)
    repeats = COVERAGE**2 * math.fsum(c.u_um**2 for c in height.budget if c.name in LESS_WITH_REPEATS)
    stays = COVERAGE**2 * math.fsum(c.u_um**2 for c in height.budget if c.name not in LESS_WITH_REPEATS)
    room = to_limit_um**2 - stays
    n = math.ceil(repeats / room) if room > 0 else math.inf
    return int(n) if n <= MOST_REPEATS else None


def _measured(surface: Mosaic, feature: Feature, alignment: Alignment | None, calibration_valid: bool) -> Judged:
    if feature.upper is None or feature.lower is None:
        return Judged(feature=feature, word="no verdict", why=f"'{feature.name}' has no place to be measured at.")
    upper, lower = (on_stage(region, alignment) for region in (feature.upper, feature.lower))
    try:
        found = step_height(surface, upper, lower, calibration_valid=calibration_valid, name=feature.name)
    except MeasureError as fault:
        return Judged(feature=feature, word="no verdict", why=f"'{feature.name}' was not measured. {fault}")
    return judge(feature, found.height)


def on_stage(region: Region, alignment: Alignment | None) -> Region:
    """A region of the wafer where it lies on the stage; a rectangle that is turned becomes a polygon."""
    if alignment is None:
        return region
    if region.kind == "rectangle" and alignment.rotation_rad != 0:
        x0, y0, x1, y1 = region.bounds_um
        region = Region.polygon((x0, y0), (x1, y0), (x1, y1), (x0, y1))
    places = (alignment.to_stage(p.x_um, p.y_um) for p in region.points)
    return replace(region, points=tuple(Point(x_um=x, y_um=y) for x, y in places))


def _no_uncertainty(height: Length) -> str:
    if height.status == "uncalibrated":
        return "Without a calibration that holds there is no uncertainty: calibrate, then measure again."
    return "The uncertainty could not be evaluated: ask the engineer for larger regions."


def _undecided(feature: Feature, height: Length) -> str:
    near_um = _nearest_limit_um(feature, height)
    return f"{near_um:.2g} um from the limit, with U = {height.expanded_um or 0.0:.2g} um."


def _nearest_limit_um(feature: Feature, height: Length) -> float:
    return min(abs(height.value_um - limit) for limit in (feature.lower_limit_um, feature.upper_limit_um))


def _after_inconclusive(items: Sequence[Judged]) -> str:
    needed = [scans_needed(item) for item in items]
    worst = max((n for n in needed if n is not None), default=0)
    if None in needed or worst < 2:
        return (
            "Nearer to a limit than the uncertainty lets decide, and repeats would not help: "
            "calibrate the z scale anew, or ask the engineer."
        )
    times = "once more" if worst == 2 else f"{worst - 1} times more"
    return f"Scan it {times}: the mean of {worst} scans can decide. The engineer judges by it."
