"""Rule-based classification of defects by shape, with reasons.

The rules are evaluated in the order of `RULES`; the first with all conditions met gives the class. A condition is a
number above or below a limit of `ClassRules`. The conditions met are the reasons, and their distances from the limits
give the confidence.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from wafer_viewer.model.inspection.defect_classes import RULES, ClassRules, Condition, DefectClass, DefectShape

_LEAST_PX = 6.0
"""Length in pixels below which the shape is poorly resolved and the confidence is reduced."""


@dataclass(frozen=True, slots=True)
class Classified:
    """A class, its reasons and its confidence, 0 to 1: 0.5 where a number is at its limit."""

    kind: DefectClass
    reasons: tuple[str, ...]
    confidence: float


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


def _bump(shape: DefectShape) -> Iterator[str]:
    """Yield the reasons of a particle or bump."""
    yield f"{shape.height_um:.3g} um high"
    yield f"{shape.ratio:.1f} times as long as wide"
