"""Rule-based classification of defects by shape, with reasons.

The rules are evaluated in the order of RULES; the first with all conditions met gives the class. A condition is a
number above or below a limit of `ClassRules`. The conditions met are the reasons, and their distances from the limits
give the confidence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from wafer_viewer.model.inspection.defect import ClassRules, DefectClass, DefectShape

_LEAST_PX = 6.0
"""Length in pixels below which the shape is poorly resolved and the confidence is reduced."""


@dataclass(frozen=True, slots=True)
class Classified:
    """A class, its reasons and its confidence, 0 to 1: 0.5 where a number is at its limit."""

    kind: DefectClass
    reasons: tuple[str, ...]
    confidence: float


@dataclass(frozen=True, slots=True)
class Condition:
    """A number compared with its limit; `text` is the reason reported when it holds."""

    text: str
    value: float
    limit: float
    over: bool = True

    @property
    def holds(self) -> bool:
        """True if the number is on the required side of its limit."""
        return self.value > self.limit if self.over else self.value <= self.limit

    @property
    def margin(self) -> float:
        """Distance from the limit as the absolute log ratio, 0 at the limit; infinite where one of them is 0."""
        if self.value <= 0 or self.limit <= 0:
            return math.inf if self.value != self.limit else 0.0
        return abs(math.log(self.value / self.limit))


Rule = Callable[[DefectShape, ClassRules], tuple[Condition, ...]]


def classify(shape: DefectShape, rules: ClassRules | None = None) -> Classified:
    """Return the class of a defect of this shape; default rules: the standard ones."""
    limits = rules or ClassRules()
    closest = math.inf
    for kind, rule in RULES.items():
        conditions = rule(shape, limits)
        if all(condition.holds for condition in conditions):
            closest = min([closest, *(condition.margin for condition in conditions)])
            return Classified(kind, tuple(condition.text for condition in conditions), _confidence(closest, shape))
        closest = min(closest, _least_missed(conditions))
    return Classified("particle", tuple(_bump(shape)), _confidence(closest, shape))


def _least_missed(conditions: tuple[Condition, ...]) -> float:
    """Return the largest margin among the conditions of a failed rule that do not hold."""
    return max(condition.margin for condition in conditions if not condition.holds)


def _confidence(margin: float, shape: DefectShape) -> float:
    """Return the confidence: 0.5 at a limit, near 1 from twice the limit; lower for few pixels."""
    resolved = min(1.0, max(shape.major_um, shape.pixel_um) / (_LEAST_PX * shape.pixel_um))
    return round((1 - 0.5 * math.exp(-3 * margin)) * (0.5 + 0.5 * resolved), 3)


def _unmeasured(shape: DefectShape, rules: ClassRules) -> tuple[Condition, ...]:
    share = shape.unmeasured_fraction
    return (Condition(f"{share:.0%} of it unmeasured", share, rules.unmeasured_fraction),)


def _missing_die(shape: DefectShape, rules: ClassRules) -> tuple[Condition, ...]:
    down_um = max(-shape.mean_height_um or -shape.height_um, 0.0)
    return (
        _of_die(shape, rules),
        Condition(f"the die lies {down_um:.3g} um under the others", down_um, rules.missing_height_um),
    )


def _tilted_die(shape: DefectShape, rules: ClassRules) -> tuple[Condition, ...]:
    tilt = shape.die_tilt_mrad
    return _of_die(shape, rules), Condition(f"the die is tilted by {tilt:.3g} mrad", tilt, rules.tilt_mrad)


def _of_die(shape: DefectShape, rules: ClassRules) -> Condition:
    return Condition(f"covers {shape.die_fraction:.0%} of its die", shape.die_fraction, rules.die_fraction)


def _pattern(shape: DefectShape, rules: ClassRules) -> tuple[Condition, ...]:
    in_heights = f"{shape.height_score:.2g} times the noise of the heights"
    return (
        Condition("shows in the picture only", float(shape.evidence == "picture"), 0.5),
        Condition(in_heights, shape.height_score, rules.pattern_height_score, over=False),
    )


def _edge_chip(shape: DefectShape, rules: ClassRules) -> tuple[Condition, ...]:
    share = shape.on_edge_fraction
    return _gone(shape), Condition(f"{share:.0%} of its border on the edge of a die", share, rules.edge_fraction)


def _scratch(shape: DefectShape, rules: ClassRules) -> tuple[Condition, ...]:
    return (
        Condition(f"{shape.ratio:.1f} times as long as wide", shape.ratio, rules.scratch_ratio),
        Condition(f"{shape.major_um:.3g} um long", shape.major_um, rules.scratch_length_um),
    )


def _pit(shape: DefectShape, rules: ClassRules) -> tuple[Condition, ...]:
    return (_lacks(shape),)


def _residue(shape: DefectShape, rules: ClassRules) -> tuple[Condition, ...]:
    width_um, aspect = shape.minor_um, shape.aspect
    smooth = f"smooth: {shape.roughness_ratio:.2g} times the noise"
    sharp = shape.detail_score / shape.height_score if shape.height_score else 0.0
    gentle = f"no steep rim: {shape.steepness:.2g} times its mean slope" if shape.steepness else "no rim known"
    return (
        Condition(f"{shape.height_um:.3g} um high", shape.height_um, 0.0),
        Condition(f"{width_um:.3g} um wide", width_um, rules.residue_width_um),
        Condition(f"low: {aspect:.2g} of its width high", aspect, rules.residue_aspect, over=False),
        Condition(smooth, shape.roughness_ratio, rules.residue_roughness, over=False),
        Condition(gentle, shape.steepness, rules.residue_steepness, over=False),
        Condition(f"not sharp in the picture: {sharp:.2g} times the heights", sharp, rules.residue_picture, over=False),
    )


def _lacks(shape: DefectShape) -> Condition:
    return Condition(f"{-shape.height_um:.3g} um deep", -shape.height_um, 0.0)


def _gone(shape: DefectShape) -> Condition:
    """Return the condition for missing material: lower, or without heights, as at a missing wall."""
    return _lacks(shape) if shape.height_um else Condition("no height was measured here", 1.0, 0.0)


def _bump(shape: DefectShape) -> Iterator[str]:
    """Yield the reasons of a particle or bump."""
    yield f"{shape.height_um:.3g} um high"
    yield f"{shape.ratio:.1f} times as long as wide"


RULES: dict[DefectClass, Rule] = {
    "unmeasured": _unmeasured,
    "tilted die": _tilted_die,
    "missing die": _missing_die,
    "edge chip": _edge_chip,
    "residue": _residue,
    "scratch": _scratch,
    "pattern": _pattern,
    "pit": _pit,
}
"""Rules in order of evaluation; defects that match none are a particle or bump."""
