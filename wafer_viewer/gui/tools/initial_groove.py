"""Initial line across a groove: the widest trench or ridge with sufficient level ground on both sides."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.gui.scene.heightfield import Floats, HeightField, Place
from wafer_viewer.gui.tools.surface_landmarks import first_line

SAMPLES = 400
LINES = 12
"""Lines evaluated in each direction, the nearest first."""
REACH = 1.6
"""Half length of the line in widths of the trench: half of the trench, one width of ground, and a margin."""
LEAST_SAMPLES = 8
LEVELS = (10, 90)
"""Percentiles of the heights along a line; an edge is a crossing of their mean."""
LEAST_MEASURED = 0.9


def groove_line(land: HeightField, near: Place) -> tuple[Place, Place]:
    """Return both ends of a line across a groove or ridge; the initial profile line if there is none."""
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
    """Yield lines across the entire surface, along x and along y, the nearest first."""
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
    """Return both edges of the widest trench or ridge along a line; two equal positions if there is none."""
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
    """Return the samples at which a profile crosses its mid-level, and both of its ends."""
    low, high = np.percentile(z_um, LEVELS)
    over: NDArray[np.bool_] = z_um > (low + high) / 2
    return [0, *(np.flatnonzero(over[1:] != over[:-1]) + 1).tolist(), len(z_um) - 1]
