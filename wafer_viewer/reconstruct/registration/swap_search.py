"""Search for swapped fields of a repeating pattern, by their deviations from where the stage had them.

Where all dies are alike, a field in the place of another fits its neighbours as well as its own, but at any part of a
period, while the stage errs by much less. Two such fields are swapped if each fits in the place of the other about
where the stage says, and if that is so much likelier that it outweighs the number of pairs that might be swapped.
Where the stage errs by a sixth of a period and more, nothing in positions or pictures tells.
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
from wafer_viewer.reconstruct.registration.pair_registration import PairShift, register_pair


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
