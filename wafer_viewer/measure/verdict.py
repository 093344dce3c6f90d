"""Verdicts on measured quantities against limits, by the guard band of ISO 14253-1 or by simple acceptance."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence

from wafer_viewer.measure.base.measurement_context import LESS_WITH_REPEATS
from wafer_viewer.measure.registry import measured
from wafer_viewer.model.acquisition.sample import Alignment
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.job import GRAVEST, FeatureVerdict, Job, JudgedDie, WaferVerdict, Word
from wafer_viewer.model.measurement.feature import Die, Dies, Feature, on_die
from wafer_viewer.model.quantity import Quantity
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Mosaic

MOST_REPEATS = 25
"""Largest number of scans proposed to the operator; beyond it, the engineer decides."""


def judge_features(
    surface: Mosaic,
    features: Sequence[Feature],
    alignment: Alignment | None,
    *,
    calibration_valid: bool,
    dies: Dies | None = None,
) -> tuple[FeatureVerdict, ...]:
    """Measure and judge every feature that has a place; per-die features on each die.

    A feature that cannot be measured has no verdict, with the reason.
    """
    places = ((feature, die) for feature in features if feature.has_place for die in _dies_of(feature, dies))
    return tuple(judge_at(surface, feature, die, alignment, calibration_valid) for feature, die in places)


def not_judged(features: Sequence[Feature], dies: Dies | None) -> tuple[FeatureVerdict, ...]:
    """Return features that are measured nowhere, without a place or a die, each with the reason for no verdict."""
    lacking = ((feature, _lacks(feature, dies)) for feature in features)
    return tuple(FeatureVerdict(feature=feature, word="no verdict", why=why) for feature, why in lacking if why)


def _lacks(feature: Feature, dies: Dies | None) -> str:
    if not feature.has_place:
        return f"'{feature.name}' has no place to be measured at: give it one."
    if not any(True for _ in _dies_of(feature, dies)):
        return f"'{feature.name}' is measured on every die, and the job has none: name its dies."
    return ""


def judge_at(
    surface: Mosaic, feature: Feature, die: Die | None, alignment: Alignment | None, calibration_valid: bool
) -> FeatureVerdict:
    """Measure and judge one feature, on one die if it is repeated over dies."""
    name = die.name if die is not None else ""
    try:
        found = measured_feature(surface, feature, die, alignment, calibration_valid)
        quantity = quantity_of(found, feature)
    except MeasureError as fault:
        return FeatureVerdict(
            feature=feature, die=name, word="no verdict", why=f"'{feature.name}' was not measured. {fault}"
        )
    left_out: tuple[str, ...] = tuple(getattr(found, "not_evaluated", ()))
    return replace(judge(feature, quantity), die=name, not_evaluated=left_out)


def measured_feature(
    surface: Mosaic, feature: Feature, die: Die | None, alignment: Alignment | None, calibration_valid: bool
) -> AnyResult:
    """Measure a feature with its tool at its stage position. Raises MeasureError where there is no result."""
    on_wafer = feature.places if die is None else tuple(on_die(place, die) for place in feature.places)
    on_the_stage = tuple(on_stage(place, alignment) for place in on_wafer)
    return measured(surface, feature.tool, on_the_stage, calibration_valid, feature.options)


def quantity_of(found: AnyResult, feature: Feature) -> Quantity:
    """Return the quantity of a feature from a result. Raises MeasureError where it is missing or in another unit."""
    quantity = named_quantity(found, feature.quantity)
    if quantity.unit != feature.unit:
        raise MeasureError(
            f"It is in {quantity.unit} and the limits of '{feature.name}' are in {feature.unit}: correct the job."
        )
    return quantity


def named_quantity(found: AnyResult, name: str) -> Quantity:
    """Return a quantity of a result by field name, the main one by default. Raises MeasureError for others."""
    if not name:
        return found.main
    quantities = found.quantities
    if name not in quantities:
        raise MeasureError(f"Its result has no quantity '{name}': choose one of {', '.join(quantities)}.")
    return quantities[name]


def judge(feature: Feature, quantity: Quantity) -> FeatureVerdict:
    """Judge a quantity against the limits of its feature; an open limit is never exceeded.

    Guard band (ISO 14253-1): pass where all of value ± U lies within the limits, fail where all of it lies beyond one,
    else inconclusive. Simple acceptance: the value alone decides. Without an uncertainty neither gives a verdict.
    """
    if quantity.expanded is None:
        return FeatureVerdict(feature=feature, measured=quantity, word="no verdict", why=_no_uncertainty(quantity))
    half = quantity.expanded if feature.decision_rule == "guard_band" else 0.0
    low, high = quantity.value - half, quantity.value + half
    least, most = limits_of(feature)
    if least <= low and high <= most:
        return FeatureVerdict(feature=feature, measured=quantity, word="pass", why="Within the limits.")
    if high < least or low > most:
        beyond = "Under the lower limit." if high < least else "Over the upper limit."
        return FeatureVerdict(feature=feature, measured=quantity, word="fail", why=beyond)
    return FeatureVerdict(feature=feature, measured=quantity, word="inconclusive", why=_undecided(feature, quantity))


def limits_of(feature: Feature) -> tuple[float, float]:
    """Return lower and upper limit; infinite where open."""
    low, high = feature.lower_limit, feature.upper_limit
    return -math.inf if low is None else low, math.inf if high is None else high


def judge_dies(items: Sequence[FeatureVerdict], dies: Dies | None) -> tuple[JudgedDie, ...]:
    """Return the verdict of every judged die: the most serious one of its features."""
    of_die: dict[str, list[FeatureVerdict]] = defaultdict(list)
    for item in items:
        of_die[item.die].append(item)
    return tuple(
        JudgedDie(
            name=die.name,
            x_um=die.x_um,
            y_um=die.y_um,
            width_um=dies.width_um if dies else 0.0,
            height_um=dies.height_um if dies else 0.0,
            word=overall(of_die[die.name]),
        )
        for die in (dies.all() if dies else ())
        if die.name in of_die
    )


def overall(items: Sequence[FeatureVerdict]) -> Word:
    """Return the overall verdict: fail if any feature fails, pass if all pass, no verdict if nothing is judged."""
    words = {item.word for item in items}
    gravest: list[Word] = [word for word in GRAVEST if word in words]
    return gravest[0] if gravest else "no verdict"


def next_action(items: Sequence[FeatureVerdict]) -> str:
    """Return the operator's next action."""
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


def contradiction(verdict: WaferVerdict, job: Job) -> str | None:
    """Return the first thing that a stored verdict says against its own numbers or its job; None if there is none.

    Words follow from values, uncertainties and limits, so they are derived again: a value that was changed in the file
    keeps its old word.
    """
    for item in verdict.items:
        if item.feature not in job.features:
            return f"'{item.name}' has other limits or places than in the job"
        if item.measured is None:
            if item.word != "no verdict":
                return f"'{item.name}' is said to be {item.word}, and was not measured"
            continue
        if (fault := item.measured.contradiction) is not None:
            return f"'{item.name}': {fault}"
        if (word := judge(item.feature, item.measured).word) != item.word:
            return f"'{item.name}' is said to be {item.word}, and is {word} by its value and limits"
    judged = {(item.feature.name, item.die) for item in verdict.items}
    if missing := next((place for place in _expected(job) if place not in judged), None):
        return f"'{missing[0]}'{f' on die {missing[1]}' if missing[1] else ''} of the job was not judged"
    if verdict.word != overall(verdict.items):
        return f"the wafer is said to be {verdict.word}, and is {overall(verdict.items)} by its features"
    if {die.name: die.word for die in verdict.dies} != {
        die.name: die.word for die in judge_dies(verdict.items, job.dies)
    }:
        return "the words on its dies are not those of their features"
    return None


def _expected(job: Job) -> Iterator[tuple[str, str]]:
    """Yield feature name and die of everything that a verdict on a job names."""
    for feature in job.features:
        if _lacks(feature, job.dies):
            yield feature.name, ""
        else:
            yield from ((feature.name, die.name if die else "") for die in _dies_of(feature, job.dies))


def scans_needed(item: FeatureVerdict) -> int | None:
    """Return the number of scans, this one included, that would decide at the same mean; None if none would."""
    quantity = item.measured
    if quantity is None or not quantity.budget:
        return None
    repeats = quantity.k**2 * math.fsum(line.u**2 for line in quantity.budget if line.name in LESS_WITH_REPEATS)
    stays = quantity.k**2 * math.fsum(line.u**2 for line in quantity.budget if line.name not in LESS_WITH_REPEATS)
    room = _to_nearest_limit(item.feature, quantity) ** 2 - stays
    n = math.ceil(repeats / room) if room > 0 else math.inf
    return int(n) if n <= MOST_REPEATS else None


def on_stage(region: Region, alignment: Alignment | None) -> Region:
    """Transform a region from wafer to stage coordinates; a rotated rectangle becomes a polygon."""
    if alignment is None:
        return region
    if region.kind == "rectangle" and alignment.rotation_rad != 0:
        x0, y0, x1, y1 = region.bounds_um
        region = Region.polygon((x0, y0), (x1, y0), (x1, y1), (x0, y1)).without(*region.excluded)
    places = (alignment.to_stage(p.x_um, p.y_um) for p in region.points)
    holes = tuple(on_stage(hole, alignment) for hole in region.excluded)
    return replace(region, points=tuple(Point(x_um=x, y_um=y) for x, y in places), excluded=holes)


def _dies_of(feature: Feature, dies: Dies | None) -> Iterator[Die | None]:
    if not feature.per_die:
        yield None
    elif dies is not None:
        yield from dies.all()


def _no_uncertainty(quantity: Quantity) -> str:
    if quantity.status == "uncalibrated":
        return "Without a calibration that holds there is no uncertainty: calibrate, then measure again."
    return "The uncertainty could not be evaluated: ask the engineer for larger regions, or another quantity."


def _undecided(feature: Feature, quantity: Quantity) -> str:
    near, unit = _to_nearest_limit(feature, quantity), quantity.unit
    return f"{near:.2g} {unit} from the limit, with U = {quantity.expanded or 0.0:.2g} {unit}."


def _to_nearest_limit(feature: Feature, quantity: Quantity) -> float:
    return min(abs(quantity.value - limit) for limit in limits_of(feature))


def _after_inconclusive(items: Sequence[FeatureVerdict]) -> str:
    needed = [scans_needed(item) for item in items]
    worst = max((n for n in needed if n is not None), default=0)
    if None in needed or worst < 2:
        return (
            "Nearer to a limit than the uncertainty lets decide, and repeats would not help: "
            "calibrate the z scale again, or ask the engineer."
        )
    times = "once more" if worst == 2 else f"{worst - 1} times more"
    return f"Scan it {times}: the mean of {worst} scans can decide. The engineer judges by it."
