"""Search for swapped fields of a repeating pattern, by their deviations from where the stage had them.

Where all dies are alike, a field in the place of another fits its neighbours as well as its own, but at any part of a
period, while the stage errs by much less. Two such fields are swapped if each fits in the place of the other about
where the stage says, and if that is so much likelier that it outweighs the number of pairs that might be swapped.
Where the stage errs by a sixth of a period and more, nothing in positions or pictures tells.

Where a pattern repeats, a mirrored or turned field still fits its neighbours somewhere, only less well than fields fit
each other. Such suspects are compared with their neighbours again at the place where the stage and the other fields
expect them: as they are, in each other orientation, and with the pictures of other suspects in their place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.field_poses import Numbers, RejectionReason, Shifts
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.reconstruct.registration.misplaced_fields import (
    TURNS,
    reoriented,
    swapped_fields_note,
    turned_field_note,
)
from wafer_viewer.reconstruct.registration.pair_registration import PairShift, refine_pair, register_pair

# -------------------------------------------------------------------------------------------------------- misfit search


Ints = NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class MisfitSearchParameters:
    """Limits of the search, set with `tests/bench/bench_grids.py` on seeds below 300.

    Parameters
    ----------
    poor : float
        Unexplained variance of a good overlap, relative to the median of all accepted ones, at most.
    better : float
        Unexplained variance in another orientation, relative to that as the field is, at most.
    alone : float
        The same where there is a single neighbour.
    good : float
        Unexplained variance in another orientation, relative to the median of all accepted overlaps, at most.
    surely_good : float
        Unexplained variance that is good in any case.
    most_share : float
        Largest share of suspects: with more, all overlaps are poor.
    most_suspects : int
        Number of suspects up to which a single one is searched among few fields, whatever their share.
    most_swapped : int
        Largest number of suspects whose pictures are exchanged.
    most_gain : float
        Largest logarithm of the gain by an exchange of pictures that a neighbour counts for.
    least_gain : float
        Smallest sum of these in each of both places.
    least_sum : float
        Smallest sum of these in both places together.
    reach_px : float, px
        Largest deviation from the expected place.
    """

    poor: float = 3.0
    better: float = 0.4
    alone: float = 0.2
    good: float = 5.0
    surely_good: float = 0.02
    most_share: float = 0.2
    most_suspects: int = 3
    most_swapped: int = 4
    most_gain: float = 2.5
    least_gain: float = 1.0
    least_sum: float = 4.0
    reach_px: float = 12.0


SEARCH = MisfitSearchParameters()
_FITS = (RejectionReason.NONE, RejectionReason.AMBIGUOUS)


def suspects(n_fields: int, shifts: Shifts, left_out: NDArray[np.bool_]) -> Ints:
    """Return the fields of whose overlaps a third or less are good, among those with something to compare."""
    unexplained = _unexplained_of(shifts)
    good = shifts.believed & (unexplained < SEARCH.poor * usual_unexplained(shifts))
    shows = (shifts.doubt != RejectionReason.BLANK) & ~good
    n_good, n_shown = (
        np.bincount(np.concatenate((shifts.first[some], shifts.second[some])), minlength=n_fields)
        for some in (good, shows)
    )
    found = np.flatnonzero(((2 * n_good <= n_shown) & (n_shown > 0)) | left_out)
    few = len(found) <= max(SEARCH.most_suspects, SEARCH.most_share * n_fields)
    return found.astype(np.int32) if few else np.zeros(0, np.int32)


def usual_unexplained(shifts: Shifts) -> float:
    """Return the median unexplained variance of the accepted overlaps."""
    return float(np.median(_unexplained_of(shifts)[shifts.believed])) if shifts.believed.any() else 0.0


def _unexplained_of(shifts: Shifts) -> Numbers:
    return 1 - np.clip(shifts.correlation.astype(float), 0, 1) ** 2


@dataclass(frozen=True, slots=True, eq=False)
class Misfits:
    """Fields that belong otherwise: index to orientation, by name; pairs of indices that are swapped."""

    turned: dict[int, str]
    swapped: tuple[tuple[int, int], ...]

    @property
    def fields(self) -> list[int]:
        """Indices of all of them."""
        return sorted(set(self.turned) | {n for pair in self.swapped for n in pair})

    def notes(self, numbers: NDArray[np.int32]) -> tuple[str, ...]:
        """Return a sentence for each; numbers: of the fields."""
        turned = [turned_field_note(int(numbers[n]), how) for n, how in sorted(self.turned.items())]
        return (*turned, *(swapped_fields_note(int(numbers[a]), int(numbers[b])) for a, b in self.swapped))


NO_MISFITS = Misfits({}, ())


def search_misfits(found: Ints, pairs: Ints, moved_um: Numbers, usual: float, opened: Open) -> Misfits:
    """Compare suspects with their neighbours in other orientations, and in each other's place.

    pairs: of overlapping fields, [n, 2]; moved_um: expected position less the stage's, of all fields, [n, 2];
    usual: unexplained variance of good overlaps.
    """
    every = {int(n): _Place.of(int(n), found, pairs, moved_um, usual, opened) for n in found}
    places = {n: place for n, place in every.items() if not place.suits(place.field)}
    turned: dict[int, str] = {}
    for n, place in places.items():
        own = place.likeness(place.field)
        square = place.field.shape[0] == place.field.shape[1]
        ways = {name: turn for name, turn in TURNS.items() if square or "90" not in name}
        each = {name: place.likeness(reoriented(place.field, turn)) for name, turn in ways.items()}
        best = max(each, key=lambda name: (place.evidence(own, each[name]), -float(each[name].sum())))
        if place.evidence(own, each[best]) > 0:
            turned[n] = best
    rest = [n for n in places if n not in turned]
    return Misfits(turned, _swapped({n: places[n] for n in rest}) if len(rest) <= SEARCH.most_swapped else ())


def _swapped(places: dict[int, _Place]) -> tuple[tuple[int, int], ...]:
    """Return the pairs of which each fits in the place of the other."""
    own = {n: place.likeness(place.field) for n, place in places.items()}
    pairs: list[tuple[int, int]] = []
    numbers = sorted(places)
    for k, a in enumerate(numbers):
        for b in numbers[k + 1 :]:
            there = places[a].gain(own[a], places[a].likeness(places[b].field))
            here = places[b].gain(own[b], places[b].likeness(places[a].field))
            if min(there, here) > SEARCH.least_gain and there + here > SEARCH.least_sum:
                pairs.append((a, b))
    return tuple(pairs)


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """Place where a suspect should lie, with neighbours where the poses have them, and what good overlaps leave."""

    field: HeightMap
    neighbours: Sequence[HeightMap]
    usual: float

    @classmethod
    def of(cls, n: int, found: Ints, pairs: Ints, moved_um: Numbers, usual: float, opened: Open) -> _Place:
        """Return the place of field n, at its expected position, beside neighbours that are no suspects."""
        adjacent = pairs[(pairs == n).any(axis=1)]
        others = [int(k) for k in adjacent[adjacent != n] if k not in found]
        return cls(_moved(opened(n), moved_um[n]), [_moved(opened(k), moved_um[k]) for k in others], usual)

    def likeness(self, picture: HeightMap) -> Numbers:
        """Return the unexplained variance of a field in this place beside each neighbour; 1 where it does not fit."""
        placed = replace(picture, x0_um=self.field.x0_um, y0_um=self.field.y0_um)
        return np.array([_unexplained(placed, other) for other in self.neighbours])

    def suits(self, picture: HeightMap) -> bool:
        """Return whether a field fits all neighbours in this place as good overlaps fit."""
        likeness = self.likeness(picture)
        return bool(len(likeness)) and bool((likeness < SEARCH.poor * self.usual).all())

    def gain(self, own: Numbers, other: Numbers) -> float:
        """Return the sum of the logarithms by which another picture leaves less unexplained beside the neighbours."""
        return float(np.clip(np.log(own / np.maximum(other, 1e-6)), -SEARCH.most_gain, SEARCH.most_gain).sum())

    def evidence(self, own: Numbers, other: Numbers) -> int:
        """Return how many neighbours another picture fits clearly better, less those that it fits clearly worse.

        0 where they do not decide.
        """
        fits = other < max(SEARCH.surely_good, SEARCH.good * self.usual)
        n_better = int(np.sum(fits & (other < (SEARCH.better if len(other) > 1 else SEARCH.alone) * own)))
        n_worse = int(np.sum(own < SEARCH.better * other))
        if n_worse and n_worse >= n_better:
            return -n_worse
        return n_better - n_worse if n_better > 1 or len(other) == 1 else 0


def _moved(height: HeightMap, by_um: Numbers) -> HeightMap:
    return replace(height, x0_um=height.x0_um + float(by_um[0]), y0_um=height.y0_um + float(by_um[1]))


def _unexplained(first: HeightMap, second: HeightMap) -> float:
    """Return the unexplained variance of the best fit of two fields near their positions, 1 where none fits."""
    found = register_pair(first, second, SEARCH.reach_px)
    if found.doubt not in _FITS:
        found = refine_pair(first, second, (0.0, 0.0))
    return 1 - max(found.correlation, 0.0) ** 2 if found.doubt in _FITS else 1.0


# ---------------------------------------------------------------------------------------------------------- swap search


@dataclass(frozen=True, slots=True)
class SwapSearchParameters:
    """Limits of the search, set with `tests/bench/bench_grids.py` on seeds below 1000.

    Parameters
    ----------
    prior_nats : float
        Log odds against a swap anywhere in a scan: one scan in a thousand has swapped fields.
    most_fields : int
        Largest number of fields that are compared with each other, those that deviate most.
    most_chi2 : float
        Largest square of the deviation of a field in the place of the other, in standard deviations of the stage; one
        of a thousand is larger.
    own_share : float
        Least share of its neighbours that a field fits where it lies: one of them may be swapped itself.
    same_px : float, px
        Largest distance of the offsets at which a field fits two of its neighbours.
    most_u_px : float, px
        Largest uncertainty of an offset along an axis: along lines it says nothing.
    reach_sigmas : float
        Reach of the comparison about the expected place, in standard deviations of the stage.
    least_reach_px : float, px
        Smallest reach.
    """

    prior_nats: float = 7.0
    most_fields: int = 8
    most_chi2: float = 13.8
    own_share: float = 0.5
    same_px: float = 2.0
    most_u_px: float = 1.0
    reach_sigmas: float = 4.0
    least_reach_px: float = 6.0


SWAPS = SwapSearchParameters()
N_SHARED = 6
"""Number of errors of the stage that are estimated beside its scatter."""
Open = Callable[[int], HeightMap]


@dataclass(frozen=True, slots=True, eq=False)
class StageDeviations:
    """Deviations of fields from their stage positions, (x, y) in um.

    moved_um: as overlaps have them, [n, 2]; by_stage_um: those that all fields have in common, [n, 2]; scatter_um:
    standard deviation along x and y of the others, [2]; placed: mask of the fields that have a place, [n].
    """

    moved_um: Numbers
    by_stage_um: Numbers
    scatter_um: Numbers
    placed: NDArray[np.bool_]

    def chi2(self, field: int, moved_um: Numbers) -> Numbers:
        """Return the squares of deviations [k, 2] of a field, in standard deviations of the stage."""
        rest: Numbers = (np.atleast_2d(moved_um) - self.by_stage_um[field]) / self.scatter_um
        return np.sum(rest**2, axis=1)

    def cost_nats(self, chi2: Numbers) -> Numbers:
        """Return minus the log likelihood of such deviations, of Student's t: the scatter is known from few fields."""
        freedom = max(4, int(self.placed.sum()) - N_SHARED)
        cost: Numbers = (freedom + 2) / 2 * np.log1p(chi2 / freedom)
        return cost


def search_swapped(
    found: StageDeviations, shifts: Shifts, pixel_um: float, opened: Open
) -> tuple[tuple[int, int], ...]:
    """Return the pairs of fields that are swapped, each field in one pair at most."""
    n_fields = int(found.placed.sum())
    limit_nats = SWAPS.prior_nats + math.log(max(1, n_fields * (n_fields - 1) // 2))
    own_nats = _own_nats(found, shifts, pixel_um)
    odd = np.argsort(-own_nats, kind="stable")[: SWAPS.most_fields]
    tested = [(int(a), int(b)) for a, b in combinations(sorted(odd), 2) if own_nats[a] + own_nats[b] > limit_nats]
    suspects = {n for pair in tested for n in pair}
    gains: dict[tuple[int, int], float] = {}
    for a, b in tested:
        chi2 = [_chi2_of(opened(q), p, found, shifts, suspects, pixel_um, opened) for p, q in ((a, b), (b, a))]
        if max(chi2) < SWAPS.most_chi2:
            gains[a, b] = float(own_nats[a] + own_nats[b] - found.cost_nats(np.array(chi2)).sum())
    pairs: list[tuple[int, int]] = []
    for pair in sorted(gains, key=lambda one: -gains[one]):
        if gains[pair] > limit_nats and not {n for p in pairs for n in p} & set(pair):
            pairs.append(pair)
    return tuple(sorted(pairs))


def _own_nats(found: StageDeviations, shifts: Shifts, pixel_um: float) -> Numbers:
    """Return the cost of the deviation at which each field fits its neighbours, 0 where it fits none."""
    overlaps: list[list[int]] = [[] for _ in found.placed]
    for e, (a, b) in enumerate(zip(shifts.first.tolist(), shifts.second.tolist(), strict=True)):
        overlaps[a].append(e)
        overlaps[b].append(e)
    chi2 = np.full(len(found.placed), math.inf)
    for n in np.flatnonzero(found.placed).tolist():
        each = [_told(shifts, e, n, found, pixel_um) for e in overlaps[n]]
        chi2[n] = _least_chi2(found, n, [places for places in each if len(places)], SWAPS.own_share, pixel_um)
    fits = np.isfinite(chi2)
    return np.where(fits, found.cost_nats(np.where(fits, chi2, 0.0)), 0.0)


def _told(shifts: Shifts, overlap: int, field: int, found: StageDeviations, pixel_um: float) -> Numbers:
    """Return the deviations [k, 2] of a field at which the search had it fit the neighbour in an overlap."""
    is_first = shifts.first[overlap] == field
    other = shifts.second[overlap] if is_first else shifts.first[overlap]
    if not found.placed[other]:
        return np.zeros((0, 2))
    offsets = shifts.candidates[overlap, :, :2].astype(float)
    offsets = offsets[np.isfinite(offsets[:, 0])]
    u_um = max(float(shifts.u_x_um[overlap]), float(shifts.u_y_um[overlap]))
    if not len(offsets) and shifts.believed[overlap] and u_um < SWAPS.most_u_px * pixel_um:
        offsets = np.array([[shifts.x_um[overlap], shifts.y_um[overlap]]], float)
    return found.moved_um[other] + (-offsets if is_first else offsets)


def _least_chi2(found: StageDeviations, field: int, each: Sequence[Numbers], share: float, pixel_um: float) -> float:
    """Return the least deviation at which a field fits this share of its neighbours; infinite without one.

    each: the deviations [k, 2] at which it fits each of them.
    """
    if not each:
        return math.inf
    places = np.concatenate(each)
    n_agreeing = np.zeros(len(places), np.intp)
    for others in each:
        apart = np.hypot(*np.moveaxis(places[:, None] - others[None], -1, 0))
        n_agreeing += apart.min(axis=1, initial=math.inf) < SWAPS.same_px * pixel_um
    return float(found.chi2(field, places[n_agreeing >= share * len(each)]).min(initial=math.inf))


def _chi2_of(
    picture: HeightMap,
    place: int,
    found: StageDeviations,
    shifts: Shifts,
    suspects: set[int],
    pixel_um: float,
    opened: Open,
) -> float:
    """Return the deviation of a picture in the place of another field, at which it fits the neighbours there."""
    held, by_stage_um = opened(place), found.by_stage_um[place]
    begun = replace(picture, x0_um=held.x0_um + float(by_stage_um[0]), y0_um=held.y0_um + float(by_stage_um[1]))
    reach_px = max(SWAPS.least_reach_px, SWAPS.reach_sigmas * float(found.scatter_um.max()) / pixel_um)
    each: list[Numbers] = []
    for e in np.flatnonzero((shifts.first == place) | (shifts.second == place)):
        other = int(shifts.first[e] + shifts.second[e] - place)
        if found.placed[other] and other not in suspects:
            neighbour = opened(other)
            x_um, y_um = found.moved_um[other]
            moved = replace(neighbour, x0_um=neighbour.x0_um + float(x_um), y0_um=neighbour.y0_um + float(y_um))
            pair = register_pair(begun, moved, reach_px)
            if pair.doubt is not RejectionReason.BLANK:
                each.append(by_stage_um - _offsets(pair, pixel_um))
    return _least_chi2(found, place, each, 1.0, pixel_um)


def _offsets(pair: PairShift, pixel_um: float) -> Numbers:
    """Return the offsets (x, y) at which two fields fit, [k, 2]."""
    if len(pair.candidates):
        return pair.candidates[:, :2].astype(float)
    is_told = pair.doubt is RejectionReason.NONE and max(pair.u_x_um, pair.u_y_um) < SWAPS.most_u_px * pixel_um
    return np.array([[pair.x_um, pair.y_um]]) if is_told else np.zeros((0, 2))
