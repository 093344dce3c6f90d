"""User-facing notes on a stitching result: excluded, empty and isolated fields, with reasons."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.field_poses import DOUBT_WORDS, Poses, RejectionReason, Shifts
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.reconstruct.registration.misplaced_fields import (
    empty_field_note,
    has_no_heights,
    judge_misfit,
    placed_by_stage,
    unverifiable_field_note,
    unverifiable_fields,
)

Open = Callable[[int], HeightMap]
NAMED = 8
BY_STAGE_ALONE = "Stitched by the stage's positions alone"


def stitching_notes(poses: Poses, pairs: NDArray[np.int32], opened: Open) -> tuple[str, ...]:
    """Return one sentence per note; `opened` opens a height map by index and is called for odd fields only.

    pairs: all fields that overlap, int32 [n, 2].
    """
    empty = list(_empty(poses, opened))
    sentences = [empty_field_note(int(poses.numbers[place])) for place in empty]
    return (
        *_by_stage(poses, empty),
        *_left_out(poses, pairs, opened),
        *_loose(poses),
        *sentences,
        *_alone(poses, pairs),
    )


def _by_stage(poses: Poses, empty: Sequence[int]) -> Iterator[str]:
    """Note the overlapping fields placed by the stage alone, except those noted for another reason."""
    by_stage = placed_by_stage(poses)
    if not by_stage.any():
        return
    shifts, numbers = poses.shifts, poses.numbers
    if not (shifts.believed & ~poses.left_out[shifts.first] & ~poses.left_out[shifts.second]).any():
        yield f"{BY_STAGE_ALONE}: {_undecided(shifts, np.ones(shifts.first.size, bool))}.{_pattern_advice(shifts)}"
        return
    named = np.isin(np.arange(numbers.size), [*empty, *unverifiable_fields(numbers.size, shifts).tolist()])
    hanging = by_stage & ~named
    across = by_stage[shifts.first] != by_stage[shifts.second]
    inside = hanging[shifts.first] | hanging[shifts.second]
    if hanging.any() and inside.any():
        rest = across & inside if (across & inside).any() else inside
        one = np.count_nonzero(hanging) == 1
        yield (
            f"{_listed(numbers[hanging].tolist())} {'is' if one else 'are'} placed by the stage alone: "
            f"{_undecided(shifts, rest & ~shifts.believed)}.{_pattern_advice(shifts)}"
        )


def _undecided(shifts: Shifts, some: NDArray[np.bool_]) -> str:
    """Return ``24 of 24 overlaps ambiguous (repeating pattern)``, the most frequent reason first."""
    of = int(np.count_nonzero(some))
    counts = [(int(np.count_nonzero(shifts.doubt[some] == doubt)), words) for doubt, words in DOUBT_WORDS.items()]
    first, *others = sorted((c for c in counts if c[0]), key=lambda count: -count[0])
    return ", ".join([f"{first[0]} of {of} overlaps {first[1]}", *(f"{n} {words}" for n, words in others)])


def _pattern_advice(shifts: Shifts) -> str:
    """Return advice for repeating patterns, or an empty string."""
    if not (shifts.doubt == RejectionReason.AMBIGUOUS).any():
        return ""
    return " If the stage is more accurate than half the pattern's pitch, set search_um to less than that."


def _left_out(poses: Poses, pairs: NDArray[np.int32], opened: Open) -> Iterator[str]:
    for place in np.flatnonzero(poses.left_out).tolist():
        beside = pairs[(pairs == place).any(axis=1)]
        others = [n for n in beside[beside != place].tolist() if not poses.left_out[n]]
        yield judge_misfit(int(poses.numbers[place]), opened(place), [opened(n) for n in others])


def _loose(poses: Poses) -> Iterator[str]:
    for place in unverifiable_fields(poses.numbers.size, poses.shifts).tolist():
        yield unverifiable_field_note(int(poses.numbers[place]))


def _empty(poses: Poses, opened: Open) -> Iterator[int]:
    """Yield the indices of fields without heights, among those whose heights could not be compared anywhere."""
    compared = poses.seams.n_pixels > 0
    seen = np.zeros(poses.numbers.size, bool)
    seen[poses.seams.first[compared]] = seen[poses.seams.second[compared]] = True
    for place in np.flatnonzero(~seen & ~poses.left_out).tolist():
        if has_no_heights(opened(place)):
            yield place


def _alone(poses: Poses, pairs: NDArray[np.int32]) -> Iterator[str]:
    """Note the fields without overlap, in one sentence; nothing for a single field."""
    alone = np.setdiff1d(np.arange(poses.numbers.size), pairs)
    if alone.size and poses.numbers.size > 1:
        one = alone.size == 1
        yield (
            f"{_listed(poses.numbers[alone].tolist())} {'overlaps' if one else 'overlap'} no other field: "
            f"{'it lies' if one else 'they lie'} where the stage says."
        )


def _listed(numbers: Sequence[int]) -> str:
    """Return ``Field 3``, ``Fields 3, 4 and 7``, or ``Fields 1, 2, 3, 4, 5, 6, 7, 8 and 40 more``."""
    if len(numbers) == 1:
        return f"Field {numbers[0]}"
    named, more = (numbers, 0) if len(numbers) <= NAMED else (numbers[:NAMED], len(numbers) - NAMED)
    *first, last = [str(n) for n in named] + ([f"{more} more"] if more else [])
    return f"Fields {', '.join(first)} and {last}"
