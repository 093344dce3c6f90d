"""The noise of quotients over some cells, and how its tail falls: what scores are counted in. Pure.

Heights from focus err in patches, whose tail is much longer than that of normal noise, and how long depends on the
surface. So it is measured: beyond START the tail is followed as an exponential where it falls slower than a normal one
would, and a score is the deviation that normal noise would reach as seldom. One threshold then means the same for
heights and picture at every scale.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wafer_viewer.measure.die_cells import Plane
from wafer_viewer.measure.golden import robust_sigma
from wafer_viewer.numerics.cells import typical
from wafer_viewer.numerics.places import tops_over
from wafer_viewer.numerics.smoothing import coarseness

Key = tuple[str, float]
"""A layer and a scale in pixels."""
Planes = dict[Key, Plane]
START = 3.0
"""Deviations from which on the tail is measured: places of noise are many there, and defects few among them."""
NORMAL_FALL, SLOW_FALL = 2.75, 2.2
"""Of the logarithm of how many places reach a deviation: that of normal noise at START, and what is surely slower."""
LEAST_TOPS = 30
LOCAL_FROM_CELLS = 5


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """By layer and scale: the spread of quotients, of wide scales for each place, and how fast their tail falls."""

    spread: dict[Key, float | Plane]
    fall: dict[Key, float]

    def scores(self, planes: Planes) -> Planes:
        """Quotients in deviations of normal noise."""
        return {
            key: as_normal(plane / np.asarray(self.spread.get(key, 1.0), np.float32), self.fall.get(key, NORMAL_FALL))
            for key, plane in planes.items()
        }


def noise_of(many: Sequence[Planes]) -> Noise:
    """The usual noise of quotients over some cells.

    What is alike along edges adds up at wide scales: there the noise is that of each place, where cells are enough.
    """
    spread: dict[Key, float | Plane] = {}
    fall: dict[Key, float] = {}
    for key in many[0] if many else ():
        planes = [planes[key] for planes in many]
        spread[key] = here = _spread(planes, key)
        fall[key] = _fall([np.abs(plane / np.asarray(here, np.float32)) for plane in planes])
    return Noise(spread, fall)


def as_normal(plane: Plane, fall: float) -> Plane:
    """Deviations of noise whose tail falls so fast, as those that normal noise would reach as seldom; signs stay."""
    slow = min(1.0, (NORMAL_FALL - fall) / (NORMAL_FALL - SLOW_FALL))
    if slow <= 0:
        return plane
    out = plane.copy()
    far = np.abs(plane) > START
    beyond = np.abs(plane[far])
    seldom = np.sqrt(START**2 + 2 * fall * (beyond - START))
    out[far] = np.copysign(beyond + np.float32(slow) * (np.minimum(seldom, beyond) - beyond), plane[far])
    return out


def _fall(planes: Sequence[Plane]) -> float:
    """From the median by which places go beyond START: the few defects among them hardly move it."""
    tops = np.concatenate([tops_over(plane, START) for plane in planes])
    return math.log(2) / max(1e-3, float(np.median(tops)) - START) if tops.size >= LEAST_TOPS else NORMAL_FALL


def _spread(planes: list[Plane], key: Key) -> float | Plane:
    sigmas = [sigma for plane in planes if (sigma := robust_sigma(plane)) > 0]
    usual = float(np.median(sigmas)) if sigmas else 1.0
    uneven = coarseness(key[1]) > 1 or key[0] == "detail"
    return _of_each_place(planes, usual) if uneven and len(planes) >= LOCAL_FROM_CELLS else usual


def _of_each_place(planes: list[Plane], usual: float) -> Plane:
    """From cell to cell at each place and its neighbours, never less than the usual."""
    from scipy.ndimage import uniform_filter

    stack = np.stack(planes)
    middle, spread = np.empty(stack.shape[1:], np.float32), np.empty(stack.shape[1:], np.float32)
    typical(stack, 3, middle, spread)
    off = np.where(np.isfinite(spread), spread**2 + middle**2, usual**2)
    return np.maximum(usual, np.sqrt(uniform_filter(off, 3))).astype(np.float32)
