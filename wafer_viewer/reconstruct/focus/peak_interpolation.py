"""Peak position of each pixel from three points of its focus curve.

A Gaussian is a parabola in the logarithm, a tent has straight flanks, and the blur law makes the variance of the blur a
parabola in z; all are biased towards or away from the nearest frame by up to a twentieth of a step
(`tests/bench/bench_phase.py`). The centred peak takes all frames of a curve's top (`peak_centring`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from wafer_viewer.numerics.jit import (
    Float32s,
    Float64s,
    Int,
    Real,
    UInt16s,
    aligned,
    inline_kernel,
    lean_kernel,
    lean_part,
    quick_log2,
)
from wafer_viewer.reconstruct.focus.focus_volume import FocusCurves, LevelTable, log2_of

_ARGMAX, _GAUSSIAN, _TENT, _BLUR_LAW, _CENTRED = 0, 1, 2, 3, 4
"""Codes of the estimators, for the kernels."""
_LEAST_SHARE = 0.02
"""Minimum fraction of a level that counts as focus rather than noise floor."""
_LN2 = float(np.log(2))
"""Natural logarithm of 2."""
_ROUNDER = 1.5 * 2.0**52
"""A float64 this large has no fraction bits; its lowest mantissa bits hold an integer."""
_NO_FLOOR = -64.0
"""Noise floor of a curve that does not reach it, as a logarithm to base 2."""
_NEAR_TOPS = 2
"""Averages above and below the peak that may replace the one at the peak itself."""


@dataclass(frozen=True, slots=True)
class PeakEstimator:
    """A peak estimator: the kernels' code, title and source.

    blended: True if the peak is placed on a curve averaged along z.
    """

    code: int
    title: str
    source: str
    blended: bool = False

    @property
    def centred(self) -> bool:
        """True if a window places the peak instead of three points, which propagates the noise of levels to it."""
        return self.code == _CENTRED


PEAKS: dict[str, PeakEstimator] = {
    "argmax": PeakEstimator(_ARGMAX, "The sharpest frame", "eq. 6"),
    "gaussian": PeakEstimator(_GAUSSIAN, "Gaussian through three points", "Nayar and Nakagawa 1994"),
    "tent": PeakEstimator(_TENT, "Symmetric tent through three points", "flanks of equal slope on log focus"),
    "blur_law": PeakEstimator(_BLUR_LAW, "Parabola of the blur's variance", "sigma^2 = s0^2 + (c z)^2", blended=True),
    "centred": PeakEstimator(_CENTRED, "Top of the smoothed focus curve", "mean shift, Comaniciu and Meer 2002"),
}


class PeakInterpolation(NamedTuple):
    """Parameters of peak interpolation: estimator code, power of the blur law, frames to rivals and flanks.

    blend: frames to the levels that are averaged with each level first, 0 for none; floored: True if the sweep extends
    so far beyond the peak that the lowest level is the noise floor.
    """

    estimator: int
    power: float
    gap: int
    reach: int
    blend: int = 0
    floored: bool = False


class ThreePoints(NamedTuple):
    """Three points of the focus curves of a row, float64 [col]: z and log2 of focus, and log2 where focus is lowest."""

    below: Float64s
    z: Float64s
    above: Float64s
    left: Float64s
    top: Float64s
    right: Float64s
    floor: Float64s

    @classmethod
    def make(cls, cols: int) -> ThreePoints:
        """Allocate rows of `cols` pixels."""
        return cls(*(aligned((cols,), np.float64) for _ in range(7)))


@lean_kernel
def place(
    how: PeakInterpolation, below: Real, z: Real, above: Real, left: Real, top: Real, right: Real, floor: Real
) -> Real:
    """Return the z of the peak from log focus at three z and its floor, limited to the interval midpoints."""
    if how.estimator == _ARGMAX:
        return z
    if how.estimator == _TENT:
        return _tent(below, z, above, left, top, right)
    if how.estimator == _BLUR_LAW:
        left, right = _variance(left, top, floor, how.power), _variance(right, top, floor, how.power)
        top = -1.0
    return _parabola(below, z, above, left, top, right)


@lean_part
def place_row(how: PeakInterpolation, points: ThreePoints, z_um: Float32s) -> None:
    """Apply `place` to a row of pixels, in loops without branches."""
    below, z, above, left, top, right, floor = points
    if how.estimator == _ARGMAX:
        for x in range(z_um.size):
            z_um[x] = z[x]
    elif how.estimator == _TENT:
        for x in range(z_um.size):
            z_um[x] = _tent(below[x], z[x], above[x], left[x], top[x], right[x])
    else:
        if how.estimator == _BLUR_LAW:
            _variances(left, top, floor, how.power)
            _variances(right, top, floor, how.power)
            top[:] = -1.0
        for x in range(z_um.size):
            z_um[x] = _parabola(below[x], z[x], above[x], left[x], top[x], right[x])


@lean_part
def _variances(level: Float64s, top: Float64s, floor: Float64s, power: Real) -> None:
    """Apply `_variance` to a row of pixels in place."""
    for x in range(level.size):
        level[x] = _variance(level[x], top[x], floor[x], power)


@inline_kernel
def _parabola(below: Real, z: Real, above: Real, left: Real, top: Real, right: Real) -> Real:
    """Return the vertex of the parabola through three points, at any spacing."""
    a = (z - below) * (top - right)
    b = (above - z) * (top - left)
    bend = a + b
    shift = 0.5 * ((z - below) * a - (above - z) * b) / (bend if bend > 0 else 1.0)
    return _held(z - shift if bend > 0 else z, below, z, above)


@inline_kernel
def _tent(below: Real, z: Real, above: Real, left: Real, top: Real, right: Real) -> Real:
    """Return the intersection of two lines of equal and opposite slope.

    The steeper side determines the slope; the line through the remaining point has the opposite slope.
    """
    rise = (top - left) / (z - below if z > below else 1.0)
    drop = (top - right) / (above - z if above > z else 1.0)
    steep = max(rise, drop)
    slope = 2 * (steep if steep > 0 else 1.0)
    up, down = 0.5 * (z + above) - (top - right) / slope, 0.5 * (below + z) + (top - left) / slope
    found = up if rise >= drop else down
    return _held(found if steep > 0 else z, below, z, above)


@inline_kernel
def _held(found: Real, below: Real, z: Real, above: Real) -> Real:
    low, high = 0.5 * (below + z), 0.5 * (z + above)
    found = found if found > low else low
    return found if found < high else high


@inline_kernel
def _variance(level: Real, top: Real, floor: Real, power: Real) -> Real:
    """Return the negative blur variance relative to the peak: -focus^(-1 / power) is a parabola in z."""
    of_level, of_top = 1.0 - _exp2(floor - level), 1.0 - _exp2(floor - top)
    share = of_level / (of_top if of_top > _LEAST_SHARE else _LEAST_SHARE)
    share = share if share > _LEAST_SHARE else _LEAST_SHARE
    return -_exp2((top - level - quick_log2(share)) / power)


@inline_kernel
def _exp2(exponent: Real) -> Real:
    """Return 2^exponent to ten digits in vectorisable operations: the Taylor series about the nearest integer."""
    shifted = exponent + _ROUNDER
    t = (exponent - (shifted - _ROUNDER)) * _LN2
    series = 1.0
    for n in (10.0, 9.0, 8.0, 7.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0):
        series = 1.0 + t * series / n
    power = np.float64(shifted).view(np.int64) << 52
    return np.int64(power + np.float64(series).view(np.int64)).view(np.float64)


@lean_part
def gather(
    curves: FocusCurves,
    y: Int,
    least: UInt16s,
    z_um: Float64s,
    how: PeakInterpolation,
    table: LevelTable,
    points: ThreePoints,
) -> None:
    """Gather z and log2 of focus at the peaks of row y and on both sides of them; least: its lowest levels."""
    levels = curves.levels
    last = levels.shape[0] - 1
    for x in range(points.top.size):
        k = np.int64(curves.peak[y, x])
        near = min(how.reach, k, last - k)
        points.left[x] = log2_of(levels[k - near, y, x], table)
        points.top[x] = log2_of(curves.best[y, x], table)
        points.right[x] = log2_of(levels[k + near, y, x], table)
        points.floor[x] = log2_of(least[x], table) if how.floored else _NO_FLOOR
        points.below[x], points.z[x], points.above[x] = z_um[k - near], z_um[k], z_um[k + near]


@lean_part
def gather_blended(
    curves: FocusCurves,
    y: Int,
    least: UInt16s,
    z_um: Float64s,
    how: PeakInterpolation,
    table: LevelTable,
    points: ThreePoints,
) -> None:
    """Gather the same from curves averaged along z, [1 2 1] / 4, at the best average near the peak.

    Specular grains are sharp above and below their focus: their curves have two maxima and a dip between them, where
    the surface is.
    """
    levels, s = curves.levels, how.blend
    last = levels.shape[0] - 1
    for x in range(points.top.size):
        peak = np.int64(curves.peak[y, x])
        k, top = peak, np.float32(-1.0)
        for j in range(-_NEAR_TOPS, _NEAR_TOPS + 1):
            frame = min(max(peak + j * s, 0), last)
            level = _blended(levels, frame, y, x, s, table)
            k, top = (frame, level) if level > top else (k, top)
        near = min(how.reach, k, last - k)
        points.left[x] = _blended(levels, k - near, y, x, s, table)
        points.top[x] = top
        points.right[x] = _blended(levels, k + near, y, x, s, table)
        points.floor[x] = log2_of(least[x], table) if how.floored else _NO_FLOOR
        points.below[x], points.z[x], points.above[x] = z_um[k - near], z_um[k], z_um[k + near]


@inline_kernel
def _blended(levels: UInt16s, k: Int, y: Int, x: Int, s: Int, table: LevelTable) -> Real:
    last = levels.shape[0] - 1
    before, after = log2_of(levels[max(k - s, 0), y, x], table), log2_of(levels[min(k + s, last), y, x], table)
    return np.float32(0.5) * log2_of(levels[k, y, x], table) + np.float32(0.25) * (before + after)
