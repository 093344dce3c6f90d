"""Initial regions of the edge tools: around the die nearest to the point looked at and across the adjacent street."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.gui.scene.heightfield import Box, Floats, HeightField, Place
from wafer_viewer.gui.tools.surface_landmarks import bump, plateaus, span_um
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

    def away(self, at: Place) -> float:
        """Return the distance of a position from the centre."""
        x0, y0, x1, y1 = self.box
        return float(np.hypot((x0 + x1) / 2 - at[0], (y0 + y1) / 2 - at[1]))

    @property
    def street(self) -> float:
        """Width of the narrowest street."""
        return min((street for street in self.streets if street), default=NO_STREET * min(self.size))


def die_box(land: HeightField, near: Place) -> tuple[Region, ...]:
    """Return a rectangle around a die that reaches into the streets."""
    die = _die(land, near)
    by = ROUND * die.street
    x0, y0, x1, y1 = die.box
    return (_rectangle(land, (x0 - by, y0 - by, x1 + by, y1 + by)),)


def kerf_box(land: HeightField, near: Place) -> tuple[Region, ...]:
    """Return a rectangle across a street, preferably the one below; across the die if it is isolated."""
    die = _die(land, near)
    (x0, y0, x1, y1), by = die.box, OVER * die.street
    left, lower, right, upper = die.streets
    x_half, y_half = ALONG * (x1 - x0) / 2, ALONG * (y1 - y0) / 2
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    if lower or upper:
        low, high = (y0 - lower, y0) if lower else (y1, y1 + (upper or 0.0))
        return (_rectangle(land, (x - x_half, low - by, x + x_half, high + by)),)
    if right or left:
        low, high = (x1, x1 + right) if right else (x0 - (left or 0.0), x0)
        return (_rectangle(land, (low - by, y - y_half, high + by, y + y_half)),)
    return (_rectangle(land, (x - x_half, y0 - by, x + x_half, y1 + by)),)


def edge_box(land: HeightField, near: Place) -> tuple[Region, ...]:
    """Return a rectangle along the lower edge of a die."""
    die = _die(land, near)
    (x0, y0, x1, _), by = die.box, OVER * die.street
    half = ALONG * (x1 - x0) / 2
    return (_rectangle(land, ((x0 + x1) / 2 - half, y0 - by, (x0 + x1) / 2 + half, y0 + by)),)


def bumps_box(land: HeightField, near: Place) -> tuple[Region, ...]:
    """Return a rectangle within a die."""
    die = _die(land, near)
    x0, y0, x1, y1 = die.box
    x_in, y_in = (INSIDE * side for side in die.size)
    return (_rectangle(land, (x0 + x_in, y0 + y_in, x1 - x_in, y1 - y_in)),)


def initial_circle(land: HeightField, near: Place) -> tuple[Region, ...]:
    """Return a circle around the nearest round feature above the upper level; else around the most prominent bump."""
    _, high = _levels(land, near)
    out = _evened(land) > high + STANDS_OUT * span_um(land)
    found = [_in_um(land, out, *box) for box in _boxes(out, 0.0) if ROUND_FILL[0] <= _fill(out, *box) <= ROUND_FILL[1]]
    disc = [die for die in found if min(die.size) >= ASPECT * max(die.size)]
    if not disc:
        middle, radius_um = bump(land, near)
        return (Region.circle(*land.clamped(middle), round(radius_um, 2)),)
    at = land.inner(near)
    nearest = min(disc, key=lambda die: die.away(at))
    (x0, y0, x1, y1), radius_um = nearest.box, ROOM * max(nearest.size) / 2
    return (Region.circle(*land.clamped(((x0 + x1) / 2, (y0 + y1) / 2)), round(radius_um, 2)),)


def _rectangle(land: HeightField, box: Box) -> Region:
    x0, y0, x1, y1 = box
    return Region.rectangle(*land.clamped((x0, y0)), *land.clamped((x1, y1)))


def _die(land: HeightField, near: Place) -> DieOutline:
    """Return the complete die nearest to a position; the central half of the visible part if there is none."""
    low, high = _levels(land, near)
    over = _evened(land) > (low + high) / 2
    found = [_in_um(land, over, *box) for box in _boxes(over, LEAST_SHARE) if _fill(over, *box) >= FILLED]
    if not found:
        x0, y0, x1, y1 = land.bounds_um
        x, y, half_x, half_y = (x0 + x1) / 2, (y0 + y1) / 2, (x1 - x0) / 4, (y1 - y0) / 4
        return DieOutline((x - half_x, y - half_y, x + half_x, y + half_y), (None, None, None, None))
    at = land.inner(near)
    return min(found, key=lambda die: die.away(at))


def _evened(land: HeightField) -> Floats:
    """Return the heights without the median tilt."""
    z = land.heights
    along_x, along_y = (float(np.median(np.diff(z, axis=axis))) for axis in (1, 0))
    row, col = np.indices(z.shape)
    return z - along_x * col - along_y * row


def _levels(land: HeightField, near: Place) -> tuple[float, float]:
    """Return the lower and the upper level of a surface after removal of its tilt."""
    upper, lower, _ = plateaus(land, near)
    z, (x0, y0, x1, y1) = _evened(land), land.bounds_um
    rows, cols = z.shape
    found = [
        float(z[round((y1 - y) / (y1 - y0) * (rows - 1)), round((x - x0) / (x1 - x0) * (cols - 1))])
        for x, y in (land.clamped(lower), land.clamped(upper))
    ]
    return found[0], found[1]


def _boxes(over: NDArray[np.bool_], share: float) -> list[tuple[slice, slice]]:
    """Return bounding boxes, of at least `share` of the surface, of raised areas that do not touch the border."""
    from scipy.ndimage import binary_fill_holes, binary_opening, find_objects, label

    numbers = np.zeros(over.shape, np.int32)
    label(binary_opening(binary_fill_holes(over), np.ones((3, 3), bool)), output=numbers)
    found: list[tuple[slice, slice]] = []
    for rows, cols in find_objects(numbers):
        whole = rows.start > 0 and cols.start > 0 and rows.stop < over.shape[0] and cols.stop < over.shape[1]
        sides = rows.stop - rows.start, cols.stop - cols.start
        if whole and min(sides) >= LEAST_PX and sides[0] * sides[1] >= share * over.size:
            found.append((rows, cols))
    return found


def _fill(over: NDArray[np.bool_], rows: slice, cols: slice) -> float:
    """Return the filled fraction of a box."""
    return float(over[rows, cols].mean())


def _in_um(land: HeightField, over: NDArray[np.bool_], rows: slice, cols: slice) -> DieOutline:
    x0, y1 = land.place(rows.start - 0.5, cols.start - 0.5)
    x1, y0 = land.place(rows.stop - 0.5, cols.stop - 0.5)
    row, col = (rows.start + rows.stop) // 2, (cols.start + cols.stop) // 2
    ways = (
        over[row, : cols.start][::-1],
        over[rows.stop :, col],
        over[row, cols.stop :],
        over[: rows.start, col][::-1],
    )
    left, lower, right, upper = (float(np.argmax(way)) * land.pixel_um if way.any() else None for way in ways)
    return DieOutline((float(x0), float(y0), float(x1), float(y1)), (left, lower, right, upper))
