"""Four edges of a die in the image: size, position, rotation, squareness. Pure, on arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wafer_viewer.measure.base.line_fit import EdgeLine, crossing
from wafer_viewer.measure.edges.edge_search import BESIDE_PX, EdgeScores, Sign, scores_of
from wafer_viewer.measure.edges.lateral_uncertainty import root_sum_of_squares
from wafer_viewer.measure.edges.search_strip import SearchStrip
from wafer_viewer.measure.edges.straight_edges import AS_STRONG, Found, fitted, follow, no_edge
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.edge_and_bump_shapes import Side

SEARCHED = 0.45
"""Depth of the edge search from each side, relative to the region."""
FIRST_LINES = (0.3, 0.7)
"""Range of search lines of the first search, relative to the region, well apart from the corners."""
OUTERMOST = 0.6
"""Fraction of a side's strongest edge from which the outermost edge is taken as the die's."""
BOTH: tuple[Sign, ...] = (1, -1)
CORNER = 0.05
"""Fraction of a side excluded at either end, where corners are round."""
OPPOSITE: tuple[tuple[Side, Side], ...] = (("left", "right"), ("lower", "upper"))


@dataclass(frozen=True, slots=True, eq=False)
class DieEdges:
    """The edges of a die; the left and right ones run down, the others to the right."""

    left: Found
    right: Found
    lower: Found
    upper: Found

    @property
    def lines(self) -> dict[Side, EdgeLine]:
        """Edge lines by side."""
        found: dict[Side, Found] = {"left": self.left, "right": self.right, "lower": self.lower, "upper": self.upper}
        return {side: edge.line for side, edge in found.items()}

    @property
    def corners(self) -> tuple[tuple[float, float], ...]:
        """Intersections of the edges, counter-clockwise from the lower left. Raises MeasureError if parallel."""
        left, right, lower, upper = self.lines.values()
        return tuple(crossing(*pair) for pair in ((lower, left), (lower, right), (upper, right), (upper, left)))

    @property
    def center(self) -> tuple[float, float]:
        """Mean of the corners."""
        corners = self.corners
        return sum(x for x, _ in corners) / 4, sum(y for _, y in corners) / 4

    def size_um(self, first: Side, second: Side) -> float:
        """Return the distance between opposite edges, through the centre."""
        return sum(abs(float(self.lines[side].off(*self.center))) for side in (first, second))

    def u_size_um(self, first: Side, second: Side) -> float | None:
        """Return the standard uncertainty of the size from the scatter of the points; None if unknown."""
        lines = (self.lines[side] for side in (first, second))
        return root_sum_of_squares(*(line.u_um(float(line.along(*self.center))) for line in lines))

    @property
    def rotation_deg(self) -> float:
        """Rotation of the die, counter-clockwise: mean of its edges."""
        return (self._turn("left", "right", 90) + self._turn("lower", "upper", 0)) / 2

    @property
    def squareness_deg(self) -> float:
        """Deviation from 90 degrees of the angle from the lower and upper to the left and right edges."""
        return self._turn("left", "right", 90) - self._turn("lower", "upper", 0)

    @property
    def u_angle_deg(self) -> float | None:
        """Standard uncertainty of the squareness; that of the rotation is half of it."""
        u = root_sum_of_squares(*(line.u_angle_deg for line in self.lines.values()))
        return None if u is None else u / 2

    def _turn(self, first: Side, second: Side, upright_deg: float) -> float:
        return (self.lines[first].angle_deg + self.lines[second].angle_deg) / 2 + upright_deg


def die_edges(strip: SearchStrip, signs: tuple[Sign, ...] = (1, -1)) -> DieEdges:
    """Find the edges of the single die in a strip with search lines along x.

    signs: 1 for a die brighter than its surroundings. Raises MeasureError where an edge does not stand out, another is
    about as strong, or it is detected on too few search lines.
    """
    sides = _sides(strip)
    scores = {sign: {side: scores_of(_searched(one), sign) for side, one in sides.items()} for sign in BOTH}
    sign = max(signs, key=lambda s: min(found.best.max() for found in scores[s].values()))
    other: Sign = 1 if sign < 0 else -1
    first = {
        side: _first(_searched(one), side, sign, scores[sign][side], scores[other][side]) for side, one in sides.items()
    }
    corners = DieEdges(**first).corners
    return DieEdges(**{side: follow(_between(one, corners), sign, first[side].line) for side, one in sides.items()})


def _sides(strip: SearchStrip) -> dict[Side, SearchStrip]:
    """Return the outer part of the strip at each side, with search lines from outside to inside."""
    across, down = strip, strip.turned
    outer: dict[Side, SearchStrip] = {"left": across, "right": across.reversed, "lower": down.reversed, "upper": down}
    return {side: one.part(slice(0, None), _share(one.grey.shape[1], 0, SEARCHED)) for side, one in outer.items()}


def _searched(side: SearchStrip) -> SearchStrip:
    return side.part(_share(len(side.grey), *FIRST_LINES), slice(0, None))


def _share(length: int, low: float, high: float) -> slice:
    return slice(round(low * length), round(high * length))


def _first(side: SearchStrip, name: Side, sign: Sign, scores: EdgeScores, others: EdgeScores) -> Found:
    """Return the outermost edge about as strong as the strongest; the die's pattern lies further in."""
    place, where = scores.first(OUTERMOST), f"on the {name} side of the region"
    if not scores.stands_out(place, only_before=True):
        raise no_edge(where)
    outside = float(others.best[: max(0, place - BESIDE_PX)].max(initial=0.0)) / float(scores.best[place])
    if outside > AS_STRONG:
        raise MeasureError(
            f"Two edges {where} may be the die's, because further out the brightness changes the other way with "
            f"{100 * outside:.0f} % of the strength: draw the region nearer round one die, or say whether it is bright."
        )
    return fitted(side, sign, scores, place)


def _between(side: SearchStrip, corners: tuple[tuple[float, float], ...]) -> SearchStrip:
    """Return the search lines that cross the edge of a side, except those at its corners."""
    across = sorted(float(side.where(np.array(x), np.array(y))[0]) for x, y in corners)
    low, high = across[1], across[2]
    spare = CORNER * (high - low)
    last = len(side.grey) - 1
    return side.part(slice(max(0, math.ceil(low + spare)), min(last, math.floor(high - spare)) + 1), slice(0, None))
