"""What an inspection made of one wafer with planted defects, as plain numbers that a file can keep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tests.truth.defects import Made
from tests.truth.matching import match
from tests.truth.planted import Planted
from wafer_viewer.model.inspection.defect import Defect, Inspection


@dataclass(frozen=True)
class Hit:
    """A planted defect, and what was found of it; found_kind is empty of a missed one."""

    kind: str
    diameter_px: int
    height_sigma: int
    x_um: float
    y_um: float
    height_um: float
    length_um: float
    found: bool = False
    found_kind: str = ""
    found_height_um: float = 0.0
    found_length_um: float = 0.0
    u_height_um: float | None = None
    u_length_um: float | None = None
    size_resolved: bool = False
    score: float = 0.0


@dataclass(frozen=True)
class Wafer:
    """One wafer; false: (x_um, y_um, score) of what was found where nothing was planted."""

    seed: int
    area_mm2: float
    unmeasured: float
    sigma_um: float
    seconds: float
    hits: tuple[Hit, ...]
    false: tuple[tuple[float, float, float], ...]
    parts: int
    expected_false_per_mm2: float | None

    @classmethod
    def read(cls, kept: dict[str, Any]) -> Wafer:
        """From a line of the file."""
        hits = tuple(Hit(**hit) for hit in kept["hits"])
        return cls(**{**kept, "hits": hits, "false": tuple(map(tuple, kept["false"]))})


def recorded(made: Made, found: Inspection, seconds: float) -> Wafer:
    """An inspection held against what was planted."""
    matched = match(made.planted, found.found)
    hits = [_hit(one, other) for one, other in matched.pairs] + [_hit(one, None) for one in matched.missed]
    return Wafer(
        seed=made.plan.seed,
        area_mm2=found.inspected_mm2,
        unmeasured=made.unmeasured,
        sigma_um=made.sigma_um,
        seconds=seconds,
        hits=tuple(hits),
        false=tuple((d.center.x_um, d.center.y_um, d.score) for d in matched.false),
        parts=len(matched.parts),
        expected_false_per_mm2=found.expected_false_per_mm2,
    )


def _hit(one: Planted, found: Defect | None) -> Hit:
    planted = Hit(one.kind, one.diameter_px, one.height_sigma, one.x_um, one.y_um, one.height_um, one.length_um)
    if found is None:
        return planted
    return Hit(
        *(getattr(planted, name) for name in Hit.__dataclass_fields__ if name in _PLANTED),
        found=True,
        found_kind=found.kind,
        found_height_um=found.height.value_um,
        found_length_um=found.major.value_um,
        u_height_um=found.height.expanded_um,
        u_length_um=found.major.expanded_um,
        size_resolved=found.size_resolved,
        score=found.score,
    )


_PLANTED = ("kind", "diameter_px", "height_sigma", "x_um", "y_um", "height_um", "length_um")
