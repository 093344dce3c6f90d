"""What people should know of a placement, in sentences: who was left out and why, who is empty, who stands alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.poses import Poses
from wafer_viewer.model.surface import HeightMap
from wafer_viewer.reconstruct.misfits import has_no_heights, judge_misfit, loose, of_empty, of_loose

Open = Callable[[int], HeightMap]
NAMED = 8


def remarks(poses: Poses, pairs: NDArray[np.int32], opened: Open) -> tuple[str, ...]:
    """A sentence each; `opened` gives the height map of a field by its place in the list, asked for the odd ones only.

    pairs: all fields that overlap, int32 [n, 2].
    """
    return (*_left_out(poses, pairs, opened), *_loose(poses), *_empty(poses, opened), *_alone(poses, pairs))


def _left_out(poses: Poses, pairs: NDArray[np.int32], opened: Open) -> Iterator[str]:
    for place in np.flatnonzero(poses.left_out).tolist():
        beside = pairs[(pairs == place).any(axis=1)]
        others = [n for n in beside[beside != place].tolist() if not poses.left_out[n]]
        yield judge_misfit(int(poses.numbers[place]), opened(place), [opened(n) for n in others])


def _loose(poses: Poses) -> Iterator[str]:
    for place in loose(poses.numbers.size, poses.shifts).tolist():
        yield of_loose(int(poses.numbers[place]))


def _empty(poses: Poses, opened: Open) -> Iterator[str]:
    """Of fields whose heights could not be compared anywhere, those that have none."""
    compared = poses.seams.n_pixels > 0
    seen = np.zeros(poses.numbers.size, bool)
    seen[poses.seams.first[compared]] = seen[poses.seams.second[compared]] = True
    for place in np.flatnonzero(~seen & ~poses.left_out).tolist():
        if has_no_heights(opened(place)):
            yield of_empty(int(poses.numbers[place]))


def _alone(poses: Poses, pairs: NDArray[np.int32]) -> Iterator[str]:
    """Fields that no other overlaps, in one sentence; a single field is none to speak of."""
    alone = np.setdiff1d(np.arange(poses.numbers.size), pairs)
    if alone.size and poses.numbers.size > 1:
        one = alone.size == 1
        yield (
            f"{_listed(poses.numbers[alone].tolist())} {'overlaps' if one else 'overlap'} no other field: "
            f"{'it lies' if one else 'they lie'} where the stage says."
        )


def _listed(numbers: Sequence[int]) -> str:
    """``Field 3``, ``Fields 3, 4 and 7``, ``Fields 1, 2, 3, 4, 5, 6, 7, 8 and 40 more``."""
    if len(numbers) == 1:
        return f"Field {numbers[0]}"
    named, more = (numbers, 0) if len(numbers) <= NAMED else (numbers[:NAMED], len(numbers) - NAMED)
    *first, last = [str(n) for n in named] + ([f"{more} more"] if more else [])
    return f"Fields {', '.join(first)} and {last}"
