"""Noise model of the quotients over some cells, by the kind of ground. Pure.

Height errors from focus are clustered; their tail is much longer than that of normal noise, and depends on the surface
and on the ground. It is therefore measured: beyond `NOISE.start` the tail is modelled as an exponential where it falls
more slowly than a normal one. A score is the deviation that normal noise exceeds equally rarely. One threshold then has
the same meaning for heights and image at every scale.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.defects.golden_die import ReferenceDie, robust_sigma
from wafer_viewer.measure.defects.matched_filters import SHARP, Spectrum, side_of
from wafer_viewer.measure.dies.die_cells import Plane
from wafer_viewer.numerics.filters.regions import region_maxima
from wafer_viewer.numerics.filters.sliding_filters import sliding_range
from wafer_viewer.numerics.grids.die_cell_kernels import median_and_spread


@dataclass(frozen=True, slots=True)
class NoiseParameters:
    """Limits of the noise model.

    Parameters
    ----------
    plain_to : float
        Largest relief of plain ground, in median spreads.
    around_px : int, px
        Window of that relief.
    start : float
        Deviation from which the tail is measured: noise peaks are many there, and defects few among them.
    normal_fall : float
        Decay rate of the log number of peaks by deviation, of normal noise at `start`.
    slow_fall : float
        The same of a surely longer tail.
    least_tops : int
        Smallest number of peaks beyond `start` for a decay rate.
    most_times : float
        A cell with more peaks than `least_tops` plus so many times the median is excluded.
    least_pixels : int
        Smallest number of pixels of a class of ground for a spread.
    sample : int
        Approximate number of pixels of all cells sampled for a spread.
    local_from_cells : int
        Number of cells from which the noise at wide scales is local.
    least_local : int
        Smallest number of known values of a position for its own spread.
    local_px : int, px
        Window over which local spreads are pooled.

    Notes
    -----
    `tests/bench/bench_defects.py` and `tests/bench/bench_defects_truth.py` count captured and false defects with
    these values.
    """

    plain_to: float = 4.0
    around_px: int = 5
    start: float = 3.0
    normal_fall: float = 2.75
    slow_fall: float = 2.2
    least_tops: int = 30
    most_times: float = 3
    least_pixels: int = 500
    sample: int = 200_000
    local_from_cells: int = 5
    least_local: int = 3
    local_px: int = 3


NOISE = NoiseParameters()
KINDS = 4
"""Number of ground classes: plain (0), without heights (1), uneven in the image (2), uneven in the heights (3).

Plain ground without heights was nowhere in focus: the image there is an arbitrary blurred frame.
"""
Kinds = NDArray[np.uint8]


def kinds_of(golden: ReferenceDie) -> Kinds:
    """Return the ground class of every pixel of a cell."""
    layers = (golden.picture, golden.picture_spread), (golden.z_um, golden.z_spread_um)
    patterned, walled = (
        sliding_range(layer, NOISE.around_px) > NOISE.plain_to * _usual(spread) for layer, spread in layers
    )
    return np.select([walled, patterned, np.isnan(golden.z_um)], [3, 2, 1], 0).astype(np.uint8)


def coarser(kinds: Kinds, side: int) -> Kinds:
    """Return the most uneven ground class in squares of `side` pixels; incomplete squares are dropped."""
    rows, cols = (n // side for n in kinds.shape)
    return kinds[: rows * side, : cols * side].reshape(rows, side, cols, side).max(axis=(1, 3)) if side > 1 else kinds


def _usual(spread: Plane) -> float:
    finite = spread[np.isfinite(spread)]
    return float(np.median(finite)) if finite.size else 1.0


Key = tuple[str, float]
"""Layer and scale in pixels."""
Planes = dict[Key, Plane]
Floats, Mask = NDArray[np.float32], NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Spread of quotients and decay rate of their tail by layer and scale, both [KINDS] by ground class.

    places: ratio of the local spread to that, for uneven layers; kinds: ground class of each pixel of a cell; spectrum:
    noise spectrum of the image quotients, used by the matched filters.
    """

    spread: dict[Key, Floats]
    fall: dict[Key, Floats]
    places: dict[Key, Plane]
    kinds: Kinds
    spectrum: Spectrum

    def scores(self, planes: Planes) -> Planes:
        """Convert quotients to deviations of normal noise."""
        return {key: self._score(key, plane) for key, plane in planes.items()}

    def _score(self, key: Key, plane: Plane) -> Plane:
        if key not in self.spread:
            return plane
        return to_normal_deviations(plane / self._everywhere[key], self.fall[key], self._ground[side_of(*key)])

    @cached_property
    def _ground(self) -> dict[int, Kinds]:
        return {side: coarser(self.kinds, side) for side in {side_of(*key) for key in self.spread}}

    @cached_property
    def _everywhere(self) -> Planes:
        """Spread at each position."""
        by_kind = {key: spread[self._ground[side_of(*key)]] for key, spread in self.spread.items()}
        return {key: plane * self.places[key] if key in self.places else plane for key, plane in by_kind.items()}


def noise_of(many: Sequence[Planes], kinds: Kinds, spectrum: Spectrum) -> NoiseModel:
    """Estimate the noise model from quotients of some cells.

    Noise that is correlated along edges accumulates at wide scales: there the noise is local, if there are enough
    cells. A tail with too few peaks takes the decay rate of the scale before, of the same layer.
    """
    spread: dict[Key, Floats] = {}
    fall: dict[Key, Floats] = {}
    places: dict[Key, Plane] = {}
    for key in many[0] if many else ():
        planes, ground = [planes[key] for planes in many], coarser(kinds, side_of(*key))
        spread[key] = usual = _by_kind(lambda on, planes=planes: _spread(planes, on), ground, 1.0)
        even = [plane / usual[ground] for plane in planes]
        if len(planes) >= NOISE.local_from_cells and (side_of(*key) > 1 or key[0] in ("detail", SHARP)):
            places[key] = wider = _of_each_place(even)
            even = [plane / wider for plane in even]
        narrower = [float(falls[0]) for (layer, _), falls in fall.items() if layer == key[0]]
        fall[key] = _by_kind(lambda on, even=even: _fall(even, on), ground, (narrower or [NOISE.normal_fall])[-1])
    return NoiseModel(spread, fall, places, kinds, spectrum)


def _by_kind(measured: Callable[[Mask], float | None], ground: Kinds, otherwise: float) -> Floats:
    """Evaluate a statistic on each ground class; a class with too few pixels takes that of plainer ground."""
    found: list[float] = []
    for kind in range(KINDS):
        of_kind = measured(ground == kind)
        found.append(of_kind if of_kind is not None else found[-1] if found else otherwise)
    return np.array(found, np.float32)


def to_normal_deviations(plane: Plane, fall: Floats, kinds: Kinds) -> Plane:
    """Convert deviations of long-tailed noise to equally rare deviations of normal noise; signs are preserved."""
    slow = np.clip((NOISE.normal_fall - fall) / (NOISE.normal_fall - NOISE.slow_fall), 0, 1).astype(np.float32)
    if not slow.any():
        return plane
    out = plane.copy()
    far = np.abs(plane) > NOISE.start
    beyond, kind = np.abs(plane[far]), kinds[far]
    seldom = np.sqrt(NOISE.start**2 + 2 * fall[kind] * (beyond - NOISE.start))
    out[far] = np.copysign(beyond + slow[kind] * (np.minimum(seldom, beyond) - beyond), plane[far])
    return out


def _fall(planes: Sequence[Plane], on: Mask) -> float | None:
    """Return the decay rate from the median excess of peaks over `NOISE.start`, which few defects hardly affect.

    A cell with many more such peaks than the others, such as a missing die, is excluded.
    """
    each = [region_maxima(np.where(on, np.abs(plane), np.float32(0)), NOISE.start) for plane in planes]
    most = NOISE.least_tops + NOISE.most_times * float(np.median([tops.size for tops in each]))
    tops = np.concatenate([tops for tops in each if tops.size <= most])
    return math.log(2) / max(1e-3, float(np.median(tops)) - NOISE.start) if tops.size >= NOISE.least_tops else None


def _spread(planes: Sequence[Plane], on: Mask) -> float | None:
    """Return the median spread over all cells, which a missing one does not widen."""
    index = np.flatnonzero(on)
    if index.size < NOISE.least_pixels:
        return None
    some = index[:: max(1, index.size * len(planes) // NOISE.sample)]
    sigmas = [sigma for plane in planes if (sigma := robust_sigma(plane.ravel()[some])) > 0]
    return float(np.median(sigmas)) if sigmas else None


def _of_each_place(planes: Sequence[Plane]) -> Plane:
    """Return the local spread between cells, pooled with neighbours, of quotients with spread 1; at least 1."""
    from scipy.ndimage import uniform_filter

    stack = np.stack(planes)
    middle, spread = np.empty(stack.shape[1:], np.float32), np.empty(stack.shape[1:], np.float32)
    median_and_spread(stack, NOISE.least_local, middle, spread)
    off = np.where(np.isfinite(spread), spread**2 + middle**2, np.float32(1))
    return np.sqrt(np.maximum(1, uniform_filter(off, NOISE.local_px))).astype(np.float32)
