"""Found defects against planted ones, one to one, and the rates with their limits (95 %) that SEMI M50 speaks of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.stats import beta, chi2

from tests.truth.planted import PIXEL_UM, Planted
from wafer_viewer.model.inspection.defect import Defect

ROOM_UM = 4 * PIXEL_UM
"""A centroid this far outside of a planted outline still belongs to it; a false one is twice as far from all."""
ODD = ("missing die", "tilted die")


@dataclass(frozen=True, slots=True)
class Matched:
    """pairs: planted and found; missed; parts: more of a planted one that was found already; false: at nothing."""

    pairs: tuple[tuple[Planted, Defect], ...]
    missed: tuple[Planted, ...]
    parts: tuple[Defect, ...]
    false: tuple[Defect, ...]


def match(planted: Sequence[Planted], found: Sequence[Defect]) -> Matched:
    """One to one, the nearest centroids first; small defects before the dies they may lie on."""
    cost = np.array([[_distance(one, other) for other in found] for one in planted]).reshape(len(planted), len(found))
    rows, cols = linear_sum_assignment(np.where(np.isfinite(cost), cost, 1e9))
    taken = {(int(r), int(c)) for r, c in zip(rows, cols, strict=True) if np.isfinite(cost[r, c])}
    pairs = tuple((planted[r], found[c]) for r, c in sorted(taken))
    got, used = {r for r, _ in taken}, {c for _, c in taken}
    left = [defect for n, defect in enumerate(found) if n not in used]
    parts = tuple(defect for defect in left if any(_touches(one, defect) for one in planted))
    return Matched(
        pairs=pairs,
        missed=tuple(one for n, one in enumerate(planted) if n not in got),
        parts=parts,
        false=tuple(defect for defect in left if defect not in parts),
    )


def _distance(one: Planted, found: Defect) -> float:
    """Between centroids in um, inf where they are not of each other; a whole die is far from what lies on it."""
    x_um, y_um = found.center.x_um, found.center.y_um
    if not one.holds(x_um, y_um, ROOM_UM) and not _holds(found, one):
        return np.inf
    return float(np.hypot(x_um - one.x_um, y_um - one.y_um)) + 1000 * _unlike(one, found)


def _holds(found: Defect, one: Planted) -> bool:
    """Whether the planted centre lies in the found outline, and that is not much larger than what was planted."""
    xa, ya, xb, yb = found.outline.bounds_um
    inside = xa <= one.x_um <= xb and ya <= one.y_um <= yb
    return inside and max(xb - xa, yb - ya) <= 3 * one.length_um + 4 * ROOM_UM


def _unlike(one: Planted, found: Defect) -> bool:
    """A small spot found on a die that is missing or tilted stands for it only when nothing larger does."""
    return one.kind in ODD and found.major.value_um < one.width_um / 2


def _touches(one: Planted, found: Defect) -> bool:
    xa, ya, xb, yb = found.outline.bounds_um
    nearest = np.clip(one.x_um, xa, xb), np.clip(one.y_um, ya, yb)
    return one.holds(float(nearest[0]), float(nearest[1]), 2 * ROOM_UM) or one.holds(
        found.center.x_um, found.center.y_um, 2 * ROOM_UM
    )


@dataclass(frozen=True, slots=True)
class Rate:
    """So many of so many, with the limits of Clopper and Pearson (two-sided, 95 %)."""

    hits: int
    of: int

    @property
    def share(self) -> float:
        """The rate; NaN of nothing."""
        return self.hits / self.of if self.of else float("nan")

    @property
    def low(self) -> float:
        """The least true rate that the count agrees with."""
        return float(beta.ppf(0.025, self.hits, self.of - self.hits + 1)) if self.hits else 0.0

    @property
    def high(self) -> float:
        """The greatest true rate that the count agrees with."""
        return float(beta.ppf(0.975, self.hits + 1, self.of - self.hits)) if self.hits < self.of else 1.0


def capture(matches: Sequence[Matched], wanted: Callable[[Planted], bool]) -> Rate:
    """How many of the planted defects that are wanted were found."""
    hits = sum(wanted(one) for matched in matches for one, _ in matched.pairs)
    return Rate(hits, hits + sum(wanted(one) for matched in matches for one in matched.missed))


def false_limit_per_mm2(count: int, area_mm2: float) -> float:
    """The upper limit (95 %, one-sided, Poisson) of a false count a mm2."""
    return float(chi2.ppf(0.95, 2 * (count + 1)) / 2 / area_mm2)


def plain(one: Planted) -> bool:
    """6 sigma and 6 px or more: what the goal is set for; edge chips are as deep as the street."""
    return one.kind not in ODD and one.height_sigma >= 6


def faint(one: Planted) -> bool:
    """3 sigma and 20 px or more."""
    return one.kind not in ODD and one.height_sigma >= 3 and one.diameter_px >= 20
