"""Defects built from their pixels, defects of entire dies, and those that repeat from die to die.

The outline contains the pixels above half of the peak. The length of a defect longer than three widths is the extent of
its pixels.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.measurement_context import PIXEL_SCALE, Lines, MeasurementContext
from wafer_viewer.measure.defects.features import DefectOutline, Gathered, Mask, height_of, outline_of, shape_of
from wafer_viewer.measure.defects.segmentation import DefectPiece, evidence_of
from wafer_viewer.measure.dies.die_cells import CellGrid
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.defect import (
    LEAST_DIES,
    RESOLVED_FROM_PX,
    Defect,
    DefectRecipe,
    Inspection,
    RepeatedPlace,
)
from wafer_viewer.model.inspection.defect_classes import RULES, ClassRules, Condition, DefectClass, DefectShape
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import replace

# ------------------------------------------------------------------------------------------------------------ repeaters


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
        the largest distance from it, the names of the dies, the number of whole dies, the numbers of the defects,
        their most frequent class and the probability of chance. Each defect belongs to one place.

    Raises
    ------
    MeasureError
        If `within_um` is not above 0, or `least_dies` is less than 2.

    Notes
    -----
    The distance must hold for both defects of a pair, so that a long scratch does not absorb small defects.

    For chance, every die keeps its defects and each is placed uniformly on the die. A defect then has neighbours on at
    least k - 1 of the other dies with the tail probability of a binomial distribution of the same mean, which is an
    upper bound above that mean [1]_. The sum over all defects corrects for the number of places (Bonferroni).

    References
    ----------
    .. [1] W. Hoeffding, "On the distribution of the number of successes in independent trials", Ann. Math. Statist. 27
       (1956), 713-721.
    """
    if within_um is not None and not within_um > 0:
        raise MeasureError(f"within_um is {within_um:g}: it must be over 0.")
    if least_dies < 2:
        raise MeasureError(f"least_dies is {least_dies}: a place repeats in two dies at least.")
    on_dies = [d for d in inspection.found if d.die and d.in_die is not None and d.judgement != "nuisance"]
    n_whole = sum(die.state == "whole" for die in inspection.dies)
    groups = tuple(_groups(on_dies, within_um, least_dies))
    n_dies = {len({defect.die for defect in group}) for group in groups}
    chances = _by_chance(on_dies, within_um, inspection.grid, n_dies) if n_dies and inspection.grid else {}
    found = (_repeated_place(group, n_whole, chances) for group in groups)
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


def _by_chance(
    defects: Sequence[Defect], within_um: float | None, grid: DieGrid, n_dies: Collection[int]
) -> dict[int, float]:
    """Return, for each number of dies, an upper bound of the probability that any place has defects of so many."""
    from scipy.special import bdtrc

    reach = np.array([_reach_um(defect, within_um) for defect in defects])
    names, die = np.unique([defect.die for defect in defects], return_inverse=True)
    n_others, means = len(names) - 1, np.empty(len(defects))
    for k in range(len(defects)):
        share = np.pi * np.minimum(reach, reach[k]) ** 2 / (grid.width_um * grid.height_um)
        missed = np.bincount(die, np.log1p(-np.minimum(share, 1 - 1e-12)), len(names))
        missed[die[k]] = 0.0
        means[k] = -np.expm1(missed).sum()
    tails = {n: np.where(n - 1 > means + 1, bdtrc(n - 2, n_others, means / n_others), 1.0) for n in n_dies}
    return {n: float(min(1.0, tail.sum())) for n, tail in tails.items()}


def _repeated_place(group: Sequence[Defect], n_whole: int, chances: Mapping[int, float]) -> RepeatedPlace:
    in_order = sorted(group, key=lambda defect: (_col_row(defect.die), defect.number))
    places = np.array([[d.in_die.x_um, d.in_die.y_um] for d in in_order if d.in_die is not None])
    middle: Floats = np.median(places, axis=0)
    dies = tuple(dict.fromkeys(defect.die for defect in in_order))
    return RepeatedPlace(
        in_die=Point(x_um=float(middle[0]), y_um=float(middle[1])),
        reach_um=float(np.hypot(*(places - middle).T).max()),
        dies=dies,
        of_dies=n_whole,
        numbers=tuple(defect.number for defect in in_order),
        kind=_usual(in_order),
        by_chance=chances.get(len(dies)),
    )


def _usual(defects: Sequence[Defect]) -> str:
    counts = Counter(defect.seen_as for defect in defects)
    return counts.most_common(1)[0][0]


def _col_row(die: str) -> tuple[int, ...]:
    col, row = map(int, die.split(","))
    return -row, col


# ------------------------------------------------------------------------------------------------------- defect builder


NOT_RESOLVED = "Detected, size not resolved: under 20 px."
SIZE_NOTE = "Lengths and area are those over half of the peak."
UNSEEN = "It shows in the picture; most of its heights could not be measured."
NARROW_WINDOWS = 2
"""Width in focus windows below which heights are underestimated: by half in scratches one window wide."""
U_EDGE_PX = 0.5
"""Standard uncertainty (k = 1) of the position of an outline, due to pixel quantisation."""

ROUND_TO = 1.3
"""Ratio of major to minor axis below which an outline is a circle."""


def defect_of(
    pieces: Sequence[DefectPiece], cells: CellGrid, reading: MeasurementContext, recipe: DefectRecipe, on_dies: bool
) -> Defect:
    """Build one defect from its pieces; on_dies: the cells are dies."""
    merged = Gathered.of(pieces)
    height_um, inside = height_of(merged, cells.pixel_um)
    outline = outline_of(merged.x_um[inside], merged.y_um[inside], cells.pixel_um)
    shape = shape_of(merged, inside, outline, height_um, cells, recipe, on_dies)
    found = classify(shape, recipe.rules)
    unseen = found.kind == "unmeasured"
    if unseen:
        found = classify(replace(shape, unmeasured_fraction=0.0), recipe.rules)
    resolved = outline.major_um >= RESOLVED_FROM_PX * cells.pixel_um
    narrow = _narrow(reading, outline) if height_um else ()
    center = Point(x_um=outline.x_um, y_um=outline.y_um)
    return Defect(
        **reading.result_fields("", 0, *_notes(reading, resolved), *narrow, *((UNSEEN,) if unseen else ())),
        center=center,
        outline=_region(outline, cells.pixel_um),
        kind=found.kind,
        reasons=found.reasons,
        confidence=confidence(merged.first.score, recipe, found.confidence),
        **(_place(center, cells.grid) if on_dies else {}),
        **_sizes(merged, inside, outline, height_um, cells.pixel_um, reading, resolved, not narrow),
        mean_height_um=shape.mean_height_um,
        angle_deg=outline.angle_deg,
        score=merged.first.score,
        scale_px=merged.first.scale_px,
        evidence=evidence_of(merged.peaks, recipe.threshold_sigma),
        size_resolved=resolved,
    )


def confidence(score: float, recipe: DefectRecipe, of_class: float) -> float:
    """Return the confidence of a defect and its class: 0.5 at the threshold, limited by the class's own confidence."""
    sure = 1 - 0.5 * math.exp(-max(0.0, score - recipe.threshold_sigma) / 2)
    return min(1.0, max(0.0, sure * of_class))


def _region(outline: DefectOutline, pixel_um: float) -> Region:
    """Return a circle for a nearly round outline, else the ellipse as a polygon."""
    major, minor = max(outline.major_um, 2 * pixel_um), max(outline.minor_um, 2 * pixel_um)
    if major < ROUND_TO * minor:
        return Region.circle(outline.x_um, outline.y_um, major / 2)
    turn, c, s = np.arange(16) * math.pi / 8, *_direction(outline.angle_deg)
    a, b = major / 2 * np.cos(turn), minor / 2 * np.sin(turn)
    xs, ys = outline.x_um + a * c - b * s, outline.y_um + a * s + b * c
    return Region.polygon(*zip(xs.tolist(), ys.tolist(), strict=True))


def _direction(angle_deg: float) -> tuple[float, float]:
    return math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))


def on_lattice(defects: Sequence[Defect], grid: DieGrid) -> tuple[Defect, ...]:
    """Return defects that were found without dies with the die that each lies on, if any."""
    names = {grid.name(*place) for place in grid.places}
    placed = (replace(defect, **_place(defect.center, grid)) for defect in defects)
    return tuple(new if new.die in names else old for new, old in zip(placed, defects, strict=True))


def _place(center: Point, grid: DieGrid) -> dict[str, Any]:
    """Return the die and the position on it."""
    col, row, u_um, v_um = (a.item() for a in grid.to_die(np.array([center.x_um]), np.array([center.y_um])))
    return {"die": grid.name(int(col), int(row)), "in_die": Point(x_um=float(u_um), y_um=float(v_um))}


def _sizes(
    merged: Gathered,
    inside: Mask,
    outline: DefectOutline,
    height_um: float,
    pixel_um: float,
    reading: MeasurementContext,
    resolved: bool,
    wide: bool,
) -> dict[str, Any]:
    """Return lengths, area and volume, with U where defensible; wide: heights are not reduced by averaging."""
    volume_um3 = float(np.nansum(merged.z_um)) * pixel_um**2
    area = 0.0 if not resolved else outline.area_um2
    edge_um = U_EDGE_PX * pixel_um
    of_area: Lines | None = {
        PIXEL_SCALE: 2 * reading.u_pixel_scale * area,
        "place of the outline": math.pi * (outline.major_um + outline.minor_um) / 2 * edge_um,
    }
    n = int(np.count_nonzero(inside))
    of_height: Lines = {
        "noise": merged.first.noise_um,
        "z scale": reading.u_z_scale * abs(height_um),
        **reading.frame_lines(),
    }
    measured = bool(np.isfinite(merged.smooth_um).any()) and n > 0
    return {
        "major": reading.length(outline.major_um, _of_length(reading, outline.major_um, edge_um) if resolved else None),
        "minor": reading.length(outline.minor_um, _of_length(reading, outline.minor_um, edge_um) if resolved else None),
        "height": reading.length(height_um, of_height if measured and resolved and wide else None),
        "area": reading.quantity(outline.area_um2, "um2", of_area if resolved else None),
        "volume": reading.quantity(volume_um3, "um3", None),
    }


def _of_length(reading: MeasurementContext, length_um: float, edge_um: float) -> Lines:
    return {**reading.lateral_lines(length_um), "place of the outline": math.sqrt(2) * edge_um}


def _narrow(reading: MeasurementContext, outline: DefectOutline) -> tuple[str, ...]:
    """Return the note that the height is a lower bound, for defects narrow against a known focus window."""
    provenance = reading.surface.provenance
    calibration, window = provenance.calibration, provenance.recipe.window
    if not isinstance(window, int):
        return ()
    least_px = NARROW_WINDOWS * window
    if outline.minor_um >= least_px * (calibration.pixel_um if calibration else reading.surface.pixel_um):
        return ()
    return (
        f"Narrower than {NARROW_WINDOWS} focus windows ({least_px} px), over which heights are averaged: it is about "
        "so high or deep at least, and that has no U.",
    )


def _notes(reading: MeasurementContext, resolved: bool) -> tuple[str, ...]:
    return (SIZE_NOTE, *(() if resolved else (NOT_RESOLVED,)), *reading.not_in_budget())


REPEATS_FROM = 0.5
"""Fraction of the dies from which a defect at the same place in them repeats."""
NEAR_PX = 6.0
"""Distance in pixels within which two defects are at the same place; `tests/bench/bench_defects_truth.py`."""
LEAST_COMPARED = 4
"""Smallest number of dies for a comparison of them."""


def mark_repeaters(defects: Sequence[Defect], n_dies: int, pixel_um: float) -> tuple[Defect, ...]:
    """Mark defects found at the same place in most dies as repeating; for stored golden dies only."""
    if n_dies < LEAST_COMPARED:
        return tuple(defects)
    positions = [(d.in_die.x_um, d.in_die.y_um) if d.in_die is not None else (math.inf, math.inf) for d in defects]
    return tuple(
        replace(d, repeats=True)
        if _dies_near(positions[k], positions, defects, pixel_um) >= REPEATS_FROM * n_dies
        else d
        for k, d in enumerate(defects)
    )


def _dies_near(
    position: tuple[float, float], positions: list[tuple[float, float]], defects: Sequence[Defect], pixel_um: float
) -> int:
    if math.isinf(position[0]):
        return 0
    near = NEAR_PX * pixel_um
    return len(
        {
            d.die
            for d, (u, v) in zip(defects, positions, strict=True)
            if math.hypot(u - position[0], v - position[1]) <= near
        }
    )


_LEAST_PX = 6.0
"""Length in pixels below which the shape is poorly resolved and the confidence is reduced."""


@dataclass(frozen=True, slots=True)
class Classified:
    """A class, its reasons and its confidence, 0 to 1: 0.5 where a number is at its limit."""

    kind: DefectClass
    reasons: tuple[str, ...]
    confidence: float


def classify(shape: DefectShape, rules: ClassRules | None = None) -> Classified:
    """Return the class of a defect of this shape; default rules: the standard ones.

    The rules are evaluated in the order of `RULES`; the first with all conditions met gives the class. A condition is a
    number above or below a limit of `ClassRules`. The conditions met are the reasons, and their distances from the
    limits give the confidence.
    """
    limits = rules or ClassRules()
    closest = math.inf
    for kind, rule in RULES.items():
        conditions = rule(shape, limits)
        if all(condition.holds for condition in conditions):
            closest = min([closest, *(condition.margin for condition in conditions)])
            return Classified(kind, tuple(condition.text for condition in conditions), _confidence(closest, shape))
        closest = min(closest, _least_missed(conditions))
    return Classified("particle", tuple(_bump(shape)), _confidence(closest, shape))


def _least_missed(conditions: tuple[Condition, ...]) -> float:
    """Return the largest margin among the conditions of a failed rule that do not hold."""
    return max(condition.margin for condition in conditions if not condition.holds)


def _confidence(margin: float, shape: DefectShape) -> float:
    """Return the confidence: 0.5 at a limit, near 1 from twice the limit; lower for few pixels."""
    resolved = min(1.0, max(shape.major_um, shape.pixel_um) / (_LEAST_PX * shape.pixel_um))
    return round((1 - 0.5 * math.exp(-3 * margin)) * (0.5 + 0.5 * resolved), 3)


def _bump(shape: DefectShape) -> Iterator[str]:
    """Yield the reasons of a particle or bump."""
    yield f"{shape.height_um:.3g} um high"
    yield f"{shape.ratio:.1f} times as long as wide"
