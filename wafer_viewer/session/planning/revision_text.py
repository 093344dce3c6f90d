"""Text of the differences between two revisions of a job, for features and for the recipe."""

from __future__ import annotations

from collections.abc import Iterator

from wafer_viewer.model.job.job import Job
from wafer_viewer.model.job.verdict import FeatureVerdict
from wafer_viewer.model.measurement.feature import DecisionRule, limits_text
from wafer_viewer.model.measurement.tool_options import ToolOptions
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.model.spec import Spec
from wafer_viewer.model.surface.recipe import Recipe

RULES: dict[DecisionRule, str] = {"guard_band": "guard band", "simple_acceptance": "simple acceptance"}
NOTHING_DIFFERS = "Nothing of the feature differs: it was measured again with today's calibration."


def added(judged_before: bool) -> str:
    """Return the reason for a new verdict."""
    return "The feature is new." if judged_before else "The wafer was not judged before."


def taken_off(then: FeatureVerdict, job: Job) -> str:
    """Return the reason for a missing verdict."""
    still = any(feature.name == then.feature.name for feature in job.features)
    return f"The job does not have die {then.die} any more." if still and then.die else "The feature is taken off."


def feature_changes(then: FeatureVerdict, now: FeatureVerdict, other_dies: bool) -> tuple[str, ...]:
    """Return the changes of a feature, one sentence each."""
    said = tuple(_of_feature(then, now, other_dies))
    return said or (() if then.measured == now.measured else (NOTHING_DIFFERS,))


def recipe_changes(made_by: Recipe, wanted: Recipe) -> tuple[str, ...]:
    """Return the recipe settings that differ from those a surface was made with; ``auto`` matches any value."""
    return tuple(f"Recipe: {words}." for words in _settings(made_by, wanted, ""))


def _of_feature(then: FeatureVerdict, now: FeatureVerdict, other_dies: bool) -> Iterator[str]:
    old, new = then.feature, now.feature
    if (old.lower_limit, old.upper_limit, old.unit) != (new.lower_limit, new.upper_limit, new.unit):
        yield f"Limits: {limits_text(old)} before, {limits_text(new)} now."
    if old.decision_rule != new.decision_rule:
        yield f"Decision rule: {RULES[old.decision_rule]} before, {RULES[new.decision_rule]} now."
    if old.tool != new.tool:
        yield f"Tool: {TOOLS[old.tool].title} before, {TOOLS[new.tool].title} now."
    if old.quantity != new.quantity:
        yield f"Quantity: {old.quantity or 'the main one'} before, {new.quantity or 'the main one'} now."
    if (old.places, old.per_die) != (new.places, new.per_die) or (now.die and other_dies):
        yield "Place: another one; measured again."
    if old.tool == new.tool and (old.options or ToolOptions()) != (new.options or ToolOptions()):
        yield from (f"Option: {words}." for words in _settings(_own(old), _own(new), ""))


def _own(feature: object) -> Spec:
    options = getattr(feature, "options", None) or ToolOptions()
    return getattr(options, getattr(feature, "tool", ""), options)


def _settings(old: Spec, new: Spec, before: str) -> Iterator[str]:
    for name in new.__struct_fields__:
        was, now = getattr(old, name, None), getattr(new, name)
        words = f"{before}{name.replace('_', ' ')}"
        if isinstance(was, Spec) and isinstance(now, Spec):
            yield from _settings(was, now, f"{words}, ")
        elif was != now and "auto" not in (was, now):
            yield f"{words} {_value(was)} before, {_value(now)} now"


def _value(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else "nothing" if value is None else f"{value}".replace("_", " ")
