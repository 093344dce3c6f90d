"""Initial regions of each tool, on features of the visible part, so that the first answer makes sense."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.gui.scene.heightfield import Box, Floats, HeightField, Place
from wafer_viewer.gui.tools.surface_landmarks import (
    PATCH_SHARES,
    SAME_LEVEL,
    bump,
    face,
    first_line,
    patches,
    plateaus,
    span_um,
    two_faces,
)
from wafer_viewer.model.measurement.measuring_tool import InitialRegions, ToolName
from wafer_viewer.model.measurement.tool_options import LevelBy, Levelling
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.model.region import Region

LEAST_SHARE, FILLED, LEAST_PX = 0.01, 0.75, 8
"""Least area of a die as a fraction of the visible part, least fill of its box, and least side in coarse pixels."""
ROUND, OVER, ALONG, INSIDE = 0.4, 0.3, 0.7, 0.04
"""Fractions of the street: margin around a die, reach across its edge. Fractions of the die: length along an edge,
inset of the bump region."""
STANDS_OUT, ROUND_FILL, ASPECT, ROOM = 0.05, (0.6, 0.9), 0.75, 1.24
"""Detection of round features: least height as a fraction of the height range, fill of the bounding box, least aspect
ratio; size of the circle drawn around it relative to the feature."""
NO_STREET = 0.15
"""Assumed street of an isolated die, as a fraction of its shorter side."""


@dataclass(frozen=True, slots=True)
class DieOutline:
    """Outline of a die in um, and street widths: left, lower, right, upper; None if there is nothing beyond."""

    box: Box
    streets: tuple[float | None, float | None, float | None, float | None]

    @property
    def size(self) -> tuple[float, float]:
        """Width and height."""
        x0, y0, x1, y1 = self.box
        return x1 - x0, y1 - y0

    def away(self, place: Place) -> float:
        """Return the distance of a position from the centre."""
        x0, y0, x1, y1 = self.box
        return float(np.hypot((x0 + x1) / 2 - place[0], (y0 + y1) / 2 - place[1]))

    @property
    def street(self) -> float:
        """Width of the narrowest street."""
        return min((street for street in self.streets if street), default=NO_STREET * min(self.size))


def die_box(height_field: HeightField, near: Place) -> tuple[Region, ...]:
    """Return a rectangle around a die that reaches into the streets."""
    die = _die(height_field, near)
    by = ROUND * die.street
    x0, y0, x1, y1 = die.box
    return (_rectangle(height_field, (x0 - by, y0 - by, x1 + by, y1 + by)),)


def kerf_box(height_field: HeightField, near: Place) -> tuple[Region, ...]:
    """Return a rectangle across a street, preferably the one below; across the die if it is isolated."""
    die = _die(height_field, near)
    (x0, y0, x1, y1), by = die.box, OVER * die.street
    left, lower, right, upper = die.streets
    x_half, y_half = ALONG * (x1 - x0) / 2, ALONG * (y1 - y0) / 2
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    if lower or upper:
        low, high = (y0 - lower, y0) if lower else (y1, y1 + (upper or 0.0))
        return (_rectangle(height_field, (x - x_half, low - by, x + x_half, high + by)),)
    if right or left:
        low, high = (x1, x1 + right) if right else (x0 - (left or 0.0), x0)
        return (_rectangle(height_field, (low - by, y - y_half, high + by, y + y_half)),)
    return (_rectangle(height_field, (x - x_half, y0 - by, x + x_half, y1 + by)),)


def edge_box(height_field: HeightField, near: Place) -> tuple[Region, ...]:
    """Return a rectangle along the lower edge of a die."""
    die = _die(height_field, near)
    (x0, y0, x1, _), by = die.box, OVER * die.street
    half = ALONG * (x1 - x0) / 2
    return (_rectangle(height_field, ((x0 + x1) / 2 - half, y0 - by, (x0 + x1) / 2 + half, y0 + by)),)


def bumps_box(height_field: HeightField, near: Place) -> tuple[Region, ...]:
    """Return a rectangle within a die."""
    die = _die(height_field, near)
    x0, y0, x1, y1 = die.box
    x_in, y_in = (INSIDE * side for side in die.size)
    return (_rectangle(height_field, (x0 + x_in, y0 + y_in, x1 - x_in, y1 - y_in)),)


def initial_circle(height_field: HeightField, near: Place) -> tuple[Region, ...]:
    """Return a circle around the nearest round feature above the upper level; else around the most prominent bump."""
    _, high = _levels(height_field, near)
    out = _evened(height_field) > high + STANDS_OUT * span_um(height_field)
    dies = [
        _in_um(height_field, out, *box)
        for box in _boxes(out, 0.0)
        if ROUND_FILL[0] <= _fill(out, *box) <= ROUND_FILL[1]
    ]
    disc = [die for die in dies if min(die.size) >= ASPECT * max(die.size)]
    if not disc:
        middle, radius_um = bump(height_field, near)
        return (Region.circle(*height_field.clamped(middle), round(radius_um, 2)),)
    centre = height_field.inner(near)
    nearest = min(disc, key=lambda die: die.away(centre))
    (x0, y0, x1, y1), radius_um = nearest.box, ROOM * max(nearest.size) / 2
    return (Region.circle(*height_field.clamped(((x0 + x1) / 2, (y0 + y1) / 2)), round(radius_um, 2)),)


def _rectangle(height_field: HeightField, box: Box) -> Region:
    x0, y0, x1, y1 = box
    return Region.rectangle(*height_field.clamped((x0, y0)), *height_field.clamped((x1, y1)))


def _die(height_field: HeightField, near: Place) -> DieOutline:
    """Return the complete die nearest to a position; the central half of the visible part if there is none."""
    low, high = _levels(height_field, near)
    over = _evened(height_field) > (low + high) / 2
    dies = [_in_um(height_field, over, *box) for box in _boxes(over, LEAST_SHARE) if _fill(over, *box) >= FILLED]
    if not dies:
        x0, y0, x1, y1 = height_field.bounds_um
        x, y, half_x, half_y = (x0 + x1) / 2, (y0 + y1) / 2, (x1 - x0) / 4, (y1 - y0) / 4
        return DieOutline((x - half_x, y - half_y, x + half_x, y + half_y), (None, None, None, None))
    centre = height_field.inner(near)
    return min(dies, key=lambda die: die.away(centre))


def _evened(height_field: HeightField) -> Floats:
    """Return the heights without the median tilt."""
    z = height_field.heights
    along_x, along_y = (float(np.median(np.diff(z, axis=axis))) for axis in (1, 0))
    row, col = np.indices(z.shape)
    return z - along_x * col - along_y * row


def _levels(height_field: HeightField, near: Place) -> tuple[float, float]:
    """Return the lower and the upper level of a surface after removal of its tilt."""
    upper, lower, _ = plateaus(height_field, near)
    z, (x0, y0, x1, y1) = _evened(height_field), height_field.bounds_um
    rows, cols = z.shape
    candidates = [
        float(z[round((y1 - y) / (y1 - y0) * (rows - 1)), round((x - x0) / (x1 - x0) * (cols - 1))])
        for x, y in (height_field.clamped(lower), height_field.clamped(upper))
    ]
    return candidates[0], candidates[1]


def _boxes(over: NDArray[np.bool_], share: float) -> list[tuple[slice, slice]]:
    """Return bounding boxes, of at least `share` of the surface, of raised areas that do not touch the border."""
    from scipy.ndimage import binary_fill_holes, binary_opening, find_objects, label

    numbers = np.zeros(over.shape, np.int32)
    label(binary_opening(binary_fill_holes(over), np.ones((3, 3), bool)), output=numbers)
    boxes: list[tuple[slice, slice]] = []
    for rows, cols in find_objects(numbers):
        inside = rows.start > 0 and cols.start > 0 and rows.stop < over.shape[0] and cols.stop < over.shape[1]
        sides = rows.stop - rows.start, cols.stop - cols.start
        if inside and min(sides) >= LEAST_PX and sides[0] * sides[1] >= share * over.size:
            boxes.append((rows, cols))
    return boxes


def _fill(over: NDArray[np.bool_], rows: slice, cols: slice) -> float:
    """Return the filled fraction of a box."""
    return float(over[rows, cols].mean())


def _in_um(height_field: HeightField, over: NDArray[np.bool_], rows: slice, cols: slice) -> DieOutline:
    x0, y1 = height_field.place(rows.start - 0.5, cols.start - 0.5)
    x1, y0 = height_field.place(rows.stop - 0.5, cols.stop - 0.5)
    row, col = (rows.start + rows.stop) // 2, (cols.start + cols.stop) // 2
    ways = (
        over[row, : cols.start][::-1],
        over[rows.stop :, col],
        over[row, cols.stop :],
        over[: rows.start, col][::-1],
    )
    left, lower, right, upper = (float(np.argmax(gap)) * height_field.pixel_um if gap.any() else None for gap in ways)
    return DieOutline((float(x0), float(y0), float(x1), float(y1)), (left, lower, right, upper))


SAMPLES = 400
LINES = 12
"""Lines evaluated in each direction, the nearest first."""
REACH = 1.6
"""Half length of the line in widths of the trench: half of the trench, one width of ground, and a margin."""
LEAST_SAMPLES = 8
LEVELS = (10, 90)
"""Percentiles of the heights along a line; an edge is a crossing of their mean."""
LEAST_MEASURED = 0.9


def groove_line(height_field: HeightField, near: Place) -> tuple[Place, Place]:
    """Return both ends of a line across a groove or ridge; the initial profile line if there is none."""
    widest, ends = 0.0, None
    for start, end in _lines(height_field, height_field.inner(near)):
        first, last = _widest(height_field, start, end)
        width = float(np.hypot(*(last - first)))
        if width > 1.2 * widest:
            middle = (first + last) / 2
            widest, ends = width, (middle + REACH * (first - last), middle + REACH * (last - first))
    if ends is None:
        return first_line(height_field, near)
    begin, end = (height_field.clamped((float(x), float(y))) for x, y in ends)
    return begin, end


def _lines(height_field: HeightField, near: Place) -> Iterator[tuple[Floats, Floats]]:
    """Yield lines across the entire surface, along x and along y, the nearest first."""
    x0, y0, x1, y1 = height_field.bounds_um
    for away in np.linspace(0, 1, LINES):
        for sign in (1, -1):
            y = near[1] + sign * away * (y1 - y0) / 2
            if y0 <= y <= y1:
                yield np.array([x0, y]), np.array([x1, y])
            x = near[0] + sign * away * (x1 - x0) / 2
            if x0 <= x <= x1:
                yield np.array([x, y0]), np.array([x, y1])


def _widest(height_field: HeightField, start: Floats, end: Floats) -> tuple[Floats, Floats]:
    """Return both edges of the widest trench or ridge along a line; two equal positions if there is none."""
    share = np.linspace(0, 1, SAMPLES)
    places = start + share[:, None] * (end - start)
    measured = height_field.measured(places[:, 0], places[:, 1])
    z_um = height_field.z_um(places[:, 0], places[:, 1])
    z_um = z_um - np.polyval(np.polyfit(share, z_um, 1), share)
    edges = _edges(z_um)
    best = 0, 0
    for before, first, last, after in zip(edges, edges[1:], edges[2:], edges[3:], strict=False):
        width = last - first
        room = min(first - before, after - last) >= REACH * width - width / 2
        enough = measured[max(0, first - width) : last + width].mean() >= LEAST_MEASURED
        if width >= LEAST_SAMPLES and room and enough and width > best[1] - best[0]:
            best = first, last
    return places[best[0]], places[best[1]]


def _edges(z_um: Floats) -> list[int]:
    """Return the samples at which a profile crosses its mid-level, and both of its ends."""
    low, high = np.percentile(z_um, LEVELS)
    over: NDArray[np.bool_] = z_um > (low + high) / 2
    return [0, *(np.flatnonzero(over[1:] != over[:-1]) + 1).tolist(), len(z_um) - 1]


_BORDER = 0.06
"""Margin as a fraction of a side of the surface."""
_WELL_INSIDE = 0.8
"""Side of an initial region, as a fraction of the flat square found."""


def _square(height_field: HeightField, centre: Place, side_um: float) -> Region:
    (x, y), half = centre, side_um / 2
    return Region.rectangle(*height_field.clamped((x - half, y - half)), *height_field.clamped((x + half, y + half)))


def _inside(height_field: HeightField, centre: Place, side_um: float) -> Region:
    return _square(height_field, centre, _WELL_INSIDE * side_um)


def _point(height_field: HeightField, near: Place) -> tuple[Region, ...]:
    return (Region.point(*height_field.nearest_measured(height_field.inner(near))),)


def _distance(height_field: HeightField, near: Place) -> tuple[Region, ...]:
    x0, _, x1, _ = height_field.bounds_um
    x, y = height_field.inner(near)
    ends = ((x - 0.16 * (x1 - x0), y), (x + 0.16 * (x1 - x0), y))
    return tuple(Region.point(*height_field.nearest_measured(end)) for end in ends)


def _step(height_field: HeightField, near: Place) -> tuple[Region, ...]:
    upper, lower, side_um = plateaus(height_field, near)
    return _inside(height_field, upper, side_um), _inside(height_field, lower, side_um)


def _angle(height_field: HeightField, near: Place) -> tuple[Region, ...]:
    first, second, side_um = two_faces(height_field, near)
    return _inside(height_field, first, side_um), _inside(height_field, second, side_um)


def _radius(height_field: HeightField, near: Place) -> tuple[Region, ...]:
    middle, radius_um = bump(height_field, near)
    return (Region.circle(*height_field.clamped(middle), round(radius_um, 2)),)


def _volume(height_field: HeightField, near: Place) -> tuple[Region, ...]:
    middle, radius_um = bump(height_field, near)
    return (_square(height_field, middle, 3 * radius_um),)


def _face(height_field: HeightField, near: Place) -> tuple[Region, ...]:
    return (_inside(height_field, *face(height_field, near)),)


def _across_face(height_field: HeightField, near: Place) -> tuple[Region, ...]:
    x0, y0, x1, y1 = _inside(height_field, *face(height_field, near)).bounds_um
    return (Region.line(x0, (y0 + y1) / 2, x1, (y0 + y1) / 2),)


def _visible_without_border(height_field: HeightField, near: Place) -> tuple[Region, ...]:
    """Return the visible part without its border."""
    x0, y0, x1, y1 = height_field.bounds_um
    in_x, in_y = _BORDER * (x1 - x0), _BORDER * (y1 - y0)
    return (Region.rectangle(*(round(um, 2) for um in (x0 + in_x, y0 + in_y, x1 - in_x, y1 - in_y))),)


INITIAL_REGIONS: dict[InitialRegions, Callable[[HeightField, Place], tuple[Region, ...]]] = {
    "informative line": lambda height_field, near: (
        Region.line(*(v for end in first_line(height_field, near) for v in end)),
    ),
    "line across a groove": lambda height_field, near: (
        Region.line(*(v for end in groove_line(height_field, near) for v in end)),
    ),
    "line across a face": _across_face,
    "point": _point,
    "two points": _distance,
    "two levels": _step,
    "two faces": _angle,
    "bump": _radius,
    "around a bump": _volume,
    "bumps": bumps_box,
    "face": _face,
    "kerf": kerf_box,
    "die": die_box,
    "round shape": initial_circle,
    "die edge": edge_box,
    "all in view": _visible_without_border,
}
"""Regions on a feature of the visible part, nearest to the point looked at."""


def initial_regions(tool: ToolName, height_field: HeightField, near: Place) -> tuple[Region, ...]:
    """Return the first regions of a tool, in the order of its inputs."""
    return INITIAL_REGIONS[TOOLS[tool].initial](height_field, near)


def _three_points(height_field: HeightField, near: Place) -> tuple[Region, ...]:
    """Return three distant points, if possible all on the level of most of the surface."""
    x0, y0, x1, y1 = height_field.bounds_um
    wanted = [(x0 + u * (x1 - x0), y0 + v * (y1 - y0)) for u, v in ((0.15, 0.15), (0.85, 0.15), (0.5, 0.85))]
    flat = patches(height_field, PATCH_SHARES[-1])
    level = (
        flat.only(np.abs(flat.level - np.median(flat.level)) <= SAME_LEVEL * span_um(height_field))
        if len(flat)
        else flat
    )
    if len(level) < 3:
        return tuple(Region.point(*height_field.nearest_measured(place)) for place in wanted)
    return tuple(Region.point(*height_field.clamped(level.middle(level.nearest(place)))) for place in wanted)


_LEVEL_AT: dict[LevelBy, Callable[[HeightField, Place], tuple[Region, ...]]] = {
    "three points": _three_points,
    "region": _face,
}


def first_levelling(by: LevelBy, height_field: HeightField, near: Place) -> Levelling:
    """Return a levelling with initial regions."""
    return Levelling(by=by, places=_LEVEL_AT[by](height_field, near) if by in _LEVEL_AT else ())
