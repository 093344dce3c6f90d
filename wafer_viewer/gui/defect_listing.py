"""How one browser lists the defects: in which order, of which class, of which die. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Literal

from wafer_viewer.model.defects import Defect

DefectSort = Literal["size", "height", "score", "die", "class"]


@dataclass(frozen=True, slots=True)
class DefectListing:
    """sort: what comes first; kind, die: of which alone, empty for all."""

    sort: DefectSort = "size"
    kind: str = ""
    die: str = ""


def _die(defect: Defect) -> tuple[tuple[int, ...], int]:
    """By rows of dies from the top, those outside of dies last."""
    parts = tuple(map(int, defect.die.split(","))) if defect.die else ()
    return ((0, -parts[1], parts[0]) if parts else (1,)), defect.number


SORTS: dict[DefectSort, tuple[str, Callable[[Defect], Any]]] = {
    "size": ("Size", lambda defect: (-defect.major.value_um, defect.number)),
    "height": ("Height", lambda defect: (-abs(defect.height.value_um), defect.number)),
    "score": ("Score", lambda defect: (-defect.score, defect.number)),
    "die": ("Die", _die),
    "class": ("Class", lambda defect: (defect.seen_as, -defect.major.value_um, defect.number)),
}
"""By name: what the page calls it, and the key that the lowest of comes first."""


def listed(defects: Iterable[Defect], listing: DefectListing) -> tuple[Defect, ...]:
    """The defects in their order; areas without heights, which are no defects, last."""
    kept = (d for d in defects if listing.kind in ("", d.seen_as) and listing.die in ("", d.die))
    order = SORTS[listing.sort][1]
    return tuple(sorted(kept, key=lambda defect: (defect.seen_as == "unmeasured", order(defect))))
