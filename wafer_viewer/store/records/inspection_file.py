"""``defects.json``: inspection of a surface and the review of its defects, in the folder of the result."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from wafer_viewer.model.inspection.defect import Defect, Inspection
from wafer_viewer.model.spec import replace
from wafer_viewer.store.io.atomic_files import os_errors_as_dataset_errors
from wafer_viewer.store.io.checksums import load_json, save_json

DEFECTS = "defects.json"
WORDS = ("judgement", "judged_kind", "note", "judged_by", "judged_at")
"""Fields of a defect set by reviewers; all others are measured."""


def read_inspection(result: Path) -> Inspection | None:
    """Read the inspection of a result; None if there is none. Raises DatasetError when it is unreadable."""
    path = result / DEFECTS
    return load_json(path, Inspection) if path.exists() else None


def write_inspection(result: Path, inspection: Inspection) -> None:
    """Save an inspection atomically, replacing an earlier one."""
    with os_errors_as_dataset_errors(result):
        result.mkdir(parents=True, exist_ok=True)
    save_json(result / DEFECTS, inspection)


def carry_over(before: Inspection, after: Inspection) -> Inspection:
    """Return `after` with the review data of matching defects in `before`; its notes list unmatched judged ones.

    Two defects match if their centres are no further apart than half the length of the longer one; the nearest pairs
    are matched first, each defect once.
    """
    judged = [defect for defect in before.defects if is_judged(defect)]
    pairs = _pairs(judged, after.defects)
    said = {new: _words(judged[old]) for old, new in pairs}
    kept = tuple(replace(defect, **said.get(n, {})) for n, defect in enumerate(after.defects))
    gone = sorted(judged[k].number for k in set(range(len(judged))) - {old for old, _ in pairs})
    return replace(after, defects=kept, notes=(*after.notes, *_unmatched_note(gone)))


def is_judged(defect: Defect) -> bool:
    """Return whether a reviewer judged, classified or commented on a defect."""
    return defect.judgement != "open" or defect.judged_kind is not None or bool(defect.note)


def _words(defect: Defect) -> dict[str, str | None]:
    return {name: getattr(defect, name) for name in WORDS}


def _pairs(old: list[Defect], new: tuple[Defect, ...]) -> list[tuple[int, int]]:
    """Return index pairs of matching old and new defects, nearest first and each once."""
    near = sorted((distance, i, j) for i, a in enumerate(old) for distance, j in _within_reach(a, new))
    taken_old: set[int] = set()
    taken_new: set[int] = set()
    pairs: list[tuple[int, int]] = []
    for _, i, j in near:
        if i not in taken_old and j not in taken_new:
            pairs.append((i, j))
            taken_old.add(i)
            taken_new.add(j)
    return pairs


def _within_reach(a: Defect, others: tuple[Defect, ...]) -> list[tuple[float, int]]:
    """Return (distance, index) of the candidates for a match."""
    x, y = (np.array([getattr(b.center, axis) for b in others]) for axis in ("x_um", "y_um"))
    reach_um = np.maximum([b.major.value_um for b in others], a.major.value_um) / 2
    distance_um = np.hypot(x - a.center.x_um, y - a.center.y_um)
    return [(float(distance_um[j]), int(j)) for j in np.flatnonzero(distance_um <= reach_um)]


def _unmatched_note(numbers: Iterable[int]) -> tuple[str, ...]:
    listed = ", ".join(str(number) for number in numbers)
    return (f"Judged before and not found this time: {listed} of the inspection before.",) if listed else ()
