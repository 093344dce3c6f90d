"""Sorting and filtering of the defect list in one browser. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, Literal

from wafer_viewer.model.inspection.defect import Defect

DefectSort = Literal["size", "height", "score", "die", "class"]
MapBy = Literal["class", "count"]


@dataclass(frozen=True, slots=True)
class DefectListing:
    """Sort order and filters of the defect list.

    sort: key of the order.
    kind, die: filters by class and by die; empty for all.
    map_by: quantity that colours the dies of the map.
    numbers: filter by defect numbers, those at one position that repeats from die to die; empty for all.
    """

    sort: DefectSort = "size"
    kind: str = ""
    die: str = ""
    map_by: MapBy = "class"
    numbers: tuple[int, ...] = ()

    @property
    def narrowed(self) -> bool:
        """True if a filter is active."""
        return self.widened != self

    @property
    def widened(self) -> DefectListing:
        """The same list without filters."""
        return replace(self, kind="", die="", numbers=())


def _rank(die: str) -> tuple[int, ...]:
    """Return the sort key of a die: by rows from the top, positions outside of dies last."""
    parts = tuple(map(int, die.split(","))) if die else ()
    return (0, -parts[1], parts[0]) if parts else (1,)


def _die(defect: Defect) -> tuple[tuple[int, ...], int]:
    return _rank(defect.die), defect.number


SORTS: dict[DefectSort, tuple[str, Callable[[Defect], Any]]] = {
    "size": ("Size", lambda defect: (-defect.major.value_um, defect.number)),
    "height": ("Height", lambda defect: (-abs(defect.height.value_um), defect.number)),
    "score": ("Score", lambda defect: (-defect.score, defect.number)),
    "die": ("Die", _die),
    "class": ("Class", lambda defect: (defect.seen_as, -defect.major.value_um, defect.number)),
}
"""Title on the page and ascending sort key, by name."""


def listed(defects: Iterable[Defect], listing: DefectListing) -> tuple[Defect, ...]:
    """Return the filtered defects in order; unmeasured areas, which are not defects, last."""
    kept = (d for d in defects if listing.kind in ("", d.seen_as) and listing.die in ("", d.die))
    kept = (d for d in kept if not listing.numbers or d.number in listing.numbers)
    order = SORTS[listing.sort][1]
    return tuple(sorted(kept, key=lambda defect: (defect.seen_as == "unmeasured", order(defect))))


def next_die(defects: Iterable[Defect], listing: DefectListing, by: int) -> str | None:
    """Return the next or previous die with open defects, by rows from the top; None if there is none."""
    there = {d.die for d in defects if d.die and d.judgement == "open" and listing.kind in ("", d.seen_as)}
    if not there:
        return None
    order = sorted({*there, listing.die} - {""}, key=_rank)
    ahead = order if by > 0 else order[::-1]
    at = ahead.index(listing.die) + 1 if listing.die else 0
    return next(die for die in (*ahead[at:], *ahead[:at]) if die in there)


def next_kind(defects: Iterable[Defect], listing: DefectListing) -> str:
    """Return the next class, the most frequent first; after the last one the empty string for all classes."""
    kinds = ["", *(kind for kind, _ in Counter(defect.seen_as for defect in defects).most_common())]
    return kinds[(kinds.index(listing.kind) + 1) % len(kinds)] if listing.kind in kinds else ""
