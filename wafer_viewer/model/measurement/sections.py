"""Sections of a surface: the lines requested, by position or by row or column number, and their curves."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from pathlib import PurePath
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import Profile, ProfileCurve
from wafer_viewer.model.measurement.tool_options import Levelling
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import LAYER_TITLES, Outline

MOST_LINES = 4
"""Largest number of simultaneous sections: as many as have clearly distinct colours."""
LETTERS = "ABCD"
_SAME_UM = 1e-6
Along = Literal["row", "column"]


@dataclass(frozen=True, slots=True)
class Gap:
    """Difference between two cursors: along the line, in height, and the angle of the line between them.

    at_um: distances of the cursors along the line, on measured points.
    """

    at_um: tuple[float, float]
    dx_um: float
    dz_um: float

    @property
    def angle_deg(self) -> float:
        """Angle, positive if the surface rises from the left cursor to the right one; NaN if both are at one point."""
        return (
            math.degrees(math.atan2(self.dz_um * math.copysign(1, self.dx_um), abs(self.dx_um)))
            if self.dx_um
            else math.nan
        )


def row_line(outline: Outline, row: int, width_um: float = 0.0) -> Region:
    """Return the line through all pixel centres of a row, from left to right. Row 0 is the top edge.

    Raises MeasureError if there is no such row.
    """
    y_um = outline.y0_um - _within(row, outline.shape[0], "row") * outline.pixel_um
    return Region.line(outline.x0_um, y_um, _far_x_um(outline), y_um, width_um)


def column_line(outline: Outline, column: int, width_um: float = 0.0) -> Region:
    """Return the line through all pixel centres of a column, from the top down. Column 0 is the left edge.

    Raises MeasureError if there is no such column.
    """
    x_um = outline.x0_um + _within(column, outline.shape[1], "column") * outline.pixel_um
    return Region.line(x_um, outline.y0_um, x_um, _far_y_um(outline), width_um)


def numbered(outline: Outline, along: Along, number: int, width_um: float = 0.0) -> Region:
    """Return the line along a row or a column."""
    return (row_line if along == "row" else column_line)(outline, number, width_um)


def nearest(outline: Outline, along: Along, x_um: float, y_um: float) -> int:
    """Return the number of the row or column nearest to a position."""
    offset_um = (outline.y0_um - y_um) if along == "row" else (x_um - outline.x0_um)
    return min(max(round(offset_um / outline.pixel_um), 0), outline.shape[along == "column"] - 1)


def perpendicular_line(line: Region, outline: Outline) -> Region:
    """Return the perpendicular bisector of a line with the same length and width, shortened to fit on the surface.

    A polyline counts as the line between its ends.
    """
    (xa, ya), (xb, yb) = _ends(line)
    x, y, dx, dy = (xa + xb) / 2, (ya + yb) / 2, (xb - xa) / 2, (yb - ya) / 2
    coordinator = *_room(x, -dy, outline.x0_um, _far_x_um(outline)), *_room(y, dx, _far_y_um(outline), outline.y0_um)
    u, v = (round(half * min((1.0, *coordinator)), 2) for half in (dx, dy))
    return Region.line(x - v, y + u, x + v, y - u, line.width_um)


def parallel_line(line: Region, outline: Outline) -> Region:
    """Return a parallel line, offset by a sixth of the line's length to a side that fits on the surface."""
    (xa, ya), (xb, yb) = _ends(line)
    u, v = (xb - xa) / 6, (yb - ya) / 6
    lines = [Region.line(xa - k * v, ya + k * u, xb - k * v, yb + k * u, line.width_um) for k in (1, -1)]
    return next((candidate for candidate in lines if _holds(outline, candidate)), _clipped(outline, lines[0]))


def middle(line: Region) -> tuple[float, float]:
    """Return the midpoint of a line, or of the ends of a polyline."""
    (xa, ya), (xb, yb) = _ends(line)
    return (xa + xb) / 2, (ya + yb) / 2


def _ends(line: Region) -> tuple[tuple[float, float], tuple[float, float]]:
    first, last = line.points[0], line.points[-1]
    return (first.x_um, first.y_um), (last.x_um, last.y_um)


def with_corner(line: Region) -> Region:
    """Return a path with a corner more, in the middle of its longest leg."""
    places = [(p.x_um, p.y_um) for p in line.points]
    legs_um = list(itertools.starmap(math.dist, itertools.pairwise(places)))
    longest = legs_um.index(max(legs_um))
    (xa, ya), (xb, yb) = places[longest : longest + 2]
    corner = (xa + xb) / 2, (ya + yb) / 2
    return Region.polyline(*places[: longest + 1], corner, *places[longest + 1 :], width_um=line.width_um)


def without_corner(line: Region) -> Region:
    """Return a path without the corner at which it is the least bent; a straight line without its last corner.

    A straight line is returned as it is.
    """
    places = [(p.x_um, p.y_um) for p in line.points]
    if len(places) < 3:
        return line
    detours_um = [
        math.dist(a, b) + math.dist(b, c) - math.dist(a, c)
        for a, b, c in zip(places[:-2], places[1:-1], places[2:], strict=True)
    ]
    least = 1 + detours_um.index(min(detours_um))
    kept = places[:least] + places[least + 1 :]
    if len(kept) == 2:
        return Region.line(*kept[0], *kept[1], line.width_um)
    return Region.polyline(*kept, width_um=line.width_um)


def cursor_difference(curve: ProfileCurve, shares: tuple[float, float]) -> Gap:
    """Return the readings of two cursors, each on the measured point nearest to its share (0 ... 1) of the length.

    Raises MeasureError for a curve without a measured point.
    """
    known = _measured(curve)
    wanted = np.array(shares)[:, None] * curve.distance_um[-1]
    first, second = known[np.abs(curve.distance_um[known] - wanted).argmin(axis=1)]
    at_um = float(curve.distance_um[first]), float(curve.distance_um[second])
    return Gap(at_um, at_um[1] - at_um[0], float(curve.z_um[second] - curve.z_um[first]))


def next_measured(curve: ProfileCurve, from_um: float, forward: bool) -> float:
    """Return the distance of the next measured point in a direction, or `from_um` if there is none.

    Raises MeasureError for a curve without a measured point.
    """
    places = curve.distance_um[_measured(curve)]
    beyond = places[places > from_um + _SAME_UM] if forward else places[places < from_um - _SAME_UM][::-1]
    return float(beyond[0]) if beyond.size else from_um


def _measured(curve: ProfileCurve) -> NDArray[np.intp]:
    known = np.flatnonzero(np.isfinite(curve.z_um))
    if known.size == 0:
        raise MeasureError("The curve has no measured point for a cursor to stand on: move the line.")
    return known


def _within(number: int, count: int, what: str) -> int:
    if not 0 <= number < count:
        raise MeasureError(f"There is no {what} {number}: the surface has the {what}s 0 to {count - 1}.")
    return number


def _far_x_um(outline: Outline) -> float:
    return outline.x0_um + (outline.shape[1] - 1) * outline.pixel_um


def _far_y_um(outline: Outline) -> float:
    return outline.y0_um - (outline.shape[0] - 1) * outline.pixel_um


def _holds(outline: Outline, line: Region) -> bool:
    x0, y0, x1, y1 = line.bounds_um
    return outline.x0_um <= x0 and x1 <= _far_x_um(outline) and _far_y_um(outline) <= y0 and y1 <= outline.y0_um


def _clipped(outline: Outline, line: Region) -> Region:
    """Return a line with its ends clipped to the surface."""
    ends = (
        (min(max(p.x_um, outline.x0_um), _far_x_um(outline)), min(max(p.y_um, _far_y_um(outline)), outline.y0_um))
        for p in line.points
    )
    (xa, ya), (xb, yb) = ends
    return Region.line(xa, ya, xb, yb, line.width_um)


def _room(position: float, half: float, low: float, high: float) -> tuple[float, ...]:
    """Return the free length to both sides of a line's midpoint, as a fraction of half its length."""
    return (max(0.0, min(position - low, high - position)) / abs(half),) if half else ()


@dataclass(frozen=True, slots=True)
class OtherSurface:
    """Another stitched surface for comparison: a result of this or another dataset's folder."""

    folder: str
    result: str

    @property
    def title(self) -> str:
        """Title: the dataset, and the result unless it is the default one."""
        name = PurePath(self.folder).stem
        return name if self.result == "default" else f"{name} · {self.result}"


@dataclass(frozen=True, slots=True, eq=False)
class SlabPoints:
    """Measured points of a slab: distance along it and height in um, float32 [n].

    width_um: of the slab; spread_um: distance from the running median that contains 68 % of the points.
    """

    distance_um: NDArray[np.float32]
    z_um: NDArray[np.float32]
    width_um: float
    spread_um: float

    def __len__(self) -> int:
        return len(self.z_um)


@dataclass(frozen=True, slots=True)
class SectionRequest:
    """A requested curve: its line, surface and levelling.

    place: index of the line, 0 is A; show: 0 for the stitched surface, else a field; cleaned: whichever of measured and
    filtered heights is not used for measuring; of: another surface instead; slab: points of the slab along the line and
    their running median, instead of the mean across the line.
    """

    place: int
    line: Region
    show: int = 0
    levelling: Levelling = Levelling()
    cleaned: bool = False
    of: OtherSurface | None = None
    slab: bool = False

    @property
    def letter(self) -> str:
        """Letter of the line."""
        return LETTERS[self.place]

    @property
    def is_second(self) -> bool:
        """True if it is drawn over the line's own curve for comparison."""
        return self.cleaned or self.of is not None


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """A section: curve, numbers and source, the names of the dataset and its part.

    points: of the slab whose running median the curve is; None for a mean across the line.
    """

    asked: SectionRequest
    profile: Profile
    curve: ProfileCurve
    source: str
    points: SlabPoints | None = None

    @property
    def title(self) -> str:
        """Distinguishing title: ``A``, ``A filled``, ``A coupon-08``."""
        if self.asked.of is not None:
            return f"{self.asked.letter} {self.asked.of.title}"
        return f"{self.asked.letter} {LAYER_TITLES[self.profile.surface]}" if self.asked.cleaned else self.asked.letter
