"""Repeating defects: places with a defect on several dies when all dies are overlaid. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.defect import LEAST_DIES, Defect, Inspection, RepeatedPlace
from wafer_viewer.model.inspection.defect_classes import DefectClass
from wafer_viewer.model.region import Point

LEAST_WITHIN_UM = 5.0
"""Lower limit of the matching distance: positions on dies are uncertain by a few pixels."""
Floats = NDArray[np.float64]


def repeated_places(
    inspection: Inspection, within_um: float | None = None, least_dies: int = LEAST_DIES
) -> tuple[RepeatedPlace, ...]:
    """Return the places on the die where defects of several dies coincide.

    Parameters
    ----------
    inspection : Inspection
        The inspection with its defects. Unmeasured areas, rejected defects (judged "nuisance") and defects off the dies
        do not count.
    within_um : float, optional
        Largest distance on the die between defects at the same place, um. By default half the length of the shorter
        one, at least 5 um.
    least_dies : int, default 3
        Smallest number of dies with a defect at the place, at least 2.

    Returns
    -------
    tuple of RepeatedPlace
        The places, those on most dies first. Each has the median position in um from the lower left corner of the die,
        the largest distance from it, the names of the dies, the number of whole dies, the numbers of the defects and
        their most frequent class. Each defect belongs to one place.

    Raises
    ------
    MeasureError
        If `within_um` is not above 0, or `least_dies` is less than 2.

    Notes
    -----
    The distance must hold for both defects of a pair, so that a long scratch does not absorb small defects.
    """
    if within_um is not None and not within_um > 0:
        raise MeasureError(f"within_um is {within_um:g}: it must be over 0.")
    if least_dies < 2:
        raise MeasureError(f"least_dies is {least_dies}: a place repeats in two dies at least.")
    on_dies = [d for d in inspection.found if d.die and d.in_die is not None and d.judgement != "nuisance"]
    n_whole = sum(die.state == "whole" for die in inspection.dies)
    found = (_place(group, n_whole) for group in _groups(on_dies, within_um, least_dies))
    return tuple(sorted(found, key=lambda place: (-len(place.dies), place.numbers)))


def _groups(defects: Sequence[Defect], within_um: float | None, least_dies: int) -> Iterator[list[Defect]]:
    """Yield disjoint groups of defects around a seed; seeds are taken in order of decreasing number of dies."""
    if len(defects) < least_dies:
        return
    near = _neighbours(defects, within_um)
    taken: set[int] = set()
    for seed in sorted(range(len(defects)), key=lambda k: (-_n_dies(defects, near[k]), defects[k].number)):
        group = [k for k in near[seed] if k not in taken]
        if seed not in taken and _n_dies(defects, group) >= least_dies:
            taken.update(group)
            yield [defects[k] for k in group]


def _neighbours(defects: Sequence[Defect], within_um: float | None) -> list[list[int]]:
    """Return, for each defect, the defects at the same place including itself.

    The distance limit holds in both directions, so that a long scratch does not absorb small defects.
    """
    from scipy.spatial import KDTree

    places = np.array([[d.in_die.x_um, d.in_die.y_um] for d in defects if d.in_die is not None])
    reach = np.array([_reach_um(defect, within_um) for defect in defects])
    neighbours = [set(others) for others in KDTree(places).query_ball_point(places, reach).tolist()]
    return [sorted(other for other in others if k in neighbours[other]) for k, others in enumerate(neighbours)]


def _reach_um(defect: Defect, within_um: float | None) -> float:
    return max(LEAST_WITHIN_UM, defect.major.value_um / 2) if within_um is None else within_um


def _n_dies(defects: Sequence[Defect], group: Sequence[int]) -> int:
    return len({defects[k].die for k in group})


def _place(group: Sequence[Defect], n_whole: int) -> RepeatedPlace:
    in_order = sorted(group, key=lambda defect: (_col_row(defect.die), defect.number))
    places = np.array([[d.in_die.x_um, d.in_die.y_um] for d in in_order if d.in_die is not None])
    middle: Floats = np.median(places, axis=0)
    return RepeatedPlace(
        in_die=Point(x_um=float(middle[0]), y_um=float(middle[1])),
        reach_um=float(np.hypot(*(places - middle).T).max()),
        dies=tuple(dict.fromkeys(defect.die for defect in in_order)),
        of_dies=n_whole,
        numbers=tuple(defect.number for defect in in_order),
        kind=_usual(in_order),
    )


def _usual(defects: Sequence[Defect]) -> DefectClass:
    counts = Counter[DefectClass](defect.seen_as for defect in defects)
    return counts.most_common(1)[0][0]


def _col_row(die: str) -> tuple[int, ...]:
    col, row = map(int, die.split(","))
    return -row, col
