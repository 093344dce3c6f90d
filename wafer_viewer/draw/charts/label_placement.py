"""Placement of round labels beside the places that they number: clear of each other, with leader lines if far off."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

Points = NDArray[np.float64]
"""Points [n, 2] as x and y, px."""
GAP_PX = 1.5
"""Least space between two labels."""
LEADER_FROM_PX = 5.0
"""Distance of a label from its place from which a leader line joins them."""
PASSES = 3
"""Passes over all labels; from the second on, each is placed beside all others."""
_ANGLES, _PREFERENCE = 24, 2.0
_OFF_PX = 12.0
"""Distance in px that a place in a ring costs beside its own, for the leader line."""
_COVERED_PX, _CROSSED_PX, _UNDER_PX, _OVERLAP_PX = 3.0, 150.0, 1e3, 1e5
"""Costs, as a distance in px: one px of outline covered, two leaders crossed, a leader under a label, two labels."""


@dataclass(frozen=True, slots=True)
class LabelledPlace:
    """A place with its preferred centres of the label, best first, and points along its outline, px."""

    preferred: Points
    outline: Points


@dataclass(frozen=True, slots=True)
class PlacedLabel:
    """Centre of a label, and the point of its place where a leader line ends; None if it needs none, px."""

    x: float
    y: float
    end: tuple[float, float] | None = None


def place_labels(
    places: Sequence[LabelledPlace], radius: float, low: tuple[float, float], high: tuple[float, float]
) -> list[PlacedLabel]:
    """Return the positions of labels of a radius between two corners, in the order of their places.

    Every label is put where it is nearest to its place and covers the least, greedily, then again beside all others.
    """
    covered = _covered(places, radius, low, high)
    options = [_options(place, radius, low, high, covered) for place in places]
    chosen: list[int | None] = [None] * len(places)
    for _ in range(PASSES):
        before = list(chosen)
        for n, (centres, ends, cost) in enumerate(options):
            others = [(options[m][0][k], options[m][1][k]) for m, k in enumerate(chosen) if m != n and k is not None]
            chosen[n] = int(np.argmin(cost + _conflicts(centres, ends, others, radius)))
        if chosen == before:
            break
    centres = [options[n][0][k] for n, k in enumerate(chosen) if k is not None]
    return [_placed(centre, place, radius) for centre, place in zip(_untangled(centres, places), places, strict=True)]


def _untangled(centres: list[Points], places: Sequence[LabelledPlace]) -> list[Points]:
    """Return the centres exchanged between places where that shortens the leader lines, which then cross less."""
    apart = np.array([[_to_outline(centre, place)[0] for centre in centres] for place in places])
    order = list(range(len(centres)))
    for _ in range(len(centres)):
        shorter = [
            (a, b)
            for a, b in itertools.combinations(range(len(order)), 2)
            if apart[a, order[b]] + apart[b, order[a]] < apart[a, order[a]] + apart[b, order[b]] - GAP_PX
        ]
        if not shorter:
            break
        for a, b in shorter:
            if apart[a, order[b]] + apart[b, order[a]] < apart[a, order[a]] + apart[b, order[b]] - GAP_PX:
                order[a], order[b] = order[b], order[a]
    return [centres[k] for k in order]


def _to_outline(centre: Points, place: LabelledPlace) -> tuple[float, Points]:
    """Return the distance of a centre from an outline, and the nearest point of it."""
    apart = np.hypot(*(place.outline - centre).T)
    nearest = int(apart.argmin())
    return float(apart[nearest]), place.outline[nearest]


def _placed(centre: Points, place: LabelledPlace, radius: float) -> PlacedLabel:
    apart, end = _to_outline(centre, place)
    x, y = centre.tolist()
    return PlacedLabel(x, y, (float(end[0]), float(end[1])) if apart - radius > LEADER_FROM_PX else None)


def _covered(places: Sequence[LabelledPlace], radius: float, low: Sequence[float], high: Sequence[float]) -> Points:
    """Return the length of outline under a label at each px [y, x] of the drawing."""
    drawn = np.zeros((math.ceil(high[1]) + 1, math.ceil(high[0]) + 1))
    for place in places:
        column, row = np.rint(place.outline).astype(int).T
        inside = (column >= 0) & (row >= 0) & (column < drawn.shape[1]) & (row < drawn.shape[0])
        drawn[row[inside], column[inside]] = 1.0
    side = 2 * math.ceil(radius) + 1
    return uniform_filter(drawn, side, mode="constant") * side**2


def _options(
    place: LabelledPlace, radius: float, low: Sequence[float], high: Sequence[float], covered: Points
) -> tuple[Points, Points, Points]:
    """Return the centres that a label may have, the ends of their leader lines, and their costs."""
    step = 2 * radius + GAP_PX
    least = np.array(low) + radius
    most = np.maximum(np.array(high) - radius, least)
    rings = np.arange(1, math.ceil(math.hypot(*(most - least)) / step) + 2) * step
    angles = np.arange(_ANGLES) * 2 * np.pi / _ANGLES
    around = (rings[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)).reshape(-1, 2)
    rim = np.clip(place.preferred, least, most)
    ringed = rim[0] + around
    ringed = ringed[((ringed >= least) & (ringed <= most)).all(axis=1)]
    centres = np.concatenate([rim, ringed])
    offsets = np.abs(centres[:, None] - place.outline[None])
    apart = np.hypot(*offsets.transpose(2, 0, 1))
    column, row = np.rint(centres).astype(int).T
    over = covered[row, column]
    over[: len(rim)] -= (offsets[: len(rim)].max(axis=2) <= radius + 1).sum(
        axis=1
    )  # its own outline may be covered there
    cost = np.concatenate([_PREFERENCE * np.arange(len(rim)), _OFF_PX + apart.min(axis=1)[len(rim) :]])
    return centres, place.outline[apart.argmin(axis=1)], cost + _COVERED_PX * np.maximum(over, 0)


def _conflicts(centres: Points, ends: Points, others: Sequence[tuple[Points, Points]], radius: float) -> Points:
    """Return the cost of each centre beside labels that are placed, by overlaps and by crossed leader lines."""
    cost = np.zeros(len(centres))
    for centre, end in others:
        near = np.hypot(*(centres - centre).T) < 2 * radius + GAP_PX - 1e-6
        under = _distance(centre[None], centres, ends) < radius + GAP_PX
        over = _distance(centres, centre[None], end[None]) < radius + GAP_PX
        crossed = _cross(centres, ends, centre, end)
        cost += _OVERLAP_PX * near + _UNDER_PX * (under | over) + _CROSSED_PX * crossed
    return cost


def _distance(points: Points, starts: Points, stops: Points) -> Points:
    """Return the distance of points from line segments."""
    along = stops - starts
    square = np.maximum((along**2).sum(axis=1), 1e-12)
    share = np.clip(((points - starts) * along).sum(axis=1) / square, 0, 1)
    return np.hypot(*(points - starts - share[:, None] * along).T)


def _cross(starts: Points, stops: Points, start: Points, stop: Points) -> NDArray[np.bool_]:
    """Return whether line segments cross another one."""

    def side(a: Points, b: Points, point: Points) -> Points:
        return np.sign((b - a)[..., 0] * (point - a)[..., 1] - (b - a)[..., 1] * (point - a)[..., 0])

    beside = side(start, stop, starts) * side(start, stop, stops) < 0
    return beside & (side(starts, stops, start) * side(starts, stops, stop) < 0)
