"""Spatial parameters of areal texture (ISO 25178-2): autocorrelation length, aspect ratio and direction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.height_samples import Floats
from wafer_viewer.numerics.fourier import autocorrelation

DECAYED = 0.2
"""Autocorrelation threshold of Sal and Str."""
WITH_LAY = 0.5
"""Str below which the texture has a lay and a direction."""
STEP_PX = 0.25
"""Sampling step along a ray."""
FIRST_REACH_PX = 32
"""Initial half-size of the central part of the autocorrelation, px."""
GROWTH = 4
"""Factor by which that grows until the autocorrelation has decayed on all sides."""

DECAY_STEP_DEG = 0.05
"""Step of the fine search for the shortest and the longest decay, degrees."""
STD_STEP_DEG = 0.1
"""Step of the fine search for the direction of the texture, degrees."""


@dataclass(frozen=True, slots=True)
class Spatial:
    """Shortest and longest decay lengths of the autocorrelation in px, and the direction across the lay.

    longest_px: a lower limit where `ends` is False, because along some direction there is no decay within the range.
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
    """Return the spatial parameters of z [row, col] with mean 0, NaN where unmeasured; None without any decay.

    Lags are limited to half of the region's sides; beyond, too few pairs remain.
    """
    acf = autocorrelation(z_um)
    degrees = np.arange(0.0, 180.0, 1.0)
    lags_px, ends = _decay_lags(acf, degrees)
    if not ends.any():
        return None
    shortest = _finer(acf, degrees[int(np.argmin(np.where(ends, lags_px, np.inf)))], np.min, ends_only=True)
    longest = _finer(acf, degrees[int(np.argmax(lags_px))], np.max)
    all_end = bool(ends.all())
    lay = shortest / longest < WITH_LAY
    return Spatial(shortest, longest, all_end, direction_deg(acf) if lay else None)


def direction_deg(acf: Floats) -> float:
    """Return Std: direction of the largest angular spectrum, in 0 ... 180, counter-clockwise from +x.

    The spectrum is the Fourier transform of the autocorrelation under a Hann window, which suppresses border effects.
    """
    spectrum = _spectrum(acf)
    degrees = np.arange(0.0, 180.0, 1.0)
    best = degrees[int(np.argmax(_angular(spectrum, acf.shape, degrees)))]
    finer = best + np.arange(-1.0, 1.01, STD_STEP_DEG)
    return round(float(finer[int(np.argmax(_angular(spectrum, acf.shape, finer)))]), 1) % 180


def _decay_lags(acf: Floats, degrees: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the decay length along each direction, px, and whether decay occurs within the range."""
    middle = np.array([n // 2 for n in acf.shape])
    lags_px, ends, reach = np.zeros(len(degrees)), np.zeros(len(degrees), bool), FIRST_REACH_PX
    while True:
        down, across = np.minimum(middle, reach)
        part = acf[middle[0] - down : middle[0] + down + 1, middle[1] - across : middle[1] + across + 1]
        going = np.flatnonzero(~ends)
        lags_px[going], ends[going] = _decay_lags_within(part, degrees[going])
        if ends.all() or reach >= middle.max():
            return lags_px, ends
        reach *= GROWTH


def _decay_lags_within(acf: Floats, degrees: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    from scipy.ndimage import map_coordinates

    middle = np.array([n // 2 for n in acf.shape])
    along = np.arange(0.0, np.hypot(*middle) + 1, STEP_PX)
    rows, cols = middle[0] - np.outer(_sin(degrees), along), middle[1] + np.outer(_cos(degrees), along)
    finite = np.isfinite(acf)
    values: Any = map_coordinates(np.where(finite, acf, 0.0), [rows, cols], order=3, mode="nearest")
    valid = (rows >= 0) & (rows <= acf.shape[0] - 1) & (cols >= 0) & (cols <= acf.shape[1] - 1)
    valid &= np.asarray(map_coordinates(finite.astype(np.uint8), [rows, cols], order=0, mode="constant")) > 0
    return _first_crossings(np.asarray(values), valid)


def _first_crossings(values: Floats, valid: NDArray[np.bool_]) -> tuple[Floats, NDArray[np.bool_]]:
    """Return, for each ray [ray, sample], the first crossing of DECAYED, or the end of the known range."""
    stops = (values <= DECAYED) | ~valid
    stops[:, -1] = True
    crossing = np.argmax(stops, axis=1)
    ray = np.arange(len(crossing))
    ends = valid[ray, crossing] & (values[ray, crossing] <= DECAYED)
    before, after = values[ray, crossing - 1], values[ray, crossing]
    share = np.divide(before - DECAYED, before - after, out=np.zeros(len(crossing)), where=ends & (before > after))
    return (crossing - 1 + share) * STEP_PX, ends


def _finer(acf: Floats, degree: float, extreme: Any, *, ends_only: bool = False) -> float:
    """Return the extreme decay length about a direction, in steps of a twentieth of a degree."""
    lags_px, ends = _decay_lags(acf, degree + np.arange(-1.0, 1.01, DECAY_STEP_DEG))
    return float(extreme(lags_px[ends] if ends_only else lags_px))


def _spectrum(acf: Floats) -> Floats:
    """Return the power spectrum [row, col], with frequency 0 at the centre."""
    from scipy.fft import fft2

    windows = [np.hanning(n + 2)[1:-1] for n in acf.shape]
    tapered = np.nan_to_num(acf) * np.outer(*windows)
    transformed: Any = fft2(np.fft.ifftshift(tapered))
    return np.abs(np.fft.fftshift(transformed.real))


def _angular(spectrum: Floats, shape: tuple[int, ...], degrees: Floats) -> Floats:
    """Return the power along each direction, summed over frequencies from the region's size to two pixels."""
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
