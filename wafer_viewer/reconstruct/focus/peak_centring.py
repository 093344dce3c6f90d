"""Centred peaks: a Gaussian window that moves along z until the focus in it is centred.

The estimate is the top of the focus curve smoothed by the window (mean shift, [1]_), or what comes to the same in an
even sweep, the vertex of a local least-squares parabola. Three points of a curve tie a peak
to whole frames, by up to a twentieth of a step; here all frames in the window count, and the window moves with the
estimate, so nothing jumps half way between two frames. Sums over frames are integrals as long as the curve has little
power at one period a frame, which holds to about one depth of field a step because the transfer of a lens is
band-limited: the phase of the frames drops out.

References
----------
.. [1] D. Comaniciu, P. Meer, Mean shift: a robust approach toward feature space analysis, IEEE Trans. Pattern Anal.
   Mach. Intell. 24 (2002) 603.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.jit import (
    Float32s,
    Float64s,
    Int,
    Int64s,
    Real,
    UInt16s,
    aligned,
    inline_kernel,
    inlined_part,
    lean_part,
    quick_log2,
)

LEAST_SIGMA = 0.8
"""Least standard deviation of the window, in steps: one of 0.7 or of 1 is worse where frames are far apart."""
_LANES = 64
"""Pixels whose peaks are centred at the same time."""
_REACH_SIGMAS = 3.5
"""Reach of the window in standard deviations: at 3 its edge shows in the phase of the frames."""
_SLACK = 1.0
"""Largest distance of an estimate from the frame that its taps surround, in steps."""
_LARGEST_MOVE, _BLIND_MOVE = 0.7, 0.5
"""Largest move of a window, and that where the curve bends upwards, in standard deviations."""
_TURNS, _STANDING = 5, 0.02
"""Most moves of a window, and the move after which it stands, in steps: the next is of the order of its cube."""
_EVEN = 1e-6
"""Largest difference of the steps of an even sweep, in steps."""
_FLAT = 1e-5
"""Fraction of the focus below which slopes and bends are rounding."""

_MODULATION_POWER = 0.4
"""Power of the focus that is about the modulation of the image: 0.3 to 0.5 serve alike, 0 and 1 do not."""
_OCTAVES = np.float32(1 / _MODULATION_POWER)
"""Octaves of the focus per octave of its modulation."""
_PER_OCTAVE = np.float32(1.4426950408889634)
"""1 / ln 2."""
_LN2 = np.float32(np.log(2))
"""Natural logarithm of 2."""
_ROUNDER = np.float32(1.5 * 2.0**23)
"""A float32 this large has no fraction bits; its lowest mantissa bits hold an integer."""
_SLOPE_PER_OCTAVE = np.float32(_MODULATION_POWER * np.log(2) / 2**0.75)
"""Standard deviation of a window's slope over the root of its second moment, per modulation and octave of level noise.

The square of a Gaussian has 2^-1.5 times its second moment; the noise of frames is independent.
"""


@lru_cache(maxsize=4)
def modulations(table: bytes) -> Float32s:
    """Return focus^0.4 of all levels whose lower bits `table`, the bytes of float32, decodes; float32 [65536]."""
    fraction = np.frombuffer(table, np.float32).astype(np.float64)
    octaves = np.arange(2**16 // fraction.size)[:, None] + fraction
    return np.exp2(_MODULATION_POWER * octaves).astype(np.float32).ravel()


class CentringWindow(NamedTuple):
    """Gaussian window of the centred peak: its taps around every frame, and work space for `_LANES` pixels.

    step_um: unit of all distances, the median step; sigma: standard deviation in steps; distance, weight: float32
    [frame, tap], distance of a tap from the frame, and its Gaussian weight times the share of z that it stands for, 0
    outside of the stack; even: the same for all frames, so that `taps` holds them already; ends: float32 [2, frame],
    distances of the ends of the stack. at: frame that the taps surround; shift: estimate as a distance from it; moved:
    its last move; lowest, highest: distances of the ends of the stack; taps: float32 [distance, weight, modulation]
    [tap, pixel]; sums: float32 [sum * `_LANES` + pixel], of weight times the powers 0 to 4 of the distance from the
    estimate, then of weight and modulation times the powers 0 to 2: one row, so that a compiler sees them apart.
    """

    step_um: float
    sigma: float
    even: bool
    distance: Float32s
    weight: Float32s
    ends: Float32s
    at: Int64s
    shift: Float32s
    moved: Float32s
    lowest: Float32s
    highest: Float32s
    taps: Float32s
    sums: Float32s

    @classmethod
    def of(cls, z_um: NDArray[np.float64], sigma: float) -> CentringWindow:
        """Return the window for frames at `z_um`, with taps that cover its reach from every frame."""
        step_um, even, distance, weight, even_taps = _taps_of(np.asarray(z_um, np.float64).tobytes(), sigma)
        taps = aligned((3, distance.shape[1], _LANES), np.float32)
        ends = ((np.asarray(z_um, np.float64)[[0, -1], None] - z_um) / step_um).astype(np.float32)
        if even:
            taps[:2] = even_taps[:, :, None]
        shift, moved, lowest, highest = (aligned((_LANES,), np.float32) for _ in range(4))
        return cls(
            step_um,
            sigma,
            even,
            distance,
            weight,
            ends,
            aligned((_LANES,), np.int64),
            shift,
            moved,
            lowest,
            highest,
            taps,
            aligned((8 * _LANES,), np.float32),
        )


@lru_cache(maxsize=8)
def _taps_of(z_um: bytes, sigma: float) -> tuple[float, bool, Float32s, Float32s, Float32s]:
    """Return step, evenness, distance and weight of a `CentringWindow`, and both of an even sweep, [2, tap]."""
    at_um = np.frombuffer(z_um, np.float64)
    n, step_um = len(at_um), float(np.median(np.diff(at_um)))
    reach_um = (_REACH_SIGMAS * sigma + _SLACK) * step_um * (1 + 1e-9)
    first = np.searchsorted(at_um, at_um - reach_um, "left")
    stop = np.searchsorted(at_um, at_um + reach_um, "right")
    half = int(max(np.max(np.arange(n) - first), np.max(stop - 1 - np.arange(n))))
    frame = np.arange(n)[:, None] + np.arange(-half, half + 1)
    inside, nearest = (frame >= 0) & (frame < n), frame.clip(0, n - 1)
    distance = (at_um[nearest] - at_um[:, None]) / step_um
    share = (np.diff(at_um, prepend=2 * at_um[0] - at_um[1]) + np.diff(at_um, append=2 * at_um[-1] - at_um[-2])) / 2
    weight = np.where(inside, share[nearest] / step_um * np.exp(-(distance**2) / (2 * sigma**2)), 0.0)
    even = bool(np.ptp(np.diff(at_um)) < _EVEN * step_um)
    d = np.arange(-half, half + 1)
    even_taps = np.stack([d, np.exp(-(d**2) / (2 * sigma**2))])
    return step_um, even, distance.astype(np.float32), weight.astype(np.float32), even_taps.astype(np.float32)


@inlined_part
def centre_row(
    levels: UInt16s,
    best: UInt16s,
    y: Int,
    z_um: Float64s,
    window: CentringWindow,
    modulation: Float32s,
    found_um: Float32s,
    mean_level: Float32s,
    leverage_um: Float32s,
) -> None:
    """Centre the peaks of row y of a focus volume, levels [k, row, col], from the best frames `best` [col].

    mean_level: mean log2 of the focus in the window; leverage_um: standard deviation of the height in um per octave of
    the independent noise of levels, NaN where the curve does not bend.
    """
    for start in range(0, found_um.size, _LANES):
        _begin(best, start, window)
        for turn in range(_TURNS):
            if turn == 0:
                _take_all_taps(levels, y, start, window, modulation)
            else:
                _surround(levels, y, start, z_um, window, modulation)
            if turn == 0 and window.even and _is_inside(window):
                _sum_taps_at_frames(window)
            else:
                _sum_taps(window)
            if not _move(window):
                break
        for i in range(min(_LANES, found_um.size - start)):
            found_um[start + i] = z_um[window.at[i]] + window.shift[i] * window.step_um
        _spread(window, mean_level[start:], leverage_um[start:])


@lean_part
def _take_all_taps(levels: UInt16s, y: Int, start: Int, window: CentringWindow, modulation: Float32s) -> None:
    """Gather the taps of all pixels, one after the other.

    The levels of a pixel lie a stripe apart, which is a multiple of a page or nearly so: they compete for a few lines
    of the cache, and neighbouring pixels share these lines if they are read together.
    """
    n_frames, n_rows, n_cols = levels.shape
    n_taps, u = window.taps.shape[1], np.uint64  # an unsigned index is not tested for counting from the end
    half, plane, every, lowest, highest = n_taps // 2, u(n_rows * n_cols), levels.reshape(-1), n_frames, np.int64(-1)
    for i in range(_LANES):
        lowest, highest = min(lowest, window.at[i]), max(highest, window.at[i])
    if lowest >= half and highest < n_frames - half and start + _LANES <= n_cols:
        for j in range(n_taps):
            focus, first = window.taps[2, j], u(y * n_cols + start)
            for i in range(_LANES):
                focus[i] = modulation[every[u(window.at[i] + j - half) * plane + first + u(i)]]
    else:
        for j in range(n_taps):
            focus = window.taps[2, j]
            for i in range(_LANES):
                k = min(max(window.at[i] + j - half, 0), n_frames - 1)
                focus[i] = modulation[levels[k, y, min(start + i, n_cols - 1)]]
    if not window.even:
        for j in range(n_taps):
            for i in range(_LANES):
                window.taps[0, j, i] = window.distance[window.at[i], j]
                window.taps[1, j, i] = window.weight[window.at[i], j]


@inline_kernel
def _take_taps(levels: UInt16s, y: Int, start: Int, i: Int, window: CentringWindow, modulation: Float32s) -> None:
    """Gather the taps of pixel i: distance, weight and modulation."""
    last_k, n_taps = levels.shape[0] - 1, window.taps.shape[1]
    x, first = min(start + i, levels.shape[2] - 1), window.at[i] - n_taps // 2
    for j in range(n_taps):
        window.taps[2, j, i] = modulation[levels[min(max(first + j, 0), last_k), y, x]]
    if not window.even:
        for j in range(n_taps):
            window.taps[0, j, i] = window.distance[window.at[i], j]
            window.taps[1, j, i] = window.weight[window.at[i], j]


@lean_part
def _begin(best: UInt16s, start: Int, window: CentringWindow) -> None:
    for i in range(_LANES):
        _surround_by(np.int64(best[min(start + i, best.size - 1)]), i, window)
        window.shift[i], window.moved[i] = 0, _STANDING


@inline_kernel
def _surround_by(k: Int, i: Int, window: CentringWindow) -> None:
    """Let the taps of pixel i surround frame k."""
    window.at[i] = k
    window.lowest[i], window.highest[i] = window.ends[0, k], window.ends[1, k]


@lean_part
def _surround(
    levels: UInt16s, y: Int, start: Int, z_um: Float64s, window: CentringWindow, modulation: Float32s
) -> None:
    """Surround estimates that have left their frame by the taps of the nearest one."""
    for i in range(_LANES):
        if abs(window.shift[i]) > _SLACK:
            k = window.at[i]
            at_um = z_um[k] + window.shift[i] * window.step_um
            while k > 0 and at_um < 0.5 * (z_um[k - 1] + z_um[k]):
                k -= 1
            while k < z_um.size - 1 and at_um > 0.5 * (z_um[k] + z_um[k + 1]):
                k += 1
            _surround_by(k, i, window)
            window.shift[i] = (at_um - z_um[k]) / window.step_um
            _take_taps(levels, y, start, i, window, modulation)


@lean_part
def _is_inside(window: CentringWindow) -> bool:
    """Return whether the windows of all pixels, before they move, lie within the stack."""
    edge, outside = window.taps[0, window.taps.shape[1] - 1, 0], np.int32(0)
    for i in range(_LANES):
        inside = (-window.lowest[i] >= edge) & (window.highest[i] >= edge)
        outside = np.int32(outside + np.int32(not inside))
    return outside == 0


@lean_part
def _sum_taps_at_frames(window: CentringWindow) -> None:
    """Apply `_sum_taps` to windows of an even sweep that have not moved: their weights are those of the taps."""
    s0, s1, s2, s3, s4 = np.float32(0), np.float32(0), np.float32(0), np.float32(0), np.float32(0)
    n, sums = _LANES, window.sums
    sums[:] = 0
    for j in range(window.taps.shape[1]):
        u, g, focus = window.taps[0, j, 0], window.taps[1, j, 0], window.taps[2, j]
        gu = g * u
        guu = gu * u
        s0, s1, s2, s3, s4 = s0 + g, s1 + gu, s2 + guu, s3 + guu * u, s4 + guu * u * u
        for i in range(_LANES):
            v = focus[i]
            sums[5 * n + i] += g * v
            sums[6 * n + i] += gu * v
            sums[7 * n + i] += guu * v
    for i in range(_LANES):
        sums[i], sums[n + i], sums[2 * n + i], sums[3 * n + i], sums[4 * n + i] = s0, s1, s2, s3, s4


@lean_part
def _sum_taps(window: CentringWindow) -> None:
    """Sum weights and weighted modulations of all pixels, times powers of the distance from the estimate.

    A Gaussian about the estimate is one about the frame times an exponential, up to a factor that cancels. Near an end
    of the stack the window is cut at the same distance on both sides, so that a symmetric curve keeps its middle.
    """
    f = np.float32
    zero, one, n, sums = f(0), f(1), _LANES, window.sums
    sums[:] = 0
    shift, lowest, highest = window.shift, window.lowest, window.highest
    rate = f(_PER_OCTAVE / window.sigma**2)
    for j in range(window.taps.shape[1]):
        distance, weight, focus = window.taps[0, j], window.taps[1, j], window.taps[2, j]
        for i in range(_LANES):
            d, t, v = distance[i], shift[i], focus[i]
            u = d - t
            room = one + min(t - lowest[i], highest[i] - t)
            g = weight[i] * min(max(room - abs(u), zero), one) * _quick_exp2(d * t * rate)
            gu = g * u
            guu = gu * u
            sums[i] += g
            sums[n + i] += gu
            sums[2 * n + i] += guu
            sums[3 * n + i] += guu * u
            sums[4 * n + i] += guu * u * u
            sums[5 * n + i] += g * v
            sums[6 * n + i] += gu * v
            sums[7 * n + i] += guu * v


@lean_part
def _move(window: CentringWindow) -> bool:
    """Move all windows to the vertex of the parabola that fits best in them; return whether any is still moving.

    In an even sweep this is a step of Newton towards the centre of gravity; where distances vary, the parabola allows
    for it. A window that stands is left alone, so that no pixel depends on those beside it.
    """
    f = np.float32
    shift, moved, lowest, highest, sums = window.shift, window.moved, window.lowest, window.highest, window.sums
    most, blind, standing = f(_LARGEST_MOVE * window.sigma), f(_BLIND_MOVE * window.sigma), f(_STANDING)
    flat, zero, one = f(_FLAT * window.sigma**4), f(0), f(1)
    for i in range(_LANES):
        t, least = shift[i], flat * sums[5 * _LANES + i]
        bend, slope, _, _ = _parabola(sums, i)
        bends = bend > least
        ahead = blind if slope > least else (-blind if slope < -least else zero)
        newton = slope / (bend if bends else one)
        move = newton if bends else ahead
        found = min(max(t + min(max(move, -most), most), lowest[i]), highest[i])
        found = found if abs(moved[i]) >= standing else t
        shift[i], moved[i] = found, found - t
    moving = np.int32(0)  # the largest of floats would be searched for one by one
    for i in range(_LANES):
        moving = np.int32(moving + np.int32(abs(moved[i]) >= standing))
    return bool(moving > 0)


@inline_kernel
def _parabola(sums: Float32s, i: Int) -> tuple[Real, Real, Real, Real]:
    """Return bend, slope, mean and second moment of the modulation in the window of pixel i."""
    n, one, two = _LANES, np.float32(1), np.float32(2)
    p0, p1, p2 = sums[i], sums[n + i], sums[2 * n + i]
    per_weight = one / (p0 if p0 > 0 else one)
    mean = sums[5 * n + i] * per_weight
    y1, y2 = sums[6 * n + i] - mean * p1, sums[7 * n + i] - mean * p2
    s11, s12 = p2 - p1 * p1 * per_weight, sums[3 * n + i] - p1 * p2 * per_weight
    s22 = sums[4 * n + i] - p2 * p2 * per_weight
    return two * (y1 * s12 - y2 * s11), y1 * s22 - y2 * s12, mean, s22


@lean_part
def _spread(window: CentringWindow, mean_level: Float32s, leverage_um: Float32s) -> None:
    """Write the mean level, and how far noise of the levels moves the vertex of the parabola."""
    f = np.float32
    sums, step_um, none = window.sums, f(window.step_um), f(np.nan)
    zero, one, least = f(0), f(1), f(_FLAT)
    for i in range(min(_LANES, leverage_um.size)):
        bend, _, mean, s22 = _parabola(sums, i)
        of_slope = _SLOPE_PER_OCTAVE * mean * s22 * np.sqrt(sums[2 * _LANES + i])
        leverage = step_um * of_slope / (bend if bend > zero else one)
        leverage_um[i] = leverage if bend > zero else none
        mean_level[i] = _OCTAVES * quick_log2(mean if mean > least else least)


@inline_kernel
def _quick_exp2(exponent: Real) -> Real:
    """Return 2^exponent of a small float32 to five digits: the Taylor series about the nearest integer."""
    f = np.float32
    shifted = exponent + _ROUNDER
    t = (exponent - (shifted - _ROUNDER)) * _LN2
    series = f(1) + t * (f(1) + t * (f(1 / 2) + t * (f(1 / 6) + t * (f(1 / 24) + t * f(1 / 120)))))
    power = np.int32(np.float32(shifted).view(np.int32) << np.int32(23))
    return np.int32(power + np.float32(series).view(np.int32)).view(np.float32)
