"""The four edges of a die on the picture, and what they make of it: size, place, turn, squareness. Pure, on arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wafer_viewer.measure.base.line_fit import EdgeLine, crossing
from wafer_viewer.measure.edges.edge_search import BESIDE_PX, EdgeScores, Sign, scores_of
from wafer_viewer.measure.edges.lateral_uncertainty import together
from wafer_viewer.measure.edges.search_strip import SearchStrip
from wafer_viewer.measure.edges.straight_edges import AS_STRONG, Found, fitted, follow, no_edge
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.edge_and_bump_shapes import Side

SEARCHED = 0.45
"""Of the way through the region: so far in each edge is looked for."""
FIRST_LINES = (0.3, 0.7)
"""Of the region: search lines between these are taken at first, well apart from the corners."""
OUTERMOST = 0.6
"""Of the strongest edge of a side: the first from outside that has as much is the die's."""
BOTH: tuple[Sign, ...] = (1, -1)
CORNER = 0.05
"""Of a side: so much at either end is left out, where corners are round."""
OPPOSITE: tuple[tuple[Side, Side], ...] = (("left", "right"), ("lower", "upper"))


@dataclass(frozen=True, slots=True, eq=False)
class DieEdges:
    """The edges of a die; those on the left and right run down, the others to the right."""

    left: Found
    right: Found
    lower: Found
    upper: Found

    @property
    def lines(self) -> dict[Side, EdgeLine]:
        """By side."""
        found: dict[Side, Found] = {"left": self.left, "right": self.right, "lower": self.lower, "upper": self.upper}
        return {side: edge.line for side, edge in found.items()}

    @property
    def corners(self) -> tuple[tuple[float, float], ...]:
        """Where the edges meet, counter-clockwise from the lower left. Raises MeasureError when they do not."""
        left, right, lower, upper = self.lines.values()
        return tuple(crossing(*pair) for pair in ((lower, left), (lower, right), (upper, right), (upper, left)))

    @property
    def center(self) -> tuple[float, float]:
        """The mean of the corners."""
        corners = self.corners
        return sum(x for x, _ in corners) / 4, sum(y for _, y in corners) / 4

    def size_um(self, first: Side, second: Side) -> float:
        """From one edge to the opposite one, through the centre."""
        return sum(abs(float(self.lines[side].off(*self.center))) for side in (first, second))

    def u_size_um(self, first: Side, second: Side) -> float | None:
        """Its standard uncertainty by the scatter of the points."""
        lines = (self.lines[side] for side in (first, second))
        return together(*(line.u_um(float(line.along(*self.center))) for line in lines))

    @property
    def rotation_deg(self) -> float:
        """How the die is turned, counter-clockwise: the mean of its edges."""
        return (self._turn("left", "right", 90) + self._turn("lower", "upper", 0)) / 2

    @property
    def squareness_deg(self) -> float:
        """What the angle from its lower and upper to its left and right edges is over 90 degrees."""
        return self._turn("left", "right", 90) - self._turn("lower", "upper", 0)

    @property
    def u_angle_deg(self) -> float | None:
        """Standard uncertainty of the squareness; that of the rotation is half of it."""
        u = together(*(line.u_angle_deg for line in self.lines.values()))
        return None if u is None else u / 2

    def _turn(self, first: Side, second: Side, upright_deg: float) -> float:
        return (self.lines[first].angle_deg + self.lines[second].angle_deg) / 2 + upright_deg


def die_edges(strip: SearchStrip, signs: tuple[Sign, ...] = (1, -1)) -> DieEdges:
    """The edges of the one die in a strip whose search lines run along x.

    signs: 1 for a die brighter than what is round it. Raises MeasureError where an edge does not stand out, another is
    about as strong, or it is seen on too few search lines.
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
    """The outer part of the strip at each side, its search lines from outside to inside."""
    across, down = strip, strip.turned
    outer: dict[Side, SearchStrip] = {"left": across, "right": across.reversed, "lower": down.reversed, "upper": down}
    return {side: one.part(slice(0, None), _share(one.grey.shape[1], 0, SEARCHED)) for side, one in outer.items()}


def _searched(side: SearchStrip) -> SearchStrip:
    return side.part(_share(len(side.grey), *FIRST_LINES), slice(0, None))


def _share(length: int, low: float, high: float) -> slice:
    return slice(round(low * length), round(high * length))


def _first(side: SearchStrip, name: Side, sign: Sign, scores: EdgeScores, others: EdgeScores) -> Found:
    """The outermost edge that is about as strong as the strongest: what is printed on a die lies further in."""
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
    """The search lines that cross the edge of a side, apart from those at its corners."""
    across = sorted(float(side.where(np.array(x), np.array(y))[0]) for x, y in corners)
    low, high = across[1], across[2]
    spare = CORNER * (high - low)
    last = len(side.grey) - 1
    return side.part(slice(max(0, math.ceil(low + spare)), min(last, math.floor(high - spare)) + 1), slice(0, None))
