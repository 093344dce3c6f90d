"""Outline, handles and drag behaviour of each kind of region. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.gui.scene.heightfield import HeightField, Place
from wafer_viewer.model.region import Region, RegionKind

Corners = NDArray[np.float64]
"""[n, 2] in stage um, in order around the region."""
LEAST_PX = 4
"""Smallest size of a region in pixels of the surface."""
CENTRE = "whole"
"""Name of the handle that moves a region without changing its shape."""
_ROUND = np.linspace(0, 2 * np.pi, 72, endpoint=False)


@dataclass(frozen=True, slots=True)
class Shape:
    """Geometry functions of one kind of region.

    outline: corners; empty for a point.
    holds: positions of the handles by name.
    pulled: the region after a handle was moved.
    """

    outline: Callable[[Region], Corners]
    holds: Callable[[Region], dict[str, Place]]
    pulled: Callable[[Region, str, Place, HeightField], Region]


def _point_holds(region: Region) -> dict[str, Place]:
    return {CENTRE: (region.points[0].x_um, region.points[0].y_um)}


def _point_pulled(region: Region, hold: str, to: Place, height_field: HeightField) -> Region:
    return Region.point(*height_field.clamped(to))


def _corners(region: Region) -> Corners:
    x0, y0, x1, y1 = region.bounds_um
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], float)


def _rectangle_holds(region: Region) -> dict[str, Place]:
    x0, y0, x1, y1 = region.bounds_um
    corners = {str(k): (float(x), float(y)) for k, (x, y) in enumerate(_corners(region))}
    return {**corners, CENTRE: ((x0 + x1) / 2, (y0 + y1) / 2)}


def _rectangle_pulled(region: Region, hold: str, to: Place, height_field: HeightField) -> Region:
    x0, y0, x1, y1 = region.bounds_um
    if hold == CENTRE:
        half = (x1 - x0) / 2, (y1 - y0) / 2
        x, y = _clamped_inside(to, half, height_field)
        return _rectangle(x - half[0], y - half[1], x + half[0], y + half[1])
    least, k = LEAST_PX * height_field.on_show.facts.pixel_um, int(hold)
    x0, x1 = (min(to[0], x1 - least), x1) if k in (0, 3) else (x0, max(to[0], x0 + least))
    y0, y1 = (min(to[1], y1 - least), y1) if k in (0, 1) else (y0, max(to[1], y0 + least))
    return _rectangle(x0, y0, x1, y1)


def _round_outline(region: Region) -> Corners:
    center, r = region.points[0], region.radius_um
    return np.stack([center.x_um + r * np.cos(_ROUND), center.y_um + r * np.sin(_ROUND)], axis=1)


def _circle_holds(region: Region) -> dict[str, Place]:
    center = region.points[0]
    return {"rim": (center.x_um + region.radius_um, center.y_um), CENTRE: (center.x_um, center.y_um)}


def _circle_pulled(region: Region, hold: str, to: Place, height_field: HeightField) -> Region:
    """Move the circle by its centre, or set its radius by its rim, limited to the surface."""
    x0, y0, x1, y1 = height_field.bounds_um
    center = region.points[0]
    if hold == CENTRE:
        x, y = _clamped_inside(to, (region.radius_um, region.radius_um), height_field)
        return Region.circle(_hundredth(x), _hundredth(y), region.radius_um)
    x, y = center.x_um, center.y_um
    most = min(x - x0, x1 - x, y - y0, y1 - y)
    wanted = max(math.hypot(to[0] - x, to[1] - y), LEAST_PX * height_field.on_show.facts.pixel_um)
    return Region.circle(x, y, _hundredth(min(wanted, max(most, region.radius_um))))


def _ends(region: Region) -> Corners:
    return np.array([(p.x_um, p.y_um) for p in region.points], float)


def _line_holds(region: Region) -> dict[str, Place]:
    (xa, ya), (xb, yb) = ((p.x_um, p.y_um) for p in region.points)
    return {"0": (xa, ya), "1": (xb, yb), CENTRE: ((xa + xb) / 2, (ya + yb) / 2)}


def _line_pulled(region: Region, hold: str, to: Place, height_field: HeightField) -> Region:
    """Move the line by its centre, or one end by its handle."""
    (xa, ya), (xb, yb) = ((p.x_um, p.y_um) for p in region.points)
    if hold == CENTRE:
        x, y = _clamped_inside(to, (abs(xb - xa) / 2, abs(yb - ya) / 2), height_field)
        dx, dy = x - (xa + xb) / 2, y - (ya + yb) / 2
        ends = (xa + dx, ya + dy, xb + dx, yb + dy)
    else:
        x, y = height_field.clamped(to)
        ends = (x, y, xb, yb) if hold == "0" else (xa, ya, x, y)
    line = Region.line(*(_hundredth(v) for v in ends), width_um=region.width_um)
    return line if math.dist(ends[:2], ends[2:]) >= LEAST_PX * height_field.on_show.facts.pixel_um else region


def _clamped_inside(to: Place, half: Place, height_field: HeightField) -> Place:
    """Return the centre nearest to `to` for which the given half extents stay on the surface."""
    x0, y0, x1, y1 = height_field.bounds_um
    return min(max(to[0], x0 + half[0]), x1 - half[0]), min(max(to[1], y0 + half[1]), y1 - half[1])


def _rectangle(x0: float, y0: float, x1: float, y1: float) -> Region:
    return Region.rectangle(*(_hundredth(v) for v in (x0, y0, x1, y1)))


def _hundredth(um: float) -> float:
    return round(um, 2)


def _no_outline(region: Region) -> Corners:
    return np.empty((0, 2))


SHAPES: dict[RegionKind, Shape] = {
    "point": Shape(_no_outline, _point_holds, _point_pulled),
    "rectangle": Shape(_corners, _rectangle_holds, _rectangle_pulled),
    "circle": Shape(_round_outline, _circle_holds, _circle_pulled),
    "line": Shape(_ends, _line_holds, _line_pulled),
}
"""Shapes of the kinds of region that can be dragged."""


def outline_of(region: Region) -> Corners:
    """Return the outline of a region of any kind; the line itself for a line, empty for a point."""
    if region.kind in SHAPES:
        return SHAPES[region.kind].outline(region)
    return np.array([(p.x_um, p.y_um) for p in region.points], float)
