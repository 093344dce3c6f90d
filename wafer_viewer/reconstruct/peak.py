"""Where along z a pixel is sharpest, between the frames, and how much the peak stands out.

All values of the focus volume are logarithms (base 2). A Gaussian through three points is a parabola there, a tent has
straight flanks; both pull the peak towards or away from the nearest frame by up to a twentieth of a step. The blur law
does not: the variance of the blur is a parabola in z, and the focus measure is a known power of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.stack import Image
from wafer_viewer.numerics.arrays import Float32s, Float64s, Greys, Real, UInt16s, Whole
from wafer_viewer.numerics.jit import inline_kernel, kernel

_ARGMAX, _GAUSSIAN, _TENT, _BLUR_LAW = 0, 1, 2, 3


@dataclass(frozen=True, slots=True)
class PeakEstimator:
    """How the peak is placed between the frames: the kernels' code, what it is, where it is from."""

    code: int
    title: str
    source: str


PEAKS: dict[str, PeakEstimator] = {
    "argmax": PeakEstimator(_ARGMAX, "The sharpest frame", "eq. 6"),
    "gaussian": PeakEstimator(_GAUSSIAN, "Gaussian through three points", "Nayar and Nakagawa 1994"),
    "tent": PeakEstimator(_TENT, "Symmetric tent through three points", "flanks of equal slope on log focus"),
    "blur_law": PeakEstimator(_BLUR_LAW, "Parabola of the blur's variance", "sigma^2 = s0^2 + (c z)^2"),
}


class Curves(NamedTuple):
    """The focus volume of a block, levels [k, row, col], and of each pixel the peak's frame, its rival, the least."""

    levels: UInt16s
    peak: UInt16s
    rival: UInt16s
    least: UInt16s


class Placing(NamedTuple):
    """How peaks are placed: the estimator's code, the power of the blur law, and the frames to rivals and flanks."""

    estimator: int
    power: float
    gap: int
    reach: int


class Scores(NamedTuple):
    """The part of `Peaks` that comes from the focus volume."""

    z_um: Float32s
    lead: Float32s
    fall: Float32s
    contrast: Float32s
    all_in_focus: Greys


@dataclass(frozen=True, slots=True, eq=False)
class Peaks:
    """What the focus volume says of each pixel, all arrays [row, col].

    z_um: float32; lead, fall and contrast: float32, in powers of two of the focus measure: how far the peak is above
    its highest rival, above its own flanks, and above the lowest frame; at_end: bool; clipped: uint16, number of frames
    in which the pixel is too bright; all_in_focus: grey as in the stack.
    """

    z_um: NDArray[np.float32]
    lead: NDArray[np.float32]
    fall: NDArray[np.float32]
    contrast: NDArray[np.float32]
    at_end: NDArray[np.bool_]
    clipped: NDArray[np.uint16]
    all_in_focus: Image

    @classmethod
    def empty(cls, shape: tuple[int, int], dtype: np.dtype[Any]) -> Peaks:
        """Room for the peaks of a field or of a part of it."""
        z_um, lead, fall, contrast = (np.empty(shape, np.float32) for _ in range(4))
        return cls(
            z_um, lead, fall, contrast, np.empty(shape, bool), np.empty(shape, np.uint16), np.empty(shape, dtype)
        )

    @property
    def scores(self) -> Scores:
        """What `describe` writes."""
        return Scores(self.z_um, self.lead, self.fall, self.contrast, self.all_in_focus)

    @property
    def confidence(self) -> NDArray[np.float32]:
        """0 ... 1: the share of the focus measure at the peak that its highest rival does not reach."""
        return np.float32(1) - np.exp2(-self.lead)

    def rows(self, part: slice) -> Peaks:
        """Some of the rows, as views."""
        return Peaks(*(getattr(self, name)[part] for name in self.__slots__))


def confidence_of(lead: float) -> float:
    """The confidence of a peak that is 2^lead times its highest rival."""
    return 1.0 - 2.0**-lead


def lead_of(confidence: float) -> float:
    """The lead, in powers of two, that a confidence means."""
    return float(-np.log2(max(1e-9, 1.0 - confidence)))


def log2_table(mantissa_bits: int) -> NDArray[np.float32]:
    """log2(1 + fraction) of each mantissa of a level."""
    return np.log2(1 + np.arange(2**mantissa_bits) / 2**mantissa_bits).astype(np.float32)


@kernel
def find_rivals(curves: Curves, gap: Whole) -> None:
    """The highest other local maximum at least `gap` frames from the peak, and the lowest level of each pixel.

    Without a rival the lowest level stands in.
    """
    levels, peak, rival, least = curves
    last = levels.shape[0] - 1
    for y in range(peak.shape[0]):
        rival[y] = 0
        least[y] = 65535
        for k in range(last + 1):
            _rival_row(levels[max(k - 1, 0), y], levels[k, y], levels[min(k + 1, last), y], k, gap, peak[y], rival[y])
            _lower(levels[k, y], least[y])
        _raise(least[y], rival[y])


@kernel
def _rival_row(
    before: UInt16s, here: UInt16s, after: UInt16s, k: Whole, gap: Whole, peak: UInt16s, rival: UInt16s
) -> None:
    i = np.int32
    frame = i(k)
    low, high = i(-gap), i(gap)
    for x in range(here.size):
        q = i(here[x])
        away = i(i(peak[x]) - frame)
        top = (q >= i(before[x])) & (q >= i(after[x])) & ((away <= low) | (away >= high))
        candidate = q if top else i(0)
        old = i(rival[x])
        rival[x] = candidate if candidate > old else old


@kernel
def _lower(here: UInt16s, least: UInt16s) -> None:
    for x in range(here.size):
        a, b = here[x], least[x]
        least[x] = a if a < b else b


@kernel
def _raise(floor: UInt16s, values: UInt16s) -> None:
    for x in range(values.size):
        a, b = floor[x], values[x]
        values[x] = a if a > b else b


@kernel
def describe(
    curves: Curves,
    block: Greys,
    margin: Whole,
    z_um: Float64s,
    placing: Placing,
    table: Float32s,
    out: Scores,
) -> None:
    """Height, scores and all-in-focus grey of each pixel, from the levels round its peak."""
    levels, last = curves.levels, curves.levels.shape[0] - 1
    bits = 0
    while 1 << bits < table.size:
        bits += 1
    for y in range(levels.shape[1]):
        for x in range(levels.shape[2]):
            k = np.int64(curves.peak[y, x])
            near = min(placing.reach, k, last - k)
            top = _log2(levels[k, y, x], bits, table)
            left = _log2(levels[k - near, y, x], bits, table)
            right = _log2(levels[k + near, y, x], bits, table)
            before = _log2(levels[max(0, k - placing.gap), y, x], bits, table)
            after = _log2(levels[min(last, k + placing.gap), y, x], bits, table)
            out.z_um[y, x] = place(placing, z_um[k - near], z_um[k], z_um[k + near], left, top, right)
            out.lead[y, x] = top - _log2(curves.rival[y, x], bits, table)
            out.contrast[y, x] = top - _log2(curves.least[y, x], bits, table)
            out.fall[y, x] = top - max(before, after)
            out.all_in_focus[y, x] = block[k, y + margin, x + margin]


@inline_kernel
def _log2(level: Whole, bits: Whole, table: Float32s) -> Real:
    q = np.int64(level)
    return np.float32(q >> bits) + table[q & ((1 << bits) - 1)]


@kernel
def place(how: Placing, below: Real, z: Real, above: Real, left: Real, top: Real, right: Real) -> Real:
    """The z of the peak from log focus at three z, between the middles of the two intervals."""
    if how.estimator == _ARGMAX or below == z or above == z:
        return z
    if how.estimator == _TENT:
        found = _tent(below, z, above, left, top, right)
    elif how.estimator == _GAUSSIAN:
        found = _parabola(below, z, above, left, top, right)
    else:
        found = _blur_law(how.power, below, z, above, left, top, right)
    return min(max(found, 0.5 * (below + z)), 0.5 * (z + above))


@kernel
def _parabola(below: Real, z: Real, above: Real, left: Real, top: Real, right: Real) -> Real:
    """The vertex of the parabola through three points, at any spacing."""
    a = (z - below) * (top - right)
    b = (above - z) * (top - left)
    return z if a + b <= 0 else z - 0.5 * ((z - below) * a - (above - z) * b) / (a + b)


@kernel
def _blur_law(power: Real, below: Real, z: Real, above: Real, left: Real, top: Real, right: Real) -> Real:
    """Where the variance of the blur, focus^(-1 / power), has its least value: it is a parabola in z."""
    return _parabola(below, z, above, -(2 ** ((top - left) / power)), -1.0, -(2 ** ((top - right) / power)))


@kernel
def _tent(below: Real, z: Real, above: Real, left: Real, top: Real, right: Real) -> Real:
    """Where two lines of equal and opposite slope meet: the steeper side gives the slope, the other point the place."""
    rise, drop = (top - left) / (z - below), (top - right) / (above - z)
    if max(rise, drop) <= 0:
        return z
    if rise >= drop:
        return 0.5 * (z + above) - (top - right) / (2 * rise)
    return 0.5 * (below + z) + (top - left) / (2 * drop)
