"""Peak position of each pixel along z, with sub-frame interpolation, and its score.

Most estimators take three points. A Gaussian is a parabola in the logarithm, a tent has straight flanks, and the blur
law makes the variance of the blur a parabola in z; all are biased towards or away from the nearest frame by up to a
twentieth of a step (`tests/bench/bench_phase.py`). The centred peak takes all frames of a curve's top.

All values of the focus volume are logarithms (base 2).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.numerics.intrinsics import prefetch, quick_log2
from wafer_viewer.numerics.jit import (
    Float32s,
    Float64s,
    Greys,
    Int,
    Real,
    UInt16s,
    aligned,
    inline_kernel,
    inlined_part,
    lean_kernel,
    lean_part,
)
from wafer_viewer.reconstruct.focus.focus_volume import COARSE_PX, StackSource
from wafer_viewer.reconstruct.focus.peak_centring import CentringWindow, centre_row, modulations

_ARGMAX, _GAUSSIAN, _TENT, _BLUR_LAW, _CENTRED = 0, 1, 2, 3, 4
"""Codes of the estimators, for the kernels."""

_LEAST_SHARE = 0.02
"""Minimum fraction of a level that counts as focus rather than noise floor."""

_LN2 = float(np.log(2))
"""Natural logarithm of 2."""
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

    @property
    def centred(self) -> bool:
        """True if the peak is placed by a window instead of three points."""
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


class InterpolationScratch(NamedTuple):
    """Scratch rows for peak interpolation: rival and lowest level, and z and log2 of focus at three frames.

    turn, turn_at: highest or lowest level between the peak and a frame near it, and its frame; dip_top, dip_low,
    dip_at: both ends of the deepest dip there, and the frame of the upper. floor: log2 of the focus where the curve is
    lowest. bits, table: the number of fraction bits of a level, and their contribution to log2. modulation: focus^0.4
    of every level. mean_level, leverage_um: log2 of the focus in the window of a centred peak, and standard deviation
    of its height per octave of noise of the levels.
    """

    bits: int
    rival: UInt16s
    least: UInt16s
    turn: UInt16s
    turn_at: UInt16s
    dip_top: UInt16s
    dip_low: UInt16s
    dip_at: UInt16s
    below: Float64s
    z: Float64s
    above: Float64s
    left: Float64s
    top: Float64s
    right: Float64s
    floor: Float64s
    table: Float32s
    modulation: Float32s
    mean_level: Float32s
    leverage_um: Float32s

    @classmethod
    def make(cls, cols: int, table: Float32s) -> InterpolationScratch:
        """Allocate rows of `cols` pixels for levels whose lower bits `table` decodes."""
        shorts = (aligned((cols,), np.uint16) for _ in range(7))
        reals = (aligned((cols,), np.float64) for _ in range(7))
        return cls(
            table.size.bit_length() - 1,
            *shorts,
            *reals,
            table=table,
            modulation=modulations(table.tobytes()),
            mean_level=aligned((cols,), np.float32),
            leverage_um=aligned((cols,), np.float32),
        )


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
    below, z, above, left, top, right, floor = spots[8:15]
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


_AHEAD = 4
"""Prefetch distance in frames."""


_NO_FLOOR = -64.0
"""Noise floor of a curve that does not reach it, as a logarithm to base 2."""
_NEAR_TOPS = 2
"""Averages above and below the peak that may replace the one at the peak itself."""
_DIP_SIGMAS = np.float32(3.0)
"""Depth of the dips that noise makes, in standard deviations of a level: of several frames it is the deepest."""
_LEAST_APART = 3
"""Smallest distance of two tops in frames: the peak between tops two frames apart is off by a frame at most."""
_MIDDLE_SHARE = np.float32(1 / 6)
"""Largest distance of a height from the middle of two tops, as a share of theirs, that is not on either of them."""


class FocusCurves(NamedTuple):
    """Focus volume of a block, levels [k, row, col], with the best level of each pixel and its frame."""

    levels: UInt16s
    best: UInt16s
    peak: UInt16s

    @classmethod
    def make(cls, n_frames: int, shape: tuple[int, int]) -> FocusCurves:
        """Allocate the curves of `shape` pixels."""
        return cls(*(aligned(s, np.uint16) for s in ((n_frames, *shape), shape, shape)))

    def cut(self, n_rows: int) -> FocusCurves:
        """Return the same memory for fewer rows."""
        return FocusCurves(fewer_rows(self.levels, n_rows), self.best[:n_rows], self.peak[:n_rows])


def fewer_rows(volume: NDArray[Any], n_rows: int) -> NDArray[Any]:
    """Return a volume [k, row, col] of fewer rows that shares the memory of `volume`."""
    n_frames, _, cols = volume.shape
    return volume.reshape(-1)[: n_frames * n_rows * cols].reshape(n_frames, n_rows, cols)


class LevelNoise(NamedTuple):
    """Standard deviation of a level due to the noise of the camera.

    octaves: float32 [n], by the height of the level over that of pure noise, in `NOISE_STEPS` a power of two from 0 on;
    of_noise: float32 [grey], log2 of the focus of pure noise by the grey of the pixel.
    """

    octaves: Float32s
    of_noise: Float32s


NOISE_STEPS = 4
"""Entries of `LevelNoise.octaves` per power of two."""


class PeakScores(NamedTuple):
    """Part of `Peaks` that is computed from the focus volume."""

    z_um: Float32s
    noise_um: Float32s
    lead: Float32s
    fall: Float32s
    contrast: Float32s
    dip: Float32s
    all_in_focus: Greys


@dataclass(frozen=True, slots=True, eq=False)
class Peaks:
    """Peak heights and scores of each pixel, all arrays [row, col].

    z_um: float32; noise_um: float32, standard uncertainty of z_um due to the noise of the camera, NaN where it is not
    known; lead, fall and contrast: float32, in powers of two of the focus measure: height of the peak above its
    highest rival, above its own flanks, and above the lowest frame; dip: float32, depth of the dip to another top that
    is nearer than any rival, less what noise makes of it, 0 for peaks whose noise is not known; at_end: bool; clipped:
    uint16, number of frames in which the pixel is too bright; all_in_focus: grey as in the stack. coarse: uint16 [k,
    row / 4, col / 4], the levels of the focus volume averaged over 4 x 4 pixels, or without frames where they are not
    requested.
    """

    z_um: NDArray[np.float32]
    noise_um: NDArray[np.float32]
    lead: NDArray[np.float32]
    fall: NDArray[np.float32]
    contrast: NDArray[np.float32]
    dip: NDArray[np.float32]
    at_end: NDArray[np.bool_]
    clipped: NDArray[np.uint16]
    all_in_focus: Image
    coarse: NDArray[np.uint16]

    @classmethod
    def empty(cls, shape: tuple[int, int], dtype: np.dtype[Any], n_coarse: int = 0) -> Peaks:
        """Allocate the peaks of a field or of a part of it, with `n_coarse` frames in the coarse focus volume."""
        z_um, noise_um, lead, fall, contrast, dip = (np.empty(shape, np.float32) for _ in range(6))
        coarse = np.empty((n_coarse, -(-shape[0] // COARSE_PX), -(-shape[1] // COARSE_PX)), np.uint16)
        at_end, clipped, all_in_focus = (np.empty(shape, kind) for kind in (np.bool_, np.uint16, dtype))
        return cls(z_um, noise_um, lead, fall, contrast, dip, at_end, clipped, all_in_focus, coarse)

    @property
    def scores(self) -> PeakScores:
        """Arrays that `describe` fills."""
        return PeakScores(self.z_um, self.noise_um, self.lead, self.fall, self.contrast, self.dip, self.all_in_focus)

    @property
    def confidence(self) -> NDArray[np.float32]:
        """Confidence 0 ... 1: one minus the ratio of the highest rival to the peak in the focus measure."""
        return np.float32(1) - np.exp2(-self.lead)

    def rows(self, part: slice) -> Peaks:
        """Return a range of rows as views; it begins at a row of the coarse volume."""
        coarse = slice(part.start // COARSE_PX, -(-part.stop // COARSE_PX))
        fine = {name: getattr(self, name)[part] for name in self.__slots__ if name != "coarse"}
        return Peaks(**fine, coarse=self.coarse[:, coarse])


def confidence_of(lead: float) -> float:
    """Return the confidence of a peak that is 2^lead times its highest rival."""
    return 1.0 - 2.0**-lead


def lead_of(confidence: float) -> float:
    """Return the lead, in powers of two, that corresponds to a confidence."""
    return float(-np.log2(max(1e-9, 1.0 - confidence)))


def describe(
    curves: FocusCurves,
    source: StackSource,
    z_um: NDArray[np.float64],
    how: PeakInterpolation,
    window: CentringWindow | None,
    noise: LevelNoise,
    spots: InterpolationScratch,
    out: PeakScores,
) -> None:
    """Compute height, its noise, scores and all-in-focus grey of each pixel.

    window: of a centred peak, None for one of three points. Either kind has its own kernel, so that a user waits for
    the compiler of one only.
    """
    if window is None:
        _describe(curves, source, z_um, how, spots, out)
    else:
        _describe_centred(curves, source, z_um, how.gap, window, noise, spots, out)


@lean_kernel
def _describe(
    curves: FocusCurves,
    source: StackSource,
    z_um: Float64s,
    how: PeakInterpolation,
    spots: InterpolationScratch,
    out: PeakScores,
) -> None:
    """Describe peaks of three points, one row at a time to stay in cache."""
    for y in range(curves.peak.shape[0]):
        _score_row(curves, source, y, how.gap, spots, out)
        if how.blend:
            gather_blended(curves, y, z_um, how, spots)
        else:
            gather(curves, y, z_um, how, spots)
        place_row(how, spots, out.z_um[y])
        out.noise_um[y, :] = np.nan
        out.dip[y, :] = 0


@lean_kernel
def _describe_centred(
    curves: FocusCurves,
    source: StackSource,
    z_um: Float64s,
    gap: Int,
    window: CentringWindow,
    noise: LevelNoise,
    spots: InterpolationScratch,
    out: PeakScores,
) -> None:
    """Describe centred peaks, one row at a time to stay in cache."""
    for y in range(curves.peak.shape[0]):
        _score_row(curves, source, y, gap, spots, out)
        best, mean_level, leverage_um = curves.peak[y], spots.mean_level, spots.leverage_um
        centre_row(curves.levels, best, y, z_um, window, spots.modulation, out.z_um[y], mean_level, leverage_um)
        _propagate_noise(noise, out.all_in_focus[y], spots, out.noise_um[y], out.dip[y])
        _accept_middles(z_um, best, spots.dip_at, out.z_um[y], out.dip[y])


@inlined_part
def _score_row(
    curves: FocusCurves, source: StackSource, y: Int, gap: Int, spots: InterpolationScratch, out: PeakScores
) -> None:
    """Compute what does not depend on the kind of the peak: scores and all-in-focus grey of row y."""
    _find_rivals(curves.levels, y, gap, curves.best[y], curves.peak[y], spots)
    _score(curves, y, gap, spots, out)
    row = source.top + y
    for x in range(curves.peak.shape[1]):
        out.all_in_focus[y, x] = source.images[source.slots[curves.peak[y, x]], row, source.left + x]


@lean_part
def _propagate_noise(
    noise: LevelNoise, grey: Greys, spots: InterpolationScratch, noise_um: Float32s, dip: Float32s
) -> None:
    """Compute the standard deviation of a row of heights from that of the levels, and take theirs from the dips."""
    f, u = np.float32, np.uint32  # an unsigned index is not tested for counting from the end
    last, steps, zero, half = f(noise.octaves.size - 1), f(NOISE_STEPS), f(0), f(0.5)
    mean_level, leverage_um, octaves, of_noise = spots.mean_level, spots.leverage_um, noise.octaves, noise.of_noise
    for x in range(noise_um.size):
        over = (mean_level[x] - of_noise[u(grey[x])]) * steps + half
        of_level = octaves[u(np.int32(min(max(over, zero), last)))]
        noise_um[x] = leverage_um[x] * of_level
        dip[x] -= _DIP_SIGMAS * of_level


@inlined_part
def _find_rivals(levels: UInt16s, y: Int, gap: Int, best: UInt16s, peak: UInt16s, spots: InterpolationScratch) -> None:
    """Find the highest other local maximum at least `gap` frames from the peak, the lowest level, and dips nearer by.

    Without a rival the lowest level is used.
    """
    last, rival, least = levels.shape[0] - 1, spots.rival, spots.least
    rival[:] = 0
    least[:] = 65535
    for row in (spots.turn, spots.turn_at, spots.dip_top, spots.dip_low, spots.dip_at):
        row[:] = 0
    first, end = last + 1, -1
    for x in range(peak.size):
        first, end = min(first, np.int64(peak[x]) - gap), max(end, np.int64(peak[x]) + gap)
    for k in range(last + 1):
        prefetch(levels[min(k + _AHEAD, last), y])
        before, level, after = levels[max(k - 1, 0), y], levels[k, y], levels[min(k + 1, last), y]
        _rival_row(before, level, after, k, gap, peak, rival, least)
        if first < k < end:
            _dip_row(level, best, k, gap, peak, spots)
    for x in range(rival.size):
        a, b = rival[x], least[x]
        rival[x] = a if a > b else b


@lean_part
def _rival_row(
    before: UInt16s,
    level: UInt16s,
    after: UInt16s,
    k: Int,
    gap: Int,
    peak: UInt16s,
    rival: UInt16s,
    least: UInt16s,
) -> None:
    u = np.uint16
    first, width = u(k - gap + 1), u(2 * gap - 1)
    for x in range(level.size):
        q, old, low = level[x], rival[x], least[x]
        far = u(peak[x] - first) >= width
        higher = far & (q >= before[x]) & (q >= after[x]) & (q > old)
        rival[x] = q if higher else old
        least[x] = q if q < low else low


@lean_part
def _dip_row(level: UInt16s, best: UInt16s, k: Int, gap: Int, peak: UInt16s, spots: InterpolationScratch) -> None:
    """Follow the curves nearer to their peaks than a rival: how far they fall again before, and rise again behind.

    What is not half as high as the peak is no top: it may be noise on a flank. Tops nearer to each other than half the
    gap, a focus width, or than `_LEAST_APART` frames misplace a height by no more than is usual.
    """
    turn, turn_at, dip_top, dip_low, dip_at = spots.turn, spots.turn_at, spots.dip_top, spots.dip_low, spots.dip_at
    u = np.uint16
    first, width, here, octave = u(k - gap + 1), u(2 * gap - 1), u(k), u(1 << spots.bits)
    apart = u(max(_LEAST_APART, (gap + 1) // 2))
    for x in range(level.size):
        q, old, top, low, at = level[x], turn[x], dip_top[x], dip_low[x], peak[x]
        near, behind = u(at - first) < width, at < here
        lower, higher = min(q, old), max(q, old)
        above, below = q if behind else higher, lower if behind else q
        is_apart = u(here - at if behind else at - here) >= apart
        counts = near & (is_apart | (not behind)) & (u(best[x] - above) < octave)
        deeper = counts & (u(above - below) > u(top - low))
        kept = near & (is_apart | behind | (at == here))
        extreme = lower if behind else higher
        dip_top[x], dip_low[x] = above if deeper else top, below if deeper else low
        dip_at[x] = (here if behind else turn_at[x]) if deeper else dip_at[x]
        turn_at[x] = here if kept & (extreme == q) else turn_at[x]
        turn[x] = extreme if kept else old


@lean_part
def _accept_middles(z_um: Float64s, peak: UInt16s, dip_at: UInt16s, found_um: Float32s, dip: Float32s) -> None:
    """Take the dip of a row of heights for none where a wide window found the middle of both tops."""
    for x in range(found_um.size):
        one_um, other_um = z_um[peak[x]], z_um[dip_at[x]]
        off_um = abs(found_um[x] - np.float32(0.5 * (one_um + other_um)))
        is_middle = off_um < _MIDDLE_SHARE * abs(np.float32(other_um - one_um))
        dip[x] = np.float32(0) if is_middle else dip[x]


@lean_part
def gather(curves: FocusCurves, y: Int, z_um: Float64s, how: PeakInterpolation, spots: InterpolationScratch) -> None:
    """Gather z and log2 of focus at the peaks of row y and on both sides of them."""
    levels, bits, table = curves.levels, spots.bits, spots.table
    last = levels.shape[0] - 1
    for x in range(spots.top.size):
        k = np.int64(curves.peak[y, x])
        near = min(how.reach, k, last - k)
        spots.left[x] = _log2(levels[k - near, y, x], bits, table)
        spots.top[x] = _log2(curves.best[y, x], bits, table)
        spots.right[x] = _log2(levels[k + near, y, x], bits, table)
        spots.floor[x] = _log2(spots.least[x], bits, table) if how.floored else _NO_FLOOR
        spots.below[x], spots.z[x], spots.above[x] = z_um[k - near], z_um[k], z_um[k + near]


@lean_part
def gather_blended(
    curves: FocusCurves, y: Int, z_um: Float64s, how: PeakInterpolation, spots: InterpolationScratch
) -> None:
    """Gather the same from curves averaged along z, [1 2 1] / 4, at the best average near the peak.

    Specular grains are sharp above and below their focus: their curves have two maxima and a dip between them, where
    the surface is.
    """
    levels, bits, table, s = curves.levels, spots.bits, spots.table, how.blend
    last = levels.shape[0] - 1
    for x in range(spots.top.size):
        peak = np.int64(curves.peak[y, x])
        k, top = peak, np.float32(-1.0)
        for j in range(-_NEAR_TOPS, _NEAR_TOPS + 1):
            frame = min(max(peak + j * s, 0), last)
            level = _blended(levels, frame, y, x, s, bits, table)
            k, top = (frame, level) if level > top else (k, top)
        near = min(how.reach, k, last - k)
        spots.left[x] = _blended(levels, k - near, y, x, s, bits, table)
        spots.top[x] = top
        spots.right[x] = _blended(levels, k + near, y, x, s, bits, table)
        spots.floor[x] = _log2(spots.least[x], bits, table) if how.floored else _NO_FLOOR
        spots.below[x], spots.z[x], spots.above[x] = z_um[k - near], z_um[k], z_um[k + near]


@inline_kernel
def _blended(levels: UInt16s, k: Int, y: Int, x: Int, s: Int, bits: Int, table: Float32s) -> Real:
    last = levels.shape[0] - 1
    before = _log2(levels[max(k - s, 0), y, x], bits, table)
    after = _log2(levels[min(k + s, last), y, x], bits, table)
    return np.float32(0.5) * _log2(levels[k, y, x], bits, table) + np.float32(0.25) * (before + after)


@lean_part
def _score(curves: FocusCurves, y: Int, gap: Int, spots: InterpolationScratch, out: PeakScores) -> None:
    """Compute lead, fall, contrast and dip of the peaks of row y."""
    levels, bits, table = curves.levels, spots.bits, spots.table
    last = levels.shape[0] - 1
    for x in range(curves.peak.shape[1]):
        k = np.int64(curves.peak[y, x])
        sides = max(levels[max(0, k - gap), y, x], levels[min(last, k + gap), y, x])
        top = _log2(curves.best[y, x], bits, table)
        out.lead[y, x] = top - _log2(spots.rival[x], bits, table)
        out.contrast[y, x] = top - _log2(spots.least[x], bits, table)
        out.fall[y, x] = top - _log2(sides, bits, table)
        out.dip[y, x] = _log2(spots.dip_top[x], bits, table) - _log2(spots.dip_low[x], bits, table)


@inline_kernel
def _log2(level: Int, bits: Int, table: Float32s) -> Real:
    q = np.int64(level)
    return np.float32(q >> bits) + table[q & (table.size - 1)]
