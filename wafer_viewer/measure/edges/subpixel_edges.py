"""Where grey values change most steeply along search lines, to a fraction of a pixel. Pure, on arrays.

The response to a step is that of the derivative of a Gaussian. Of a step blurred by a Gaussian it is a Gaussian itself,
whose logarithm is a parabola: through three of its values goes exactly one, and its top is the edge.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from wafer_viewer.measure.base.height_samples import Floats

SIGMA_PX = 2.0
"""Standard deviation of the Gaussian whose derivative finds edges."""
SEARCH_SIGMA_PX = 4.0
"""The same while edges are looked for: thin lines count less then than the ragged edge of something large."""
REACH, REACH_PX = 3.0, 6
"""So far from it a pixel has a say in the response: in standard deviations, and in pixels."""
AS_STEEP = 0.5
"""Of an edge's typical steepness: what is less steep is no part of the edge."""
U_SUBPIXEL_PX = 0.002
"""Standard uncertainty (k = 1) of an edge for where it lies between two pixels, on steps blurred by 0.7 px or more:
`tests/measure/edges/test_subpixel_edges.py` looks for a larger one."""
MOST_APART = 4
Responses = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class EdgePoints:
    """Points of an edge, in lines and places of a strip, float64 [n]."""

    line: Floats
    place: Floats

    def __len__(self) -> int:
        return len(self.line)


def responses(
    grey: NDArray[np.floating], there: NDArray[np.bool_] | None = None, sigma_px: float = SIGMA_PX
) -> Responses:
    """How grey values rise along search lines, [line, place], grey values a pixel; 0 where pixels are missing."""
    found: Responses = np.zeros(grey.shape, np.float32)
    gaussian_filter1d(grey.astype(np.float32), sigma_px, axis=1, order=1, output=found, mode="nearest", truncate=4.0)
    if there is not None and not there.all():
        near_missing: NDArray[np.bool_] = np.empty(there.shape, bool)
        maximum_filter1d(~there, 2 * round(REACH * sigma_px) + 1, axis=1, output=near_missing)
        found[near_missing] = 0.0
    found[:, : REACH_PX // 2] = found[:, -(REACH_PX // 2) :] = 0.0
    return found


def peaks(rising: Responses) -> NDArray[np.bool_]:
    """Where a response is higher than beside it, [line, place]."""
    found = np.zeros(rising.shape, bool)
    middle = rising[:, 1:-1]
    found[:, 1:-1] = (middle > 0) & (middle > rising[:, :-2]) & (middle >= rising[:, 2:])
    return found


def between_pixels(rising: Responses, line: NDArray[np.intp], place: NDArray[np.intp]) -> Floats:
    """The places of the peaks of one edge to a fraction of a pixel, float64 [n].

    The wider the edge, the further apart are the values that the parabola goes through, so that noise counts less.
    """
    apart = _apart(rising, line, place)
    before, top, after = _logarithms(rising, line, place, apart)
    bend = before - 2 * top + after
    moved = np.where(bend < 0, 0.5 * apart * (before - after) / np.where(bend < 0, bend, 1.0), 0.0)
    return place.astype(np.float64) + np.clip(moved, -1.0, 1.0)


def _apart(rising: Responses, line: NDArray[np.intp], place: NDArray[np.intp]) -> int:
    """About the standard deviation of the response, whole pixels."""
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
    """On each line one edge near to where it is expected, of those that are steep enough.

    expected: a place on each line; reach: how far before and behind it is looked. Lines without an edge are left out.
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
    """How steep an edge is near where it is expected: the median over the lines."""
    near = np.round(expected).astype(np.intp)[:, None] + np.arange(-REACH_PX // 2, REACH_PX // 2 + 1)[None, :]
    inside = np.clip(near, 0, rising.shape[1] - 1)
    return max(float(np.median(np.take_along_axis(rising, inside, axis=1).max(axis=1))), 1e-6)
