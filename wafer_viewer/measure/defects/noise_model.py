"""The noise of quotients over some cells, and how its tail falls: what scores are counted in. Pure.

Heights from focus err in patches, whose tail is much longer than that of normal noise, and how long depends on the
surface, and on whether the ground is plain. So it is measured: beyond START the tail is followed as an exponential
where it falls slower than a normal one would, and a score is the deviation that normal noise would reach as seldom. One
threshold then means the same for heights and picture at every scale.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.defects.golden_die import robust_sigma
from wafer_viewer.measure.defects.ground_kinds import KINDS, Kinds, coarser
from wafer_viewer.measure.defects.matched_filters import SHARP, Spectrum, side_of
from wafer_viewer.measure.dies.die_cells import Plane
from wafer_viewer.numerics.filters.peak_regions import tops_over
from wafer_viewer.numerics.grids.die_cell_kernels import typical

Key = tuple[str, float]
"""A layer and a scale in pixels."""
Planes = dict[Key, Plane]
Floats, Mask = NDArray[np.float32], NDArray[np.bool_]
START = 3.0
"""Deviations from which on the tail is measured: places of noise are many there, and defects few among them."""
NORMAL_FALL, SLOW_FALL = 2.75, 2.2
"""Of the logarithm of how many places reach a deviation: that of normal noise at START, and what is surely slower."""
LEAST_TOPS, MOST_TIMES = 30, 3
LEAST_PIXELS, SAMPLE = 500, 200_000
LOCAL_FROM_CELLS = 5


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """By layer and scale: the spread of quotients, and how fast their tail falls, both [KINDS] by kind of ground.

    places: how much wider than that it is at each place, for layers that are uneven; kinds: of the ground of each pixel
    of a cell; spectrum: of the picture's quotients, which its filters are made by.
    """

    spread: dict[Key, Floats]
    fall: dict[Key, Floats]
    places: dict[Key, Plane]
    kinds: Kinds
    spectrum: Spectrum

    def scores(self, planes: Planes) -> Planes:
        """Quotients in deviations of normal noise."""
        return {key: self._score(key, plane) for key, plane in planes.items()}

    def _score(self, key: Key, plane: Plane) -> Plane:
        if key not in self.spread:
            return plane
        return as_normal(plane / self._everywhere[key], self.fall[key], self._ground[side_of(*key)])

    @cached_property
    def _ground(self) -> dict[int, Kinds]:
        return {side: coarser(self.kinds, side) for side in {side_of(*key) for key in self.spread}}

    @cached_property
    def _everywhere(self) -> Planes:
        """The spread at each place."""
        by_kind = {key: spread[self._ground[side_of(*key)]] for key, spread in self.spread.items()}
        return {key: plane * self.places[key] if key in self.places else plane for key, plane in by_kind.items()}


def noise_of(many: Sequence[Planes], kinds: Kinds, spectrum: Spectrum) -> NoiseModel:
    """The usual noise of quotients over some cells.

    What is alike along edges adds up at wide scales: there the noise is that of each place, where cells are enough. A
    tail that too few places show falls as that of the scale before, of the same layer.
    """
    spread: dict[Key, Floats] = {}
    fall: dict[Key, Floats] = {}
    places: dict[Key, Plane] = {}
    for key in many[0] if many else ():
        planes, ground = [planes[key] for planes in many], coarser(kinds, side_of(*key))
        spread[key] = usual = _by_kind(lambda on, planes=planes: _spread(planes, on), ground, 1.0)
        even = [plane / usual[ground] for plane in planes]
        if len(planes) >= LOCAL_FROM_CELLS and (side_of(*key) > 1 or key[0] in ("detail", SHARP)):
            places[key] = wider = _of_each_place(even)
            even = [plane / wider for plane in even]
        narrower = [float(falls[0]) for (layer, _), falls in fall.items() if layer == key[0]]
        fall[key] = _by_kind(lambda on, even=even: _fall(even, on), ground, (narrower or [NORMAL_FALL])[-1])
    return NoiseModel(spread, fall, places, kinds, spectrum)


def _by_kind(measured: Callable[[Mask], float | None], ground: Kinds, otherwise: float) -> Floats:
    """What is measured on each kind of ground; where there is hardly anything of one, what it is on plainer ground."""
    found: list[float] = []
    for kind in range(KINDS):
        here = measured(ground == kind)
        found.append(here if here is not None else found[-1] if found else otherwise)
    return np.array(found, np.float32)


def as_normal(plane: Plane, fall: Floats, kinds: Kinds) -> Plane:
    """Deviations of noise whose tail falls so fast, as those that normal noise would reach as seldom; signs stay."""
    slow = np.clip((NORMAL_FALL - fall) / (NORMAL_FALL - SLOW_FALL), 0, 1).astype(np.float32)
    if not slow.any():
        return plane
    out = plane.copy()
    far = np.abs(plane) > START
    beyond, kind = np.abs(plane[far]), kinds[far]
    seldom = np.sqrt(START**2 + 2 * fall[kind] * (beyond - START))
    out[far] = np.copysign(beyond + slow[kind] * (np.minimum(seldom, beyond) - beyond), plane[far])
    return out


def _fall(planes: Sequence[Plane], on: Mask) -> float | None:
    """From the median by which places go beyond START: the few defects among them hardly move it.

    A cell with many more such places than others, a die that is missing for one, says nothing of noise.
    """
    each = [tops_over(np.where(on, np.abs(plane), np.float32(0)), START) for plane in planes]
    most = LEAST_TOPS + MOST_TIMES * float(np.median([tops.size for tops in each]))
    tops = np.concatenate([tops for tops in each if tops.size <= most])
    return math.log(2) / max(1e-3, float(np.median(tops)) - START) if tops.size >= LEAST_TOPS else None


def _spread(planes: Sequence[Plane], on: Mask) -> float | None:
    """The median of all cells: one that is missing shall not widen it."""
    at = np.flatnonzero(on)
    if at.size < LEAST_PIXELS:
        return None
    some = at[:: max(1, at.size * len(planes) // SAMPLE)]
    sigmas = [sigma for plane in planes if (sigma := robust_sigma(plane.ravel()[some])) > 0]
    return float(np.median(sigmas)) if sigmas else None


def _of_each_place(planes: Sequence[Plane]) -> Plane:
    """From cell to cell at each place and its neighbours, of quotients of usual spread 1; never less than that."""
    from scipy.ndimage import uniform_filter

    stack = np.stack(planes)
    middle, spread = np.empty(stack.shape[1:], np.float32), np.empty(stack.shape[1:], np.float32)
    typical(stack, 3, middle, spread)
    off = np.where(np.isfinite(spread), spread**2 + middle**2, np.float32(1))
    return np.sqrt(np.maximum(1, uniform_filter(off, 3))).astype(np.float32)
