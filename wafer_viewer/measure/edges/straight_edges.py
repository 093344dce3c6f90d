"""Straight edges in a strip, and the four edges of a die. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wafer_viewer.measure.base.correlated_errors import Scatter
from wafer_viewer.measure.base.height_samples import Floats
from wafer_viewer.measure.base.robust_fit import EdgeLine, crossing, fit_line, robust_fit
from wafer_viewer.measure.edges.edge_search import (
    STRAIGHT_EDGE,
    EdgePoints,
    EdgeScores,
    Responses,
    SearchStrip,
    Sign,
    edges_near,
    responses,
    scores_of,
    sum_of_independent,
)
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import Side

AS_STRONG = 0.8
"""Strength relative to the strongest edge from which another one makes the result ambiguous."""
REACH_PX = 8.0
"""Distance from the initial straight line within which an edge is followed."""
LEAST_FOUND = 0.5
"""Smallest fraction of the search lines on which an edge is detected."""

LEAST_LINES = 8
"""Smallest number of search lines on which an edge is detected."""


def edge_points(response: Responses, sign: Sign, scores: EdgeScores, place: int) -> EdgePoints:
    """Return the points of the edge through a place of the middle line. Raises MeasureError with too few."""
    expected, rising = scores.expected(place), sign * response
    found = edges_near(rising, expected, (REACH_PX, REACH_PX))
    require_found(found, len(response))
    slope, first = robust_fit(np.stack([found.line, np.ones(len(found))], axis=1), found.place).coefficients.tolist()
    found = edges_near(rising, first + slope * np.arange(len(response)), (REACH_PX, REACH_PX))
    require_found(found, len(response))
    return found


def require_found(found: EdgePoints, n_lines: int) -> None:
    """Raise MeasureError when an edge is detected on less than half of the search lines."""
    if len(found) < max(LEAST_FOUND * n_lines, LEAST_LINES):
        raise MeasureError(
            f"The edge is seen on {len(found)} of {n_lines} search lines and {100 * LEAST_FOUND:.0f} % are needed: "
            "draw the region so that the edge runs all through it."
        )


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """One straight edge of a strip: its sign along the search lines, its points in the strip, and the line."""

    sign: Sign
    points: EdgePoints
    line: EdgeLine


def no_edge(where: str) -> MeasureError:
    """Return the error for a missing edge."""
    return MeasureError(f"No edge stands out {where}: draw the region over one that the picture shows.")


def require_clear(scores: EdgeScores, place: int, where: str) -> None:
    """Raise MeasureError when nothing stands out at a place, or another edge is about as strong."""
    if not scores.stands_out(place):
        raise no_edge(where)
    if (rival := scores.strongest_other(place)) > AS_STRONG * scores.best[place]:
        share = 100 * rival / scores.best[place]
        raise MeasureError(
            f"Two edges {where} are about as strong, the second has {share:.0f} % of the first: "
            "draw the region narrower, or say which way its brightness goes."
        )


def fitted(strip: SearchStrip, sign: Sign, scores: EdgeScores, place: int) -> Found:
    """Return the edge through a place of the middle line: its points and a line fit."""
    points = edge_points(responses(strip.grey, strip.covered), sign, scores, place)
    return Found(sign, points, fit_line(*strip.at(points.line, points.place)))


def find_edge(strip: SearchStrip, where: str = "in the region", signs: tuple[Sign, ...] = (1, -1)) -> Found:
    """Find the strongest straight edge across the search lines of a strip.

    signs: allowed signs of the brightness change. Raises MeasureError where none stands out, another is about as
    strong, or too few search lines detect it.
    """
    by_sign = {sign: scores_of(strip, sign) for sign in signs}
    sign = max(signs, key=lambda s: by_sign[s].best.max())
    scores, place = by_sign[sign], by_sign[sign].top()
    require_clear(scores, place, where)
    if any(by_sign[s].best.max() > AS_STRONG * scores.best[place] for s in signs if s != sign):
        raise MeasureError(
            f"Two edges {where} are about as strong and brightness goes either way: "
            "draw the region over one of them, or say which way its brightness goes."
        )
    return fitted(strip, sign, scores, place)


def find_edge_in_any_direction(strip: SearchStrip) -> tuple[SearchStrip, Found]:
    """Find the strongest straight edge of a strip, upright or level, and the strip whose search lines cross it.

    Raises the same MeasureErrors as `find_edge`.
    """

    def strength(one: SearchStrip) -> float:
        return max(float(scores_of(one, sign).best.max()) for sign in (-1, 1))

    across = max((strip, strip.turned), key=strength)
    return across, find_edge(across)


def follow(strip: SearchStrip, sign: Sign, line: EdgeLine) -> Found:
    """Refine an approximately known edge on every search line of a strip.

    Raises MeasureError when too few search lines detect it.
    """
    rising = sign * responses(strip.grey, strip.covered)
    points = edges_near(rising, expected_on(strip, line), (REACH_PX, REACH_PX))
    require_found(points, len(rising))
    return Found(sign, points, fit_line(*strip.at(points.line, points.place)))


def expected_on(strip: SearchStrip, line: EdgeLine) -> Floats:
    """Return the crossings of a line with the search lines of a strip."""
    (x0, y0), (x1, y1) = line.at(0.0), line.at(1e3 * strip.pixel_um)
    lines, places = strip.where(np.array([x0, x1]), np.array([y0, y1]))
    slope = (places[1] - places[0]) / (lines[1] - lines[0])
    return places[0] + slope * (np.arange(len(strip.grey)) - lines[0])


SEARCHED = 0.45
"""Depth of the edge search from each side, relative to the region."""
FIRST_LINES = (0.3, 0.7)
"""Range of search lines of the first search, relative to the region, well apart from the corners."""
OUTERMOST = 0.6
"""Fraction of a side's strongest edge from which the outermost edge is taken as the die's."""
BOTH: tuple[Sign, ...] = (1, -1)
"""Signs of an edge along its search lines: to bright, and to dark."""
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

    def u_size_um(self, first: Side, second: Side) -> Scatter | None:
        """Return the uncertainty of the size from the scatter of the points; None if unknown."""
        lines = (self.lines[side] for side in (first, second))
        return sum_of_independent(*(line.u_um(float(line.along(*self.center))) for line in lines))

    @property
    def rotation_deg(self) -> float:
        """Rotation of the die, counter-clockwise: mean of its edges."""
        return (self._turn("left", "right", 90) + self._turn("lower", "upper", 0)) / 2

    @property
    def squareness_deg(self) -> float:
        """Deviation from 90 degrees of the angle from the lower and upper to the left and right edges."""
        return self._turn("left", "right", 90) - self._turn("lower", "upper", 0)

    @property
    def u_angle_deg(self) -> Scatter | None:
        """Uncertainty of the squareness; that of the rotation is half of it."""
        u = sum_of_independent(*(line.u_angle_deg for line in self.lines.values()))
        return None if u is None else u.times(1 / 2)

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
    outside = float(others.best[: max(0, place - STRAIGHT_EDGE.margin_px)].max(initial=0.0)) / float(scores.best[place])
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
