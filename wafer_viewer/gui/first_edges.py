"""Where the tools for edges begin: round the die nearest to what is looked at, across the street beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.gui.landmarks import plateaus
from wafer_viewer.gui.lie_of_land import Box, Land, Place
from wafer_viewer.model.region import Region

LEAST_SHARE, FILLED, LEAST_PX = 0.01, 0.75, 8
"""A die has this share of what is in sight, fills its box, and is so many coarse heights wide at least."""
ROUND, OVER, ALONG, INSIDE = 0.4, 0.3, 0.7, 0.04
"""Of the street beside a die: how far a region reaches round it, over its edge; of the die: how much of an edge, and
how far inside of it bumps are looked for."""
NO_STREET = 0.15
"""Of a die that stands alone: the street beside it."""


@dataclass(frozen=True, slots=True)
class Die:
    """The outline of a die in um, and the street at each side: left, lower, right, upper; None: it has no other side."""

    box: Box
    streets: tuple[float | None, float | None, float | None, float | None]

    @property
    def size(self) -> tuple[float, float]:
        """Width and height."""
        x0, y0, x1, y1 = self.box
        return x1 - x0, y1 - y0

    @property
    def street(self) -> float:
        """The narrowest street."""
        return min((street for street in self.streets if street), default=NO_STREET * min(self.size))


def die_box(land: Land, near: Place) -> tuple[Region, ...]:
    """Round a die, into the streets."""
    die = _die(land, near)
    by = ROUND * die.street
    x0, y0, x1, y1 = die.box
    return (_rectangle(land, (x0 - by, y0 - by, x1 + by, y1 + by)),)


def kerf_box(land: Land, near: Place) -> tuple[Region, ...]:
    """Across a street, the one below where there is one; across the die that stands alone."""
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


def edge_box(land: Land, near: Place) -> tuple[Region, ...]:
    """Along the lower edge of a die."""
    die = _die(land, near)
    (x0, y0, x1, _), by = die.box, OVER * die.street
    half = ALONG * (x1 - x0) / 2
    return (_rectangle(land, ((x0 + x1) / 2 - half, y0 - by, (x0 + x1) / 2 + half, y0 + by)),)


def bumps_box(land: Land, near: Place) -> tuple[Region, ...]:
    """Inside of a die."""
    die = _die(land, near)
    x0, y0, x1, y1 = die.box
    x_in, y_in = (INSIDE * side for side in die.size)
    return (_rectangle(land, (x0 + x_in, y0 + y_in, x1 - x_in, y1 - y_in)),)


def _rectangle(land: Land, box: Box) -> Region:
    x0, y0, x1, y1 = box
    return Region.rectangle(*land.clamped((x0, y0)), *land.clamped((x1, y1)))


def _die(land: Land, near: Place) -> Die:
    """The whole die nearest to a place; the middle half of what is in sight where there is none."""
    high = _high(land, near)
    found = _boxes(high)
    if not found:
        x0, y0, x1, y1 = land.bounds_um
        x, y, half_x, half_y = (x0 + x1) / 2, (y0 + y1) / 2, (x1 - x0) / 4, (y1 - y0) / 4
        return Die((x - half_x, y - half_y, x + half_x, y + half_y), (None, None, None, None))
    at = land.inner(near)
    return min((_in_um(land, high, *box) for box in found), key=lambda die: _away(die, at))


def _away(die: Die, at: Place) -> float:
    x0, y0, x1, y1 = die.box
    return float(np.hypot((x0 + x1) / 2 - at[0], (y0 + y1) / 2 - at[1]))


def _high(land: Land, near: Place) -> NDArray[np.bool_]:
    """What lies nearer to the upper than to the lower of the two levels of a surface."""
    upper, lower, _ = plateaus(land, near)
    x, y = (np.array([upper[k], lower[k]]) for k in (0, 1))
    return land.heights > float(land.z_um(x, y).mean())


def _boxes(high: NDArray[np.bool_]) -> list[tuple[slice, slice]]:
    """Boxes round what is high, not cut by the border, as large and as full as a die."""
    from scipy.ndimage import binary_fill_holes, binary_opening, find_objects, label

    numbers = np.zeros(high.shape, np.int32)
    label(binary_opening(binary_fill_holes(high), np.ones((3, 3), bool)), output=numbers)
    found: list[tuple[slice, slice]] = []
    for number, (rows, cols) in enumerate(find_objects(numbers), 1):
        inside = numbers[rows, cols] == number
        whole = rows.start > 0 and cols.start > 0 and rows.stop < high.shape[0] and cols.stop < high.shape[1]
        large = min(inside.shape) >= LEAST_PX and inside.sum() >= LEAST_SHARE * high.size
        if whole and large and inside.mean() >= FILLED:
            found.append((rows, cols))
    return found


def _in_um(land: Land, high: NDArray[np.bool_], rows: slice, cols: slice) -> Die:
    x0, y1 = land.place(rows.start - 0.5, cols.start - 0.5)
    x1, y0 = land.place(rows.stop - 0.5, cols.stop - 0.5)
    row, col = (rows.start + rows.stop) // 2, (cols.start + cols.stop) // 2
    ways = (
        high[row, : cols.start][::-1],
        high[rows.stop :, col],
        high[row, cols.stop :],
        high[: rows.start, col][::-1],
    )
    streets = tuple(float(np.argmax(way)) * land.pixel_um if way.any() else None for way in ways)
    left, lower, right, upper = streets
    return Die((float(x0), float(y0), float(x1), float(y1)), (left, lower, right, upper))
