"""Misplaced fields that fit none of their neighbours, and the notes of a stitching result."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.field_poses import DOUBT_WORDS, Poses, RejectionReason, Shifts
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.reconstruct.registration.pair_registration import REACH_PX, register_pair

LEAST_NEIGHBOURS = 2
"""A single mismatch may be the neighbour's fault; two neighbours that fit other fields are conclusive."""

FEWER = 2
"""A group is rejected only if the leading group is at least this many times as large."""

_LOST = (RejectionReason.UNLIKE, RejectionReason.END_OF_SEARCH)
_FITS = (RejectionReason.NONE, RejectionReason.DISAGREES)
_EVERY = 16
"""Stride of the sparse sample of a field, in pixels."""

Layer = NDArray[np.generic]
Turn = Callable[[Layer], Layer]

TURNS: dict[str, Turn] = {
    "turned by half a turn": lambda layer: np.rot90(layer, 2),
    "mirrored left to right": np.fliplr,
    "mirrored top to bottom": np.flipud,
    "turned by 90 degrees clockwise": np.rot90,
    "turned by 90 degrees anticlockwise": lambda layer: np.rot90(layer, -1),
    "mirrored and turned by 90 degrees clockwise": lambda layer: np.rot90(np.fliplr(layer), -1),
    "mirrored and turned by 90 degrees anticlockwise": lambda layer: np.rot90(np.fliplr(layer)),
}
"""Possible wrong orientations of a field, with the transformation that corrects each."""


def misplaced_fields(n_fields: int, shifts: Shifts) -> NDArray[np.int32]:
    """Return the indices of the fields to exclude: with content, but inconsistent with consistent neighbours.

    Fields with matching overlaps form groups. Of each connected set of compared fields, the largest group is accepted.
    Another group, at most half as large, is excluded when at least two of its overlaps with that group, and more than
    are ambiguous, should match and none does.
    """
    lost = _lost_overlaps(n_fields, shifts)
    return np.flatnonzero(lost >= LEAST_NEIGHBOURS).astype(np.int32)


def unverifiable_fields(n_fields: int, shifts: Shifts) -> NDArray[np.int32]:
    """Return the inconsistent fields with too few neighbours to decide which one is wrong; they stay in place."""
    lost = _lost_overlaps(n_fields, shifts)
    return np.flatnonzero((lost > 0) & (lost < LEAST_NEIGHBOURS)).astype(np.int32)


def placed_by_stage(poses: Poses) -> NDArray[np.bool_]:
    """Return a mask, bool [n], of fields that overlap others but are placed by the stage alone.

    Fields joined by accepted overlaps form groups. Of each connected set of overlapping fields, the largest group of
    two or more is placed by its overlaps; every other field depends on the stage alone. Excluded fields do not count.
    """
    n_fields, shifts = poses.numbers.size, poses.shifts
    between = ~(poses.left_out[shifts.first] | poses.left_out[shifts.second])
    group, component = (_joined(n_fields, shifts, some) for some in (between & shifts.believed, between))
    size, component_size = (np.bincount(numbers, minlength=n_fields) for numbers in (group, component))
    largest = np.lexsort((np.arange(n_fields), -size[group], component))
    _, first = np.unique(component[largest], return_index=True)
    leading = group[largest[first]]
    held = (group == leading[component]) & (size[group] > 1)
    return ~held & (component_size[component] > 1) & ~poses.left_out


def has_no_heights(height: HeightMap) -> bool:
    """Return whether a field has no measured height; it is read completely only if a sparse sample is empty."""
    some = np.isfinite(height.z_raw_um[::_EVERY, ::_EVERY]).any()
    return not (some or np.isfinite(height.z_raw_um).any())


def empty_field_note(number: int) -> str:
    """Return the note for a field without heights."""
    return f"Field {number} has no height at all: it adds nothing to the surface; look at its images and scan it again."


def unverifiable_field_note(number: int) -> str:
    """Return the note for a field that does not match its only informative neighbour."""
    return (
        f"Field {number} does not fit its neighbour, and no other overlap tells which of them is wrong: it stays where "
        "the stage says; scan both again if the seam shows."
    )


def turned_field_note(number: int, how: str) -> str:
    """Return the note for an excluded field in a wrong orientation, a key of `TURNS`."""
    return f"Field {number} is {how} and was left out: put its images the right way round and reconstruct it again."


def swapped_fields_note(number: int, other: int) -> str:
    """Return the note for two excluded fields of which each fits in the place of the other."""
    return (
        f"Fields {number} and {other} are swapped and were left out: give each the images of the other and reconstruct "
        "them again."
    )


def judge_misfit(number: int, height: HeightMap, neighbours: Sequence[HeightMap]) -> str:
    """Return the note for an excluded field, after matching it rotated and mirrored against its neighbours."""
    fits = {how: _fits(reoriented(height, turn), neighbours) for how, turn in TURNS.items()}
    how = max(fits, key=lambda name: fits[name])
    if fits[how] * 2 >= max(1, len(neighbours)):
        return turned_field_note(number, how)
    return (
        f"Field {number} fits {_none_of(len(neighbours))} and was left out: it belongs to another sample or lies "
        "elsewhere; scan it again."
    )


def _none_of(n_neighbours: int) -> str:
    return "not its one neighbour" if n_neighbours == 1 else f"none of its {n_neighbours} neighbours"


def reoriented(height: HeightMap, turn: Turn) -> HeightMap:
    """Return a field rotated or mirrored about its centre."""
    rows, cols = height.shape
    z_um, z_raw_um, confidence, all_in_focus, origin = (
        turn(layer) for layer in (height.z_um, height.z_raw_um, height.confidence, height.all_in_focus, height.origin)
    )
    wider, taller = (z_um.shape[1] - cols) / 2, (z_um.shape[0] - rows) / 2
    return dataclasses.replace(
        height,
        z_um=z_um,
        z_raw_um=z_raw_um,
        confidence=confidence,
        all_in_focus=all_in_focus,
        origin=origin,
        u_um=None if height.u_um is None else turn(height.u_um),
        x0_um=height.x0_um - wider * height.pixel_um,
        y0_um=height.y0_um + taller * height.pixel_um,
    )


def _fits(height: HeightMap, neighbours: Sequence[HeightMap]) -> int:
    return sum(register_pair(height, other, REACH_PX).doubt is RejectionReason.NONE for other in neighbours)


def _lost_overlaps(n_fields: int, shifts: Shifts) -> NDArray[np.intp]:
    """Return the number of mismatched overlaps between each field's group and the accepted one, int [n].

    0 for the fields of accepted groups, and for groups with at least as many ambiguous overlaps.
    """
    fits, lost, open_ = (np.isin(shifts.doubt, some) for some in (_FITS, _LOST, (RejectionReason.AMBIGUOUS,)))
    group, component = _joined(n_fields, shifts, fits), _joined(n_fields, shifts, fits | lost | open_)
    size = np.bincount(group, minlength=n_fields)
    largest = np.lexsort((np.arange(n_fields), -size[group], component))
    _, first = np.unique(component[largest], return_index=True)
    leading = group[largest[first]]
    believed = np.isin(group, leading[size[leading] > 1])
    n_lost, n_open = (_of_groups(shifts, some, group, believed) for some in (lost, open_))
    nearly_as_large = FEWER * size[group] > size[leading][component]
    n_lost = np.where(nearly_as_large, np.minimum(n_lost, LEAST_NEIGHBOURS - 1), n_lost)
    return np.where(believed | (n_lost <= n_open), 0, n_lost)


def _of_groups(
    shifts: Shifts, some: NDArray[np.bool_], group: NDArray[np.intp], believed: NDArray[np.bool_]
) -> NDArray[np.intp]:
    """Return the number of selected overlaps between each field's group and an accepted one, int [n]."""
    a, b = shifts.first[some], shifts.second[some]
    outside = np.concatenate([a[believed[b] & ~believed[a]], b[believed[a] & ~believed[b]]])
    return np.bincount(group[outside], minlength=len(group))[group]


def _joined(n_fields: int, shifts: Shifts, used: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the group number of each field, for groups connected by the selected overlaps."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = (np.ones(int(used.sum()), np.int8), (shifts.first[used], shifts.second[used]))
    return np.asarray(connected_components(coo_array(links, (n_fields, n_fields)), directed=False)[1], np.intp)


Open = Callable[[int], HeightMap]
STAGE_AT_LEAST_UM = 0.5
"""Uncertainty along an axis up to which an overlap places its fields in any case."""
NAMED = 8
"""Largest number of fields that a note lists."""
BY_STAGE_ALONE = "Stitched by the stage's positions alone"


def stitching_notes(
    poses: Poses,
    pairs: NDArray[np.int32],
    opened: Open,
    misfits: Sequence[str] = (),
    noted: Sequence[int] = (),
    *,
    stage_known: bool = False,
) -> tuple[str, ...]:
    """Return one sentence per note; `opened` opens a height map by index and is called for odd fields only.

    pairs: all fields that overlap, int32 [n, 2]; misfits: sentences on excluded fields whose indices are `noted`;
    stage_known: whether fields without overlaps are placed with the errors of the stage at the others.
    """
    empty = list(_empty(poses, opened))
    sentences = [empty_field_note(int(poses.numbers[place])) for place in empty]
    return (
        *_by_stage(poses, empty, ", less its errors at the fields around" if stage_known else ""),
        *_patterned(poses),
        *_along_lines(poses),
        *misfits,
        *_left_out(poses, pairs, opened, noted),
        *_loose(poses),
        *sentences,
        *_alone(poses, pairs),
    )


def _by_stage(poses: Poses, empty: Sequence[int], how: str) -> Iterator[str]:
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
            f"{_listed(numbers[hanging].tolist())} {'is' if one else 'are'} placed by the stage alone"
            f"{how}: {_undecided(shifts, rest & ~shifts.believed)}.{_pattern_advice(shifts)}"
        )


def _undecided(shifts: Shifts, some: NDArray[np.bool_]) -> str:
    """Return ``24 of 24 overlaps ambiguous (repeating pattern)``, the most frequent reason first."""
    n_open = int(np.count_nonzero(some))
    counts = [(int(np.count_nonzero(shifts.doubt[some] == doubt)), words) for doubt, words in DOUBT_WORDS.items()]
    first, *others = sorted((c for c in counts if c[0]), key=lambda count: -count[0])
    return ", ".join([f"{first[0]} of {n_open} overlaps {first[1]}", *(f"{n} {words}" for n, words in others)])


def _pattern_advice(shifts: Shifts) -> str:
    """Return advice for repeating patterns, or an empty string."""
    if not (shifts.doubt == RejectionReason.AMBIGUOUS).any():
        return ""
    return " If the stage is more accurate than a fifth of the pattern's pitch, set search_um to half of the pitch."


def _patterned(poses: Poses) -> Iterator[str]:
    """Note the believed overlaps of a pattern that repeats: their pictures alone do not tell by how many periods."""
    patterned = poses.shifts.repeats & poses.shifts.believed
    sure = poses.overlap_period_probability[patterned]
    sure = sure[np.isfinite(sure)]
    if patterned.any():
        yield (
            f"{int(patterned.sum())} of {poses.shifts.first.size} overlaps show a repeating pattern: which period is "
            f"right was decided by the stage and all overlaps together{_least_sure(sure)}. Fields that were swapped "
            "look alike there, and are found only where something tells them apart."
        )


def _least_sure(sure: NDArray[np.float64]) -> str:
    """Return ``, the least sure by 99.2 %``, or an empty string."""
    if not sure.size:
        return ""
    least = float(sure.min())
    return ", each by more than 99.9 %" if least > 0.999 else f", the least sure by {100 * least:.3g} %"


def _along_lines(poses: Poses) -> Iterator[str]:
    """Note the fields that overlaps place in one direction only, where these show nothing but lines along the other."""
    shifts, n_fields = poses.shifts, poses.numbers.size
    between = shifts.believed & ~poses.left_out[shifts.first] & ~poses.left_out[shifts.second]
    loose = np.zeros(n_fields, np.bool_)
    for u_um in (shifts.u_x_um, shifts.u_y_um):
        tied = _joined(n_fields, shifts, between & (u_um < max(poses.stage_error_um, STAGE_AT_LEAST_UM)))
        size = np.bincount(tied, minlength=n_fields)
        loose |= tied != tied[np.argmax(size[tied])]
    loose &= ~poses.left_out & ~placed_by_stage(poses)
    if loose.any():
        who = "All fields" if loose.sum() >= n_fields - 1 else _listed(poses.numbers[loose].tolist())
        yield (
            f"{who} {'is' if loose.sum() == 1 else 'are'} placed by the stage along one direction: the overlaps there "
            "show only lines along it."
        )


def _left_out(poses: Poses, pairs: NDArray[np.int32], opened: Open, noted: Sequence[int]) -> Iterator[str]:
    for place in np.setdiff1d(np.flatnonzero(poses.left_out), noted).tolist():
        adjacent = pairs[(pairs == place).any(axis=1)]
        others = [n for n in adjacent[adjacent != place].tolist() if not poses.left_out[n]]
        yield judge_misfit(int(poses.numbers[place]), opened(place), [opened(n) for n in others])


def _loose(poses: Poses) -> Iterator[str]:
    for place in unverifiable_fields(poses.numbers.size, poses.shifts).tolist():
        yield unverifiable_field_note(int(poses.numbers[place]))


def _empty(poses: Poses, opened: Open) -> Iterator[int]:
    """Yield the indices of fields without heights, among those whose heights could not be compared anywhere."""
    compared = poses.seams.n_pixels > 0
    has_pixels = np.zeros(poses.numbers.size, bool)
    has_pixels[poses.seams.first[compared]] = has_pixels[poses.seams.second[compared]] = True
    for place in np.flatnonzero(~has_pixels & ~poses.left_out).tolist():
        if has_no_heights(opened(place)):
            yield place


def _alone(poses: Poses, pairs: NDArray[np.int32]) -> Iterator[str]:
    """Note the fields without overlap, in one sentence; nothing for a single field."""
    isolated = np.setdiff1d(np.arange(poses.numbers.size), pairs)
    if isolated.size and poses.numbers.size > 1:
        one = isolated.size == 1
        yield (
            f"{_listed(poses.numbers[isolated].tolist())} {'overlaps' if one else 'overlap'} no other field: "
            f"{'it lies' if one else 'they lie'} where the stage says."
        )


def _listed(numbers: Sequence[int]) -> str:
    """Return ``Field 3``, ``Fields 3, 4 and 7``, or ``Fields 1, 2, 3, 4, 5, 6, 7, 8 and 40 more``."""
    if len(numbers) == 1:
        return f"Field {numbers[0]}"
    named, more = (numbers, 0) if len(numbers) <= NAMED else (numbers[:NAMED], len(numbers) - NAMED)
    *first, last = [str(n) for n in named] + ([f"{more} more"] if more else [])
    return f"Fields {', '.join(first)} and {last}"
