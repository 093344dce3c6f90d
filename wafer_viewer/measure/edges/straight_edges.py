"""Straight edges in a strip: detection, tracking across search lines, line fit. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wafer_viewer.measure.base.height_samples import Floats
from wafer_viewer.measure.base.line_fit import EdgeLine, fit_line
from wafer_viewer.measure.base.robust_plane import robust_fit
from wafer_viewer.measure.edges.edge_search import EdgeScores, Sign, scores_of
from wafer_viewer.measure.edges.search_strip import SearchStrip
from wafer_viewer.measure.edges.subpixel_edges import EdgePoints, Responses, edges_near, responses
from wafer_viewer.model.errors import MeasureError

AS_STRONG = 0.8
"""Strength relative to the strongest edge from which another one makes the result ambiguous."""
REACH_PX = 8.0
"""Distance from the initial straight line within which an edge is followed."""
LEAST_FOUND = 0.5
"""Smallest fraction of the search lines on which an edge is detected."""


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
    if len(found) < max(LEAST_FOUND * n_lines, 8):
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
    points = edge_points(responses(strip.grey, strip.there), sign, scores, place)
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


def find_edge_any_way(strip: SearchStrip) -> tuple[SearchStrip, Found]:
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
    rising = sign * responses(strip.grey, strip.there)
    points = edges_near(rising, expected_on(strip, line), (REACH_PX, REACH_PX))
    require_found(points, len(rising))
    return Found(sign, points, fit_line(*strip.at(points.line, points.place)))


def expected_on(strip: SearchStrip, line: EdgeLine) -> Floats:
    """Return the crossings of a line with the search lines of a strip."""
    (x0, y0), (x1, y1) = line.at(0.0), line.at(1e3 * strip.pixel_um)
    lines, places = strip.where(np.array([x0, x1]), np.array([y0, y1]))
    slope = (places[1] - places[0]) / (lines[1] - lines[0])
    return places[0] + slope * (np.arange(len(strip.grey)) - lines[0])
