"""Regions of the sample in stage um, never in pixels."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.spec import NonNegative, Spec, Within, replace


class Point(Spec, frozen=True, kw_only=True, array_like=True):
    """A point on the stage."""

    x_um: float
    y_um: float


RegionKind = Literal["rectangle", "circle", "polygon", "line", "polyline", "point"]
_POINTS: dict[RegionKind, tuple[int, int]] = {
    "rectangle": (2, 2),
    "circle": (1, 1),
    "polygon": (3, 10_000),
    "line": (2, 2),
    "polyline": (2, 10_000),
    "point": (1, 1),
}
_WITH_AREA: tuple[RegionKind, ...] = ("rectangle", "circle", "polygon")
_AREA_STEPS = 1000
"""Points along each side of a region at which the area that excluded regions leave is counted."""


class Region(Spec, frozen=True, kw_only=True):
    """A rectangle (two opposite corners), circle (centre, radius), polygon (corners), line (two ends) or point.

    Or a polyline: a path through two or more points.

    excluded: rectangles, circles and polygons that are taken out of a region with an area.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    kind: RegionKind
    points: tuple[Point, ...]
    radius_um: NonNegative = 0.0
    width_um: Annotated[float, Within(0)] = 0.0
    excluded: tuple[Region, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        low, high = _POINTS[self.kind]
        if not low <= len(self.points) <= high:
            self.refuse(
                "points",
                f"{low} points for a {self.kind}" if low == high else f"at least {low} points for a {self.kind}",
            )
        if self.kind == "circle" and self.radius_um == 0:
            self.refuse("radius_um", "over 0 for a circle")
        if self.excluded and not all(region.kind in _WITH_AREA for region in (self, *self.excluded)):
            self.refuse("excluded", f"{', '.join(_WITH_AREA)} within one of these")

    @classmethod
    def rectangle(cls, x0_um: float, y0_um: float, x1_um: float, y1_um: float) -> Region:
        """Return the rectangle between two opposite corners."""
        return cls(kind="rectangle", points=(Point(x_um=x0_um, y_um=y0_um), Point(x_um=x1_um, y_um=y1_um)))

    @classmethod
    def circle(cls, x_um: float, y_um: float, radius_um: float) -> Region:
        """Return the circle around a centre."""
        return cls(kind="circle", points=(Point(x_um=x_um, y_um=y_um),), radius_um=radius_um)

    @classmethod
    def polygon(cls, *corners: tuple[float, float]) -> Region:
        """Return the polygon through corners (x_um, y_um), in order."""
        return cls(kind="polygon", points=tuple(Point(x_um=x, y_um=y) for x, y in corners))

    @classmethod
    def line(cls, x0_um: float, y0_um: float, x1_um: float, y1_um: float, width_um: float = 0.0) -> Region:
        """Return the line between two ends; heights are averaged over width_um across it."""
        ends = (Point(x_um=x0_um, y_um=y0_um), Point(x_um=x1_um, y_um=y1_um))
        return cls(kind="line", points=ends, width_um=width_um)

    @classmethod
    def polyline(cls, *points: tuple[float, float], width_um: float = 0.0) -> Region:
        """Return the path through points (x_um, y_um), in order; heights are averaged over width_um across it."""
        return cls(kind="polyline", points=tuple(Point(x_um=x, y_um=y) for x, y in points), width_um=width_um)

    @classmethod
    def point(cls, x_um: float, y_um: float) -> Region:
        """Return a single point."""
        return cls(kind="point", points=(Point(x_um=x_um, y_um=y_um),))

    def without(self, *excluded: Region) -> Region:
        """Return the region without these regions: a mask with holes."""
        return replace(self, excluded=(*self.excluded, *excluded))

    @property
    def is_path(self) -> bool:
        """True for a line and a polyline."""
        return self.kind in ("line", "polyline")

    @property
    def bounds_um(self) -> tuple[float, float, float, float]:
        """(x low, y low, x high, y high) of the axis-parallel bounding box."""
        xs, ys = [p.x_um for p in self.points], [p.y_um for p in self.points]
        pad = self.radius_um if self.kind == "circle" else self.width_um / 2
        return min(xs) - pad, min(ys) - pad, max(xs) + pad, max(ys) + pad

    @property
    def area_um2(self) -> float:
        """Enclosed area, 0 for a path or a point; without excluded regions, within about 0.1 % of the bounding box."""
        if self.excluded:
            x0, y0, x1, y1 = self.bounds_um
            middles = (np.arange(_AREA_STEPS) + 0.5) / _AREA_STEPS
            inside = self.contains(x0 + (x1 - x0) * middles, (y0 + (y1 - y0) * middles)[:, None])
            return float(inside.mean()) * (x1 - x0) * (y1 - y0)
        if self.kind == "circle":
            return math.pi * self.radius_um**2
        if self.kind == "rectangle":
            x0, y0, x1, y1 = self.bounds_um
            return (x1 - x0) * (y1 - y0)
        return abs(_twice_the_area(self.points)) / 2 if self.kind == "polygon" else 0.0

    def along_and_across_um(
        self, x_um: NDArray[np.float64], y_um: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the distance of points along a line from its first end and their signed distance from it, um.

        The latter is negative to the right of the direction from the first end to the second.
        """
        a, b = self.points
        dx, dy = b.x_um - a.x_um, b.y_um - a.y_um
        length = max(float(np.hypot(dx, dy)), 1e-9)
        x, y = x_um - a.x_um, y_um - a.y_um
        return (x * dx + y * dy) / length, (y * dx - x * dy) / length

    def contains(self, x_um: NDArray[np.float64], y_um: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return a mask of the points (arrays that broadcast together) inside; a path or a point contains none."""
        x, y = np.broadcast_arrays(np.asarray(x_um, float), np.asarray(y_um, float))
        inside = self._outline_contains(x, y)
        for region in self.excluded:
            inside &= ~region.contains(x, y)
        return inside

    def _outline_contains(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
        if self.kind not in _WITH_AREA:
            return np.zeros(x.shape, bool)
        if self.kind == "circle":
            center = self.points[0]
            return np.hypot(x - center.x_um, y - center.y_um) <= self.radius_um
        if self.kind == "rectangle":
            x0, y0, x1, y1 = self.bounds_um
            return (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)
        return _inside_polygon(x, y, [(p.x_um, p.y_um) for p in self.points])


def _twice_the_area(corners: tuple[Point, ...]) -> float:
    """Return twice the signed area of a polygon, negative for clockwise corners."""
    following = (*corners[1:], corners[0])
    return sum(a.x_um * b.y_um - b.x_um * a.y_um for a, b in zip(corners, following, strict=True))


def _inside_polygon(
    x: NDArray[np.float64], y: NDArray[np.float64], corners: list[tuple[float, float]]
) -> NDArray[np.bool_]:
    """Return a mask by the even-odd rule: inside if a ray to the right crosses the outline an odd number of times."""
    inside = np.zeros(x.shape, bool)
    for (xa, ya), (xb, yb) in zip(corners, corners[1:] + corners[:1], strict=True):
        if ya == yb:
            continue
        crosses = (ya > y) != (yb > y)
        inside ^= crosses & (x < xa + (y - ya) * (xb - xa) / (yb - ya))
    return inside
