"""Axes of profile plots: limits, ticks, and curves decimated to the resolution of the plot. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.draw.ticks import round_step, tick_digits, ticks
from wafer_viewer.model.measurement.sections import Section, SlabPoints

Floats = NDArray[np.float64]
Ends = tuple[float, float]
MOST_POINTS = 1500
"""Greatest number of curve points, above the pixel width of a plot on the page."""
MOST_DOTS = 4000
"""Greatest number of drawn slab points; more would hide each other."""
_NEARLY_ALL = 0.2, 99.8
"""Percentiles of the slab points that the plot contains at least."""
_LEAST_SPAN_UM = 1e-3


@dataclass(frozen=True, slots=True)
class ProfileFrame:
    """Limits of a plot in um: distance along the lines, and heights."""

    x_um: Ends
    z_um: Ends

    def across(self, x_um: Floats) -> Floats:
        """Return the horizontal positions of distances, from 0 (left) to 1 (right)."""
        return (x_um - self.x_um[0]) / (self.x_um[1] - self.x_um[0])

    def down(self, z_um: Floats) -> Floats:
        """Return the vertical positions of heights, from 0 (top) to 1 (bottom)."""
        return (self.z_um[1] - z_um) / (self.z_um[1] - self.z_um[0])

    def x_ticks(self, most: int) -> list[float]:
        """Return round distances."""
        return ticks(*self.x_um, most)

    def z_ticks(self, most: int) -> list[float]:
        """Return round heights."""
        return ticks(*self.z_um, most)

    def holding(self, z_um: Ends) -> ProfileFrame:
        """Return the frame with other height limits."""
        return replace(self, z_um=z_um)


def frame_of(sections: Sequence[Section], span_um: Ends | None = None) -> ProfileFrame:
    """Return the frame of all curves, or of a distance range, with height limits from `round_ends`."""
    longest = max((float(s.curve.distance_um[-1]) for s in sections), default=1.0)
    low, high = (max(0.0, span_um[0]), min(longest, span_um[1])) if span_um is not None else (0.0, longest)
    if not high - low > _LEAST_SPAN_UM:
        low, high = 0.0, longest
    seen = [s.curve.z_um[(s.curve.distance_um >= low) & (s.curve.distance_um <= high)] for s in sections]
    seen += [_nearly_all(s.points, (low, high)) for s in sections if s.points is not None]
    return ProfileFrame((low, high), round_ends(np.concatenate([*seen, np.empty(0)])))


def dots(points: SlabPoints, frame: ProfileFrame, most: int = MOST_DOTS) -> tuple[Floats, Floats]:
    """Return the points of a slab within a frame as fractions (across, down) of it.

    Above `most` points a random subset with a fixed seed is drawn, so that nothing flickers.
    """
    inside = np.flatnonzero(
        (points.distance_um >= frame.x_um[0])
        & (points.distance_um <= frame.x_um[1])
        & (points.z_um >= frame.z_um[0])
        & (points.z_um <= frame.z_um[1])
    )
    if inside.size > most:
        inside = np.sort(np.random.default_rng(0).choice(inside, most, replace=False))
    return frame.across(points.distance_um[inside].astype(float)), frame.down(points.z_um[inside].astype(float))


def _nearly_all(points: SlabPoints, x_um: Ends) -> Floats:
    """Return height percentiles of the points in a distance range, so that outliers do not flatten the plot."""
    z_um = points.z_um[(points.distance_um >= x_um[0]) & (points.distance_um <= x_um[1])]
    return np.percentile(z_um.astype(float), _NEARLY_ALL) if z_um.size else np.empty(0)


def round_ends(z_um: Floats) -> Ends:
    """Return round limits around heights, which are stable against small changes of the heights."""
    good = z_um[np.isfinite(z_um)]
    if good.size == 0:
        return -1.0, 1.0
    low, high = float(good.min()), float(good.max())
    step = round_step(max((high - low) / 4, 0.05))
    return float(step * np.floor(low / step - 0.15)), float(step * np.ceil(high / step + 0.15))


def digits(values: list[float]) -> int:
    """Return the number of decimals of ticks."""
    return tick_digits(values)


def runs(section: Section, frame: ProfileFrame, most: int = MOST_POINTS) -> list[tuple[Floats, Floats]]:
    """Return the measured segments of a curve within a frame, as fractions (across, down) of it.

    A curve with more than `most` points retains every peak, valley and gap that the frame can resolve.
    """
    curve = section.curve
    first, last = np.searchsorted(curve.distance_um, frame.x_um)
    part = slice(max(0, int(first) - 1), int(last) + 1)
    x, z = thinned(curve.distance_um[part], curve.z_um[part], most)
    good = np.flatnonzero(np.isfinite(z))
    pieces = np.split(good, np.flatnonzero(np.diff(good) > 1) + 1) if good.size else []
    return [(frame.across(x[piece]), frame.down(z[piece])) for piece in pieces]


def thinned(x: Floats, z: Floats, most: int) -> tuple[Floats, Floats]:
    """Decimate a curve to at most `most` points, with all peaks, valleys, and gaps as wide as an interval.

    Each interval is represented by its lowest and highest point; one without a measured point is a gap (NaN).
    """
    if len(z) <= most:
        return x, z
    length = -(-len(z) // (most // 2))
    padded = np.pad(z, (0, -len(z) % length), constant_values=np.nan).reshape(-1, length)
    known = np.isfinite(padded)
    picked = np.sort(
        [np.where(known, padded, np.inf).argmin(axis=1), np.where(known, padded, -np.inf).argmax(axis=1)], 0
    )
    index = np.minimum(picked.T + length * np.arange(len(padded))[:, None], len(z) - 1).ravel()
    kept = np.where(np.repeat(known.any(axis=1), 2), z[index], np.nan)
    return x[index], kept
