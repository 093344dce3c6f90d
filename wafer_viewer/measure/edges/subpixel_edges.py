"""Subpixel positions of the steepest grey gradients along search lines. Pure, on arrays.

The filter is the derivative of a Gaussian. Its response to a step blurred by a Gaussian is itself a Gaussian, whose
logarithm is a parabola: three values determine it, and its vertex is the edge.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from wafer_viewer.measure.base.height_samples import Floats

SIGMA_PX = 2.0
"""Standard deviation of the Gaussian of the edge filter."""
SEARCH_SIGMA_PX = 4.0
"""Standard deviation for edge detection, where thin lines must count less than ragged edges of large areas."""
REACH, REACH_PX = 3.0, 6
"""Extent of the filter, in standard deviations and in pixels."""
AS_STEEP = 0.5
"""Smallest steepness of an edge point relative to the typical steepness of the edge."""
U_SUBPIXEL_PX = 0.002
"""Standard uncertainty (k = 1) of an edge due to its subpixel position, on steps blurred by 0.7 px or more.

`tests/measure/edges/test_subpixel_edges.py` searches for a larger one.
"""
MOST_APART = 4
Responses = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class EdgePoints:
    """Points of an edge, in line and place coordinates of a strip, float64 [n]."""

    line: Floats
    place: Floats

    def __len__(self) -> int:
        return len(self.line)


def responses(
    grey: NDArray[np.floating], there: NDArray[np.bool_] | None = None, sigma_px: float = SIGMA_PX
) -> Responses:
    """Return the gradient along search lines, [line, place], grey values per pixel; 0 near missing pixels."""
    found: Responses = np.zeros(grey.shape, np.float32)
    gaussian_filter1d(grey.astype(np.float32), sigma_px, axis=1, order=1, output=found, mode="nearest", truncate=4.0)
    if there is not None and not there.all():
        near_missing: NDArray[np.bool_] = np.empty(there.shape, bool)
        maximum_filter1d(~there, 2 * round(REACH * sigma_px) + 1, axis=1, output=near_missing)
        found[near_missing] = 0.0
    found[:, : REACH_PX // 2] = found[:, -(REACH_PX // 2) :] = 0.0
    return found


def peaks(rising: Responses) -> NDArray[np.bool_]:
    """Return the mask of local maxima along search lines, [line, place]."""
    found = np.zeros(rising.shape, bool)
    middle = rising[:, 1:-1]
    found[:, 1:-1] = (middle > 0) & (middle > rising[:, :-2]) & (middle >= rising[:, 2:])
    return found


def between_pixels(rising: Responses, line: NDArray[np.intp], place: NDArray[np.intp]) -> Floats:
    """Return the subpixel places of the peaks of one edge, float64 [n].

    For wider edges, the values that determine the parabola are further apart, which reduces the effect of noise.
    """
    apart = _apart(rising, line, place)
    before, top, after = _logarithms(rising, line, place, apart)
    bend = before - 2 * top + after
    moved = np.where(bend < 0, 0.5 * apart * (before - after) / np.where(bend < 0, bend, 1.0), 0.0)
    return place.astype(np.float64) + np.clip(moved, -1.0, 1.0)


def _apart(rising: Responses, line: NDArray[np.intp], place: NDArray[np.intp]) -> int:
    """Return approximately the standard deviation of the response, in integer pixels."""
    if not len(line):
        return 1
    before, top, after = (float(np.median(values)) for values in _logarithms(rising, line, place, 1))
    bend = 2 * top - before - after
    return int(np.clip(round(bend**-0.5), 1, MOST_APART)) if bend > 0 else MOST_APART


def _logarithms(rising: Responses, line: NDArray[np.intp], place: NDArray[np.intp], apart: int) -> tuple[Floats, ...]:
    last = rising.shape[1] - 1
    values = (rising[line, np.clip(place + k, 0, last)] for k in (-apart, 0, apart))
    return tuple(np.log(np.maximum(value, 1e-6).astype(np.float64)) for value in values)


def edges_near(
    rising: Responses, expected: Floats, reach: tuple[float, float], choose: Literal["nearest", "steepest"] = "steepest"
) -> EdgePoints:
    """Return one sufficiently steep edge point per line, near its expected place.

    expected: a place on each line; reach: search distance before and behind it. Lines without an edge are left out.
    """
    place = np.arange(rising.shape[1])[None, :]
    away = place - expected[:, None]
    good = peaks(rising) & (away >= -reach[0]) & (away <= reach[1])
    good &= rising >= AS_STEEP * typical(rising, expected)
    worth = np.where(good, -np.abs(away) if choose == "nearest" else rising, -np.inf)
    at = np.argmax(worth, axis=1)
    line = np.flatnonzero(np.isfinite(worth[np.arange(len(at)), at]))
    return EdgePoints(line.astype(np.float64), between_pixels(rising, line, at[line]))


def typical(rising: Responses, expected: Floats) -> float:
    """Return the steepness of an edge near its expected place: median over the lines."""
    near = np.round(expected).astype(np.intp)[:, None] + np.arange(-REACH_PX // 2, REACH_PX // 2 + 1)[None, :]
    inside = np.clip(near, 0, rising.shape[1] - 1)
    return max(float(np.median(np.take_along_axis(rising, inside, axis=1).max(axis=1))), 1e-6)
