"""Sub-frame interpolation of the peak from log2 of the focus measure at three frames.

A Gaussian through three points is a parabola in the logarithm, a tent has straight flanks; both are biased towards or
away from the nearest frame by up to a twentieth of a step. The blur law is unbiased: the variance of the blur is a
parabola in z, and the focus measure is a known power of it once the noise floor of the curve is subtracted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from wafer_viewer.numerics.array_types import Float32s, Float64s, Real, UInt16s, aligned
from wafer_viewer.numerics.fast_log2 import quick_log2
from wafer_viewer.numerics.jit import inline_kernel, lean_kernel, lean_part

_ARGMAX, _GAUSSIAN, _TENT, _BLUR_LAW = 0, 1, 2, 3

_LEAST_SHARE = 0.02
"""Minimum fraction of a level that counts as focus rather than noise floor."""

_LN2 = float(np.log(2))
_ROUNDER = 1.5 * 2.0**52
"""A float64 this large has no fraction bits; its lowest mantissa bits hold an integer."""


@dataclass(frozen=True, slots=True)
class PeakEstimator:
    """A peak estimator: the kernels' code, title and source.

    blended: True if the peak is placed on a curve averaged along z.
    """

    code: int
    title: str
    source: str
    blended: bool = False


PEAKS: dict[str, PeakEstimator] = {
    "argmax": PeakEstimator(_ARGMAX, "The sharpest frame", "eq. 6"),
    "gaussian": PeakEstimator(_GAUSSIAN, "Gaussian through three points", "Nayar and Nakagawa 1994"),
    "tent": PeakEstimator(_TENT, "Symmetric tent through three points", "flanks of equal slope on log focus"),
    "blur_law": PeakEstimator(_BLUR_LAW, "Parabola of the blur's variance", "sigma^2 = s0^2 + (c z)^2", blended=True),
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


class InterpolationScratch(NamedTuple):
    """Scratch rows for peak interpolation: rival and lowest level, and z and log2 of focus at three frames.

    floor: log2 of the focus where the curve is lowest. bits, table: the number of fraction bits of a level, and their
    contribution to log2.
    """

    bits: int
    rival: UInt16s
    least: UInt16s
    below: Float64s
    z: Float64s
    above: Float64s
    left: Float64s
    top: Float64s
    right: Float64s
    floor: Float64s
    table: Float32s

    @classmethod
    def make(cls, cols: int, table: Float32s) -> InterpolationScratch:
        """Allocate rows of `cols` pixels for levels whose lower bits `table` decodes."""
        shorts = (aligned((cols,), np.uint16) for _ in range(2))
        reals = (aligned((cols,), np.float64) for _ in range(7))
        return cls(table.size.bit_length() - 1, *shorts, *reals, table=table)


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
def place_row(how: PeakInterpolation, spots: InterpolationScratch, z_um: Float32s) -> None:
    """Apply `place` to a row of pixels, in loops without branches."""
    below, z, above, left, top, right, floor = spots[3:10]
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
    whole = np.float64(shifted).view(np.int64) << 52
    return np.int64(whole + np.float64(series).view(np.int64)).view(np.float64)
