"""Streets between dies, from the median cell of a lattice. Pure, on arrays."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wafer_viewer.measure.base.height_samples import Floats
from wafer_viewer.measure.dies.periodicity import vertex
from wafer_viewer.numerics.array_types import Float32s

WIDEST = 0.3
"""Largest width of a street, relative to the pitch."""
NARROWEST_PX = 2
STANDS_OUT = 6.0
"""Smallest prominence of both street edges, in robust deviations of the edge profile."""
SURE = 18.0
"""Prominence from which the first layer (heights) takes precedence."""
MOST_DIFFERING_PX = 8
"""Largest difference between the edges of the same street in two layers."""
ON_TOP = 1e-3
"""Weight of both edges relative to the weaker one; it breaks ties near the maximum of a strong edge."""
BANDS = 4
"""Number of bands of the cell; the scatter of the edges between them gives their uncertainty."""


@dataclass(frozen=True, slots=True)
class Street:
    """A street across a cell, px from its first line: begin, width, standard uncertainty of an edge, prominence."""

    begin: float
    width: float
    u_px: float
    clear: float


def street_of(layers: Sequence[Float32s], upright: bool) -> Street | None:
    """Return the street that runs down a cell (upright) or across it; None without one.

    Taken from the first layer that shows it well, else from the one that shows it best. Heights take precedence: the
    image is blurred at the walls of a street. The cell repeats, so a street may cross its border.
    """
    planes = [_filled(layer if upright else layer.T) for layer in layers if np.isfinite(layer).mean() > 0.3]
    found = [street for plane in planes if (street := _street(plane)) is not None]
    if not found:
        return None
    best = found[0] if found[0].clear >= SURE else max(found, key=lambda street: street.clear)
    return dataclasses.replace(best, u_px=math.hypot(best.u_px, _differing(best, found)))


def _differing(best: Street, found: Sequence[Street]) -> float:
    """Return the standard uncertainty of an edge due to the difference between layers: half of it, rectangular."""
    other = [one for one in found if abs(one.begin - best.begin) + abs(one.width - best.width) < MOST_DIFFERING_PX]
    each = [max(abs(one.begin - best.begin), abs(one.begin + one.width - best.begin - best.width)) for one in other]
    return max(each) / 2 / math.sqrt(3)


def _filled(plane: Float32s) -> Floats:
    """Interpolate unknown pixels along each line: heights at a wall are often unmeasured."""
    filled, places = plane.astype(np.float64), np.arange(plane.shape[1])
    for line in filled:
        known = np.isfinite(line)
        if known.any() and not known.all():
            line[~known] = np.interp(places[~known], places[known], line[known], period=len(line))
    return filled[np.isfinite(filled).all(axis=1)]


def _street(plane: Floats) -> Street | None:
    if len(plane) < BANDS or plane.shape[1] < 8:
        return None
    plane = _upright(plane)
    slope = edges_profile(plane)
    spread = 1.4826 * float(np.median(np.abs(slope - np.median(slope)))) or float(np.abs(slope).max()) / 1e3
    best, begin, width = _strongest_pair(slope)
    if not spread or best < STANDS_OUT * spread:
        return None
    edges = [_between(slope, begin), _between(slope, begin + width)]
    u_px = math.hypot(*(_scatter(plane, round(edge)) for edge in edges)) / math.sqrt(2)
    return Street(edges[0], edges[1] - edges[0], u_px, best / spread)


def _upright(plane: Floats) -> Floats:
    """Subtract the median slope along the lines: the street tilts the plane of the cell."""
    each = np.diff(np.median(plane, axis=0))
    return plane - float(np.median(each)) * np.arange(plane.shape[1])


def edges_profile(plane: Floats) -> Floats:
    """Return the slope along the lines, as the median of all lines; incomplete edges do not count."""
    from scipy.ndimage import gaussian_filter1d

    smooth = np.asarray(gaussian_filter1d(plane, 1.0, axis=1, mode="wrap"))
    return np.median((np.roll(smooth, -1, axis=1) - np.roll(smooth, 1, axis=1)) / 2, axis=0)


def _strongest_pair(slope: Floats) -> tuple[float, int, int]:
    """Return (strength of the weaker edge, begin, width) of the strongest pair of opposite edges."""
    best = (0.0, 0, 0)
    for width in range(NARROWEST_PX, math.floor(WIDEST * len(slope)) + 1):
        after = np.roll(slope, -width)
        both = np.minimum(np.abs(slope), np.abs(after)) + ON_TOP * (np.abs(slope) + np.abs(after))
        pair = np.where(slope * after < 0, both, 0.0)
        begin = int(np.argmax(pair))
        best = max(best, (float(pair[begin]), begin, width))
    return best


def _between(slope: Floats, place: int) -> float:
    """Return the subpixel position of an edge."""
    n = len(slope)
    steep = np.abs(slope[[(place + k) % n for k in (-1, 0, 1)]])
    return place + vertex(*steep.tolist())


def _scatter(plane: Floats, place: int) -> float:
    """Return the standard uncertainty of the mean edge position, from bands of the cell."""
    each = np.array([_near(edges_profile(part), place) for part in np.array_split(plane, BANDS)])
    middle = float(np.median(each))
    return 1.4826 * float(np.median(np.abs(each - middle))) / math.sqrt(BANDS)


def _near(slope: Floats, place: int, reach: int = 3) -> float:
    around = (place + np.arange(-reach, reach + 1)) % len(slope)
    top = int(np.argmax(np.abs(slope[around]))) - reach
    return _between(slope, place + top)
