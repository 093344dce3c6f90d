"""Kerf width between its two edges in the image: mean, narrowest and widest."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from wafer_viewer.measure.base.correlated_errors import Scatter
from wafer_viewer.measure.base.height_samples import Floats, Layer
from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.base.robust_fit import angle_between_lines
from wafer_viewer.measure.edges.edge_search import (
    EDGE_FILTER,
    EdgeScores,
    SearchStrip,
    Sign,
    angle,
    between_edges,
    notes,
    read_strip,
    require_rectangle,
    scores_of,
    sum_of_independent,
)
from wafer_viewer.measure.edges.straight_edges import AS_STRONG, Found, fitted, no_edge
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import KerfWidth
from wafer_viewer.model.measurement.tool_options import KerfOptions
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import require_choice
from wafer_viewer.model.surface.height_map import Mosaic
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA

NEIGHBOURS = 5
"""Number of neighbouring search lines of the median for the narrowest and the widest place."""
U_OF_MEDIAN = 0.54
"""Ratio of the standard deviation of the median of five to that of one."""
LEAST_APART_PX = 2 * EDGE_FILTER.reach_px
"""Smallest distance of edges; closer edges shift each other."""
Kerf = Literal["either", "bright", "dark"]
SIGNS: dict[Kerf, tuple[Sign, ...]] = {"either": (1, -1), "bright": (1,), "dark": (-1,)}
"""Signs of the brightness change at the first edge."""
EXTREMES = f"Narrowest and widest are medians of {NEIGHBOURS} neighbouring search lines; noise draws them apart."


@dataclass(frozen=True, slots=True, eq=False)
class KerfEdges:
    """The two edges of a kerf, in search order, and its width on each line that detects both."""

    first: Found
    second: Found
    widths_um: Floats

    @property
    def width_um(self) -> float:
        """Distance of the lines, at the centre of their points."""
        return sum(abs(float(edge.line.off(*self._middle))) for edge in (self.first, self.second))

    @property
    def u_um(self) -> Scatter | None:
        """Uncertainty of the width from the scatter of both edges' points; None if unknown."""
        lines = (self.first.line, self.second.line)
        return sum_of_independent(*(line.u_um(float(line.along(*self._middle))) for line in lines))

    @property
    def angle_deg(self) -> float:
        """Angle between the lines."""
        return angle_between_lines(self.first.line, self.second.line)

    @property
    def u_extreme_um(self) -> float:
        """Standard uncertainty of the median of neighbouring widths, from differences between neighbours."""
        steps = np.diff(self.widths_um)
        return U_OF_MEDIAN * MAD_TO_SIGMA * float(np.median(np.abs(steps - np.median(steps)))) / math.sqrt(2)

    @property
    def extremes_um(self) -> tuple[float, float]:
        """Narrowest and widest local width."""
        near = np.median(np.lib.stride_tricks.sliding_window_view(self.widths_um, NEIGHBOURS), axis=1)
        return float(near.min()), float(near.max())

    @property
    def _middle(self) -> tuple[float, float]:
        first, second = self.first.line, self.second.line
        return (first.x_um + second.x_um) / 2, (first.y_um + second.y_um) / 2


def kerf_width(
    surface: Mosaic,
    region: Region,
    *,
    kerf: Kerf = "either",
    calibration_valid: bool = True,
    layer: Layer | None = None,
    name: str = "",
) -> KerfWidth:
    """Measure the width of the kerf in a region and its edges' angle.

    The edges are detected in the all-in-focus image. The kerf may run along either side of the region.

    Parameters
    ----------
    surface : Mosaic
        Height map or mosaic to measure; regions are in its stage coordinates, um.
    region : Region
        Rectangle across one kerf, in stage um.
    kerf : {'either', 'bright', 'dark'}, optional
        Brightness of the kerf relative to its surroundings. Default 'either'.
    calibration_valid : bool, optional
        Whether the calibration of the surface is valid. Default True. Where it is False, or the surface has no
        calibration, results have status 'uncalibrated' and no uncertainty.
    layer : {'unsmoothed', 'smoothed', 'filled'}, optional
        Height layer that the result names; edges are detected in the image. Default None: the layer on which
        the recipe of the surface measures.
    name : str, optional
        Name of the result. Default ''.

    Returns
    -------
    KerfWidth
        Width between the lines through the edges, and narrowest and widest local width, in um, and angle between the
        edges in degrees (0 if parallel), with expanded uncertainties (k = 2).

    Raises
    ------
    MeasureError
        If the region is no rectangle, lies outside the surface, is smaller than 16 pixels either way, or has less than
        half of its area on the image.
    MeasureError
        If no pair of edges stands out, or more than one does.
    MeasureError
        If fewer than half of the search lines detect an edge, or fewer than ten detect both.

    Notes
    -----
    The width is the distance of the lines at the centre of their points. Narrowest and widest are medians of five
    neighbouring search lines; noise draws them apart.
    """
    require_choice("kerf", kerf, Kerf, MeasureError)
    require_rectangle(region, "A kerf width")
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    strip, level = read_strip(surface, region, "a kerf width")
    edges = kerf_edges(strip, SIGNS[kerf])
    lowest, highest = edges.extremes_um
    u_angle = sum_of_independent(edges.first.line.u_angle_deg, edges.second.line.u_angle_deg)
    return KerfWidth(
        **reading.result_fields(name, level, *notes(reading, EXTREMES)),
        region=region,
        options=KerfOptions(kerf=kerf),
        width=between_edges(reading, edges.width_um, strip.pixel_um, edges.u_um),
        narrowest=between_edges(reading, lowest, strip.pixel_um, edges.u_extreme_um),
        widest=between_edges(reading, highest, strip.pixel_um, edges.u_extreme_um),
        angle=angle(reading, edges.angle_deg, u_angle),
        kerf="bright" if edges.first.sign > 0 else "dark",
        first=edges.first.line.region,
        second=edges.second.line.region,
        points=len(edges.first.points) + len(edges.second.points),
    )


def kerf_edges(strip: SearchStrip, signs: tuple[Sign, ...] = (1, -1)) -> KerfEdges:
    """Find the two edges of the kerf in a strip, in either direction. Raises MeasureError where there is no pair."""
    directions = [_SearchDirection.of(one, sign) for one in (strip, strip.turned) for sign in signs]
    best = max(directions, key=lambda direction: direction.strength)
    best.require_clear()
    return best.edges()


@dataclass(frozen=True, slots=True, eq=False)
class _SearchDirection:
    """The strongest pair of edges of opposite signs along the search lines of a strip."""

    strip: SearchStrip
    sign: Sign
    scores: tuple[EdgeScores, EdgeScores]
    places: tuple[int, int]
    strength: float

    @classmethod
    def of(cls, strip: SearchStrip, sign: Sign) -> _SearchDirection:
        scores = scores_of(strip, sign), scores_of(strip, 1 if sign < 0 else -1)
        places, strength = _strongest_pair(*scores)
        return cls(strip, sign, scores, places, strength)

    def require_clear(self) -> None:
        first, second = self.places
        if not all(s.stands_out(p) for s, p in zip(self.scores, self.places, strict=True)) or not self.strength:
            raise no_edge("on both sides of a kerf in the region")
        before = self.scores[0].strongest_other(first, up_to=second) / self.scores[0].best[first]
        behind = self.scores[1].strongest_other(second, after=first) / self.scores[1].best[second]
        if (rival := max(before, behind)) > AS_STRONG:
            raise MeasureError(
                f"More than one kerf may be meant, because another edge has {100 * rival:.0f} % of the strength of the "
                "one beside the kerf: draw the region narrower, across one kerf."
            )

    def edges(self) -> KerfEdges:
        other: Sign = 1 if self.sign < 0 else -1
        signs: tuple[Sign, Sign] = (self.sign, other)
        first, second = (
            fitted(self.strip, sign, scores, place)
            for sign, scores, place in zip(signs, self.scores, self.places, strict=True)
        )
        return KerfEdges(first, second, _widths_um(self.strip, first, second))


def _strongest_pair(first: EdgeScores, second: EdgeScores) -> tuple[tuple[int, int], float]:
    """Return the places of the first and a later second edge with the largest geometric mean, and that mean."""
    apart = LEAST_APART_PX
    if len(first.best) <= apart:
        return (0, 0), 0.0
    before = np.maximum.accumulate(first.best[:-apart])
    strength = np.maximum(before, 0) * np.maximum(second.best[apart:], 0)
    last = int(np.argmax(strength))
    return (int(np.argmax(first.best[: last + 1])), last + apart), math.sqrt(float(strength[last]))


def _widths_um(strip: SearchStrip, first: Found, second: Found) -> Floats:
    """Return the width normal to the kerf on each line that detects both edges."""
    _, one, two = np.intersect1d(first.points.line, second.points.line, return_indices=True)
    if len(one) < 2 * NEIGHBOURS:
        raise MeasureError(
            f"Both edges of the kerf are seen on {len(one)} search lines and its width needs {2 * NEIGHBOURS}: "
            "draw the region longer."
        )
    places = second.points.place[two] - first.points.place[one]
    direction = np.add(first.line.direction, second.line.direction)
    slant = np.hypot(*direction) * strip.pixel_um
    return places * strip.pixel_um * abs(direction[0] * strip.place_um[1] - direction[1] * strip.place_um[0]) / slant
