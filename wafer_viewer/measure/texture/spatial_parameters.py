"""The spatial parameters of ISO 25178-2: how far heights stay alike (Sal), how evenly (Str), and where to (Std)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import Floats
from wafer_viewer.numerics.filters.autocorrelation import autocorrelation

DECAYED = 0.2
"""Of the autocorrelation: heights so far apart are no longer alike."""
WITH_LAY = 0.5
"""Where Str is under it the texture has a lay, and a direction."""
STEP_PX = 0.25
"""Between samples along a ray."""
FIRST_REACH_PX, GROWTH = 32, 4
"""The middle of the autocorrelation that is looked at first; it grows until heights have decayed to all sides."""


@dataclass(frozen=True, slots=True)
class Spatial:
    """Shortest and longest way in px to where heights are no longer alike, and the direction across the lay.

    longest_px: where `ends` is False a lower limit: along some direction they stay alike as far as can be seen.
    """

    shortest_px: float
    longest_px: float
    ends: bool
    direction_deg: float | None

    @property
    def aspect(self) -> float:
        """Str, an upper limit where `ends` is False."""
        return self.shortest_px / self.longest_px


def spatial(z_um: Floats) -> Spatial | None:
    """Of z [row, col] with mean 0, NaN where unmeasured; None where heights stay alike to all sides.

    Lags up to half of the region's sides are looked at: beyond, too few pairs are left to say anything.
    """
    alike = autocorrelation(z_um)
    degrees = np.arange(0.0, 180.0, 1.0)
    ways, ends = _ways(alike, degrees)
    if not ends.any():
        return None
    shortest = _finer(alike, degrees[int(np.argmin(np.where(ends, ways, np.inf)))], np.min, ends_only=True)
    longest = _finer(alike, degrees[int(np.argmax(ways))], np.max)
    all_end = bool(ends.all())
    lay = shortest / longest < WITH_LAY
    return Spatial(shortest, longest, all_end, direction_deg(alike) if lay else None)


def direction_deg(alike: Floats) -> float:
    """Std: where the angular spectrum of an autocorrelation is largest, in 0 ... 180, counter-clockwise from +x.

    The spectrum is the Fourier transform of the autocorrelation under a Hann window: no border shows in it.
    """
    spectrum = _spectrum(alike)
    degrees = np.arange(0.0, 180.0, 1.0)
    best = degrees[int(np.argmax(_angular(spectrum, alike.shape, degrees)))]
    finer = best + np.arange(-1.0, 1.01, 0.1)
    return round(float(finer[int(np.argmax(_angular(spectrum, alike.shape, finer)))]), 1) % 180


def _ways(alike: Floats, degrees: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """How far along each direction heights are alike, px, and whether that ends within what can be seen."""
    middle = np.array([n // 2 for n in alike.shape])
    ways, ends, reach = np.zeros(len(degrees)), np.zeros(len(degrees), bool), FIRST_REACH_PX
    while True:
        down, across = np.minimum(middle, reach)
        part = alike[middle[0] - down : middle[0] + down + 1, middle[1] - across : middle[1] + across + 1]
        going = np.flatnonzero(~ends)
        ways[going], ends[going] = _ways_within(part, degrees[going])
        if ends.all() or reach >= middle.max():
            return ways, ends
        reach *= GROWTH


def _ways_within(alike: Floats, degrees: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    from scipy.ndimage import map_coordinates

    middle = np.array([n // 2 for n in alike.shape])
    along = np.arange(0.0, np.hypot(*middle) + 1, STEP_PX)
    rows, cols = middle[0] - np.outer(_sin(degrees), along), middle[1] + np.outer(_cos(degrees), along)
    known = np.isfinite(alike)
    values: Any = map_coordinates(np.where(known, alike, 0.0), [rows, cols], order=3, mode="nearest")
    seen = (rows >= 0) & (rows <= alike.shape[0] - 1) & (cols >= 0) & (cols <= alike.shape[1] - 1)
    seen &= np.asarray(map_coordinates(known.astype(np.uint8), [rows, cols], order=0, mode="constant")) > 0
    return _first_crossings(np.asarray(values), seen)


def _first_crossings(values: Floats, seen: NDArray[np.bool_]) -> tuple[Floats, NDArray[np.bool_]]:
    """Along each ray [ray, sample] the place where values first fall to DECAYED, or the end of what is seen."""
    stops = (values <= DECAYED) | ~seen
    stops[:, -1] = True
    at = np.argmax(stops, axis=1)
    ray = np.arange(len(at))
    ends = seen[ray, at] & (values[ray, at] <= DECAYED)
    before, after = values[ray, at - 1], values[ray, at]
    share = np.divide(before - DECAYED, before - after, out=np.zeros(len(at)), where=ends & (before > after))
    return (at - 1 + share) * STEP_PX, ends


def _finer(alike: Floats, degree: float, extreme: Any, *, ends_only: bool = False) -> float:
    """The extreme way about a direction, at a twentieth of a degree."""
    ways, ends = _ways(alike, degree + np.arange(-1.0, 1.01, 0.05))
    return float(extreme(ways[ends] if ends_only else ways))


def _spectrum(alike: Floats) -> Floats:
    """Power [row, col], frequency 0 in the middle."""
    from scipy.fft import fft2

    windows = [np.hanning(n + 2)[1:-1] for n in alike.shape]
    tapered = np.nan_to_num(alike) * np.outer(*windows)
    transformed: Any = fft2(np.fft.ifftshift(tapered))
    return np.abs(np.fft.fftshift(transformed.real))


def _angular(spectrum: Floats, shape: tuple[int, ...], degrees: Floats) -> Floats:
    """Power along each direction, summed over frequencies from the region's size to two pixels."""
    from scipy.ndimage import map_coordinates

    frequencies = np.arange(1.0, min(shape) / 2) / min(shape)
    rows = shape[0] // 2 - np.outer(_sin(degrees), frequencies) * shape[0]
    cols = shape[1] // 2 + np.outer(_cos(degrees), frequencies) * shape[1]
    power: Any = map_coordinates(spectrum, [rows, cols], order=1, mode="nearest")
    return np.asarray(power @ frequencies)


def _sin(degrees: Floats) -> Floats:
    return np.sin(np.deg2rad(degrees))


def _cos(degrees: Floats) -> Floats:
    return np.cos(np.deg2rad(degrees))
