"""Where a line across a groove begins: over the widest trench or ridge with as much even ground on both sides."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.gui.scene.heightfield import Floats, HeightField, Place
from wafer_viewer.gui.tools.surface_landmarks import first_line

SAMPLES = 400
LINES = 12
"""Lines are looked along in each direction, those near to what is looked at first."""
REACH = 1.6
"""From the middle of the trench, in its widths: half of it, a width of ground, and a little more."""
LEAST_SAMPLES = 8
LEVELS = (10, 90)
"""Per cent of the heights along a line: half-way between them it goes over an edge."""
LEAST_MEASURED = 0.9


def groove_line(land: HeightField, near: Place) -> tuple[Place, Place]:
    """Both ends of a line across a groove or ridge; a profile's first line where there is none."""
    widest, found = 0.0, None
    for start, end in _lines(land, land.inner(near)):
        first, last = _widest(land, start, end)
        width = float(np.hypot(*(last - first)))
        if width > 1.2 * widest:
            middle = (first + last) / 2
            widest, found = width, (middle + REACH * (first - last), middle + REACH * (last - first))
    if found is None:
        return first_line(land, near)
    begin, end = (land.clamped((float(x), float(y))) for x, y in found)
    return begin, end


def _lines(land: HeightField, near: Place) -> Iterator[tuple[Floats, Floats]]:
    """Right across the surface, along x and along y, from near to far."""
    x0, y0, x1, y1 = land.bounds_um
    for away in np.linspace(0, 1, LINES):
        for sign in (1, -1):
            y = near[1] + sign * away * (y1 - y0) / 2
            if y0 <= y <= y1:
                yield np.array([x0, y]), np.array([x1, y])
            x = near[0] + sign * away * (x1 - x0) / 2
            if x0 <= x <= x1:
                yield np.array([x, y0]), np.array([x, y1])


def _widest(land: HeightField, start: Floats, end: Floats) -> tuple[Floats, Floats]:
    """Both edges of the widest trench or ridge along a line; twice the same place where there is none."""
    share = np.linspace(0, 1, SAMPLES)
    places = start + share[:, None] * (end - start)
    there = land.measured(places[:, 0], places[:, 1])
    z_um = land.z_um(places[:, 0], places[:, 1])
    z_um = z_um - np.polyval(np.polyfit(share, z_um, 1), share)
    edges = _edges(z_um)
    best = 0, 0
    for before, first, last, after in zip(edges, edges[1:], edges[2:], edges[3:], strict=False):
        width = last - first
        room = min(first - before, after - last) >= REACH * width - width / 2
        seen = there[max(0, first - width) : last + width].mean() >= LEAST_MEASURED
        if width >= LEAST_SAMPLES and room and seen and width > best[1] - best[0]:
            best = first, last
    return places[best[0]], places[best[1]]


def _edges(z_um: Floats) -> list[int]:
    """Samples at which a profile goes over or under its middle, with both its ends."""
    low, high = np.percentile(z_um, LEVELS)
    over: NDArray[np.bool_] = z_um > (low + high) / 2
    return [0, *(np.flatnonzero(over[1:] != over[:-1]) + 1).tolist(), len(z_um) - 1]
