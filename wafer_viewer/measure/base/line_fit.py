"""Straight-line fits through edge points, in stage um, with their uncertainty. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wafer_viewer.measure.base.chain_statistics import chain_uncertainty
from wafer_viewer.measure.base.height_samples import Floats
from wafer_viewer.measure.base.robust_plane import robust_fit
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region

_TURNS = 3


@dataclass(frozen=True, slots=True, eq=False)
class EdgeLine:
    """A straight edge in stage um: centroid of its points, direction, and the points accepted by the fit.

    along_um, off_um: coordinates of each point along the line from the centroid, and to the left of the line.
    """

    x_um: float
    y_um: float
    direction: tuple[float, float]
    along_um: Floats
    off_um: Floats

    @property
    def normal(self) -> tuple[float, float]:
        """Unit normal, to the left of the direction."""
        return -self.direction[1], self.direction[0]

    @property
    def angle_deg(self) -> float:
        """Angle of the direction, counter-clockwise from x."""
        return math.degrees(math.atan2(self.direction[1], self.direction[0]))

    def off(self, x_um: Floats | float, y_um: Floats | float) -> Floats | float:
        """Return the signed distance of places to the left of the line."""
        return (x_um - self.x_um) * self.normal[0] + (y_um - self.y_um) * self.normal[1]

    def along(self, x_um: Floats | float, y_um: Floats | float) -> Floats | float:
        """Return the coordinate of places along the line, from its centroid."""
        return (x_um - self.x_um) * self.direction[0] + (y_um - self.y_um) * self.direction[1]

    def at(self, along_um: float) -> tuple[float, float]:
        """Return the place at a coordinate along the line."""
        return self.x_um + along_um * self.direction[0], self.y_um + along_um * self.direction[1]

    def u_um(self, along_um: float = 0.0) -> float | None:
        """Standard uncertainty of the line's lateral position there, by its residuals; None with too few points."""
        return chain_uncertainty(self._design, self.off_um, np.array([along_um, 1.0]))

    @property
    def u_angle_deg(self) -> float | None:
        """Standard uncertainty of the angle; None with too few points."""
        u = chain_uncertainty(self._design, self.off_um, np.array([1.0, 0.0]))
        return None if u is None else math.degrees(u)

    @property
    def region(self) -> Region:
        """Line region from the first point to the last."""
        ends = (self.at(float(along)) for along in (self.along_um.min(), self.along_um.max()))
        return Region.line(*(round(v, 3) for end in ends for v in end))

    @property
    def _design(self) -> Floats:
        return np.stack([self.along_um, np.ones(len(self.along_um))], axis=1)


def fit_line(x_um: Floats, y_um: Floats) -> EdgeLine:
    """Fit a total least-squares line through ordered points, with rejection beyond 3 robust deviations.

    Raises MeasureError when the points do not determine a line.
    """
    along = _principal(x_um, y_um)
    middle, kept = (float(x_um.mean()), float(y_um.mean())), np.ones(len(x_um), bool)
    for _ in range(_TURNS):
        ahead, left = _turned(x_um, y_um, middle, along)
        fit = robust_fit(np.stack([ahead, np.ones(len(ahead))], axis=1), left)
        turn, kept = math.atan(float(fit.coefficients[0])), fit.kept
        along = _rotated(along, turn)
        middle = float(x_um[kept].mean()), float(y_um[kept].mean())
    ahead, left = _turned(x_um[kept], y_um[kept], middle, along)
    return EdgeLine(*middle, along, ahead, left)


def _principal(x_um: Floats, y_um: Floats) -> tuple[float, float]:
    """Return the direction of largest variance of points, oriented from the first point to the last."""
    offsets = np.stack([x_um - x_um.mean(), y_um - y_um.mean()])
    way = np.linalg.eigh(offsets @ offsets.T)[1][:, 1]
    ends = x_um[-1] - x_um[0], y_um[-1] - y_um[0]
    way = way if way @ np.array(ends) >= 0 else -way
    return float(way[0]), float(way[1])


def _turned(x_um: Floats, y_um: Floats, middle: tuple[float, float], along: tuple[float, float]) -> tuple[Floats, ...]:
    x, y = x_um - middle[0], y_um - middle[1]
    return x * along[0] + y * along[1], y * along[0] - x * along[1]


def _rotated(way: tuple[float, float], angle: float) -> tuple[float, float]:
    cos, sin = math.cos(angle), math.sin(angle)
    return way[0] * cos - way[1] * sin, way[0] * sin + way[1] * cos


def angle_between_lines(first: EdgeLine, second: EdgeLine) -> float:
    """Return the angle between two lines, degrees, 0 to 90, regardless of their orientation."""
    cross = first.direction[0] * second.direction[1] - first.direction[1] * second.direction[0]
    dot = first.direction[0] * second.direction[0] + first.direction[1] * second.direction[1]
    return math.degrees(math.atan2(abs(cross), abs(dot)))


def crossing(first: EdgeLine, second: EdgeLine) -> tuple[float, float]:
    """Return the intersection of two lines. Raises MeasureError when they are parallel."""
    cross = first.direction[0] * second.direction[1] - first.direction[1] * second.direction[0]
    if abs(cross) < 1e-6:
        raise MeasureError("Two edges of the die run side by side: draw the region round one die.")
    way = second.x_um - first.x_um, second.y_um - first.y_um
    return first.at((way[0] * second.direction[1] - way[1] * second.direction[0]) / cross)
