"""Peak of the focus curve of each pixel along z: its height, the noise of that, and its scores.

All values of the focus volume are logarithms (base 2).

Both are found in one pass along the frames, row by row, while the levels are in cache.

The window of a measure and the strength of the texture over the noise determine by how much a level varies between two
frames. Both are simulated for the measure and window in use, so that a measure of another package needs no formula.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.numerics.jit import (
    Float32s,
    Float64s,
    Greys,
    Int,
    UInt8s,
    UInt16s,
    aligned,
    inlined_part,
    lean_kernel,
    lean_part,
    prefetch,
)
from wafer_viewer.reconstruct.focus.focus_measures import focus_kernels
from wafer_viewer.reconstruct.focus.focus_volume import (
    COARSE_PX,
    FocusCurves,
    Focusing,
    LevelTable,
    Volume,
    log2_of,
)
from wafer_viewer.reconstruct.focus.peak_centring import CentringWindow, centre_row, modulations
from wafer_viewer.reconstruct.focus.peak_interpolation import (
    PeakInterpolation,
    ThreePoints,
    gather,
    gather_blended,
    place_row,
)
from wafer_viewer.reconstruct.frame_blocks import StackSource
from wafer_viewer.reconstruct.preprocess.camera_noise import CameraNoise

# ---------------------------------------------------------------------------------------------------------- level noise


NOISE_STEPS = 4
"""Entries of `LevelNoise.octaves` per power of two."""
_SIDE_PX, _FRAMES = 64, 12
"""Side of the simulated patch, and its frames for each strength of the texture."""
_DEVIATION = {np.dtype(np.uint8): 1.5, np.dtype(np.uint16): 18.0}
"""Standard deviation of their noise in counts: coarse enough for integers, fine enough for a wide range of textures.

Frames are simulated in the type of those in use, for which the kernels of the measure are compiled anyway.
"""
_ROUNDING_COUNTS2 = 1 / 12
"""Variance of the rounding to counts, a part of the noise."""
_PEAK_SIGMAS = 5.0
"""Range of the texture about the mean grey, in its standard deviations."""
_STRENGTHS = (0.0, *(2.0**n for n in range(-2, 7)))
"""Standard deviation of the texture over that of the noise, in increasing order; 0 first. Few counts hold fewer."""
_TAPS = (0.25, 0.5, 0.25)
"""Filter of the texture along each axis: about that of a lens whose limit is the spacing of the pixels."""
_OCTAVES = 24
"""Range of the table of `LevelNoise` in powers of two."""
_SEED = 20240301
"""Seed of the simulated texture and noise."""


class LevelNoise(NamedTuple):
    """Standard deviation of a level due to the noise of the camera.

    octaves: float32 [n], by the height of the level over that of pure noise, in `NOISE_STEPS` a power of two from 0 on;
    of_noise: float32 [grey], log2 of the focus of pure noise by the grey of the pixel.
    """

    octaves: Float32s
    of_noise: Float32s


@lru_cache(maxsize=64)
def level_noise(measure: str, window: int, camera: CameraNoise, dtype: np.dtype[Any]) -> LevelNoise:
    """Return the noise of levels of a measure in frames of a camera."""
    greys = np.arange(2.0 ** (8 * dtype.itemsize))
    over, octaves, of_noise, degree = _simulated(measure, window, dtype)
    table = np.exp2(_extended(np.arange(NOISE_STEPS * _OCTAVES) / NOISE_STEPS, over, np.log2(octaves)))
    variance = camera.gain_counts * greys + camera.floor_counts2
    shift = 0.0 if focus_measures()[measure].uses_camera_noise else degree * np.log2(variance / _DEVIATION[dtype] ** 2)
    return LevelNoise(table.astype(np.float32), np.broadcast_to(of_noise + shift, greys.shape).astype(np.float32))


def _extended(at: NDArray[np.float64], over: NDArray[np.float64], log: NDArray[np.float64]) -> NDArray[np.float64]:
    """Interpolate the logarithm of the noise; beyond the strongest texture it falls by half an octave in an octave."""
    return np.interp(at, over, log) - 0.5 * np.maximum(at - over[-1], 0.0)


@lru_cache(maxsize=64)
def _simulated(
    measure: str, window: int, dtype: np.dtype[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64], float, float]:
    """Return mean levels over that of noise, their standard deviations in octaves, log2 of the focus of noise, degree.

    The degree is that of the focus in the variance of the grey: 1 for energies.
    """
    rng, margin = np.random.default_rng(_SEED), focus_measures()[measure].margin_px(window)
    side, deviation, grey = _SIDE_PX + 2 * margin, _DEVIATION[dtype], 2.0 ** (8 * dtype.itemsize - 1)
    strengths = np.array([s for s in _STRENGTHS if _PEAK_SIGMAS * s * deviation <= grey])
    texture = rng.standard_normal((side, side))
    for axis in (0, 1):
        texture = convolve1d(texture, _TAPS, axis=axis)
    texture *= deviation / texture.std()
    noise = rng.standard_normal((len(strengths), _FRAMES, side, side))
    once, twice = (np.sqrt((n * deviation) ** 2 - _ROUNDING_COUNTS2) for n in (1, 2))
    frames = grey + np.multiply.outer(strengths, texture)[:, None] + once * noise
    louder = grey + twice * noise[:1]
    counts = np.concatenate([frames, louder]).round().clip(0, 2 * grey - 1).astype(dtype)
    levels = _log2_focus(measure, window, margin, counts.reshape(-1, side, side), deviation**2)
    levels = levels.reshape(len(strengths) + 1, _FRAMES, -1)
    mean, scatter = levels.mean(axis=(1, 2)), np.sqrt(levels.var(axis=1, ddof=1).mean(axis=1))
    return mean[:-1] - mean[0], scatter[:-1], float(mean[0]), float(mean[-1] - mean[0]) / 2


def _log2_focus(measure: str, window: int, margin: int, counts: Image, variance_counts2: float) -> NDArray[np.float64]:
    """Return log2 of the focus [k, row, col] within the margin of frames."""
    kernels, shape, white = focus_kernels(measure), (_SIDE_PX, _SIDE_PX), 2 ** (8 * counts.dtype.itemsize)
    source = StackSource.of(counts, np.arange(len(counts)), margin, margin, white)
    levels, (best, peak, clipped) = np.empty((len(counts), *shape), np.uint16), np.empty((3, *shape), np.uint16)
    volume = Volume(levels, best, peak, clipped, np.empty((0, 0, 0), np.uint16))
    camera = CameraNoise(gain_counts=variance_counts2 / white, floor_counts2=variance_counts2 / 2)
    kernels.fill(source, Focusing(window, camera), kernels.make_rows(_SIDE_PX, window, counts.dtype), volume)
    return LevelTable.of(kernels.table(counts.dtype)).logarithms(levels).astype(np.float64)


# ---------------------------------------------------------------------------------------------------------- peak rivals


_AHEAD = 4
"""Prefetch distance in frames."""
_LEAST_APART = 3
"""Smallest distance of two tops in frames: the peak between tops two frames apart is off by a frame at most."""
_MIDDLE_SHARE = np.float32(1 / 6)
"""Largest distance of a height from the middle of two tops, as a share of theirs, that is not on either of them."""


class Rivals(NamedTuple):
    """Levels of the focus curves of a row away from their peaks, uint16 [col].

    rival, least: highest other top and lowest level. dip_top, dip_low: both ends of the deepest dip between the peak
    and a top nearer than a rival, and dip_at, the frame of its top. turn, turn_at: highest or lowest level so far
    between the peak and a frame near it, and its frame. peaking: uint8 [frame], 1 where any curve of the row peaks.
    """

    rival: UInt16s
    least: UInt16s
    dip_top: UInt16s
    dip_low: UInt16s
    dip_at: UInt16s
    turn: UInt16s
    turn_at: UInt16s
    peaking: UInt8s

    @classmethod
    def make(cls, cols: int) -> Rivals:
        """Allocate rows of `cols` pixels."""
        return cls(*(aligned((cols,), np.uint16) for _ in range(7)), peaking=np.zeros(1 << 16, np.uint8))


@inlined_part
def find_rivals(curves: FocusCurves, y: Int, gap: Int, octave: Int, found: Rivals) -> None:
    """Find the highest top of row y at least `gap` frames from its peaks, the lowest level, and dips nearer by.

    Without a rival the lowest level is used. octave: difference of two levels whose focus differs by a factor of two;
    0 where dips are not wanted.
    """
    levels, best, peak = curves.levels, curves.best[y], curves.peak[y]
    last, rival, least = levels.shape[0] - 1, found.rival, found.least
    rival[:] = 0
    least[:] = 65535
    for row in (found.dip_top, found.dip_low, found.dip_at, found.turn, found.turn_at):
        row[:] = 0
    found.peaking[: last + 1] = 0
    for x in range(peak.size):
        found.peaking[peak[x]] = 1
    for k in range(last + 1):
        prefetch(levels[min(k + _AHEAD, last), y])
        before, level, after = levels[max(k - 1, 0), y], levels[k, y], levels[min(k + 1, last), y]
        _rival_row(before, level, after, k, gap, peak, rival, least)
        if octave and found.peaking[max(k - gap + 1, 0) : min(k + gap, last + 1)].any():
            _dip_row(level, best, k, gap, octave, peak, found)
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
def _dip_row(level: UInt16s, best: UInt16s, k: Int, gap: Int, octave: Int, peak: UInt16s, found: Rivals) -> None:
    """Follow the curves nearer to their peaks than a rival: how far they fall again before, and rise again behind.

    What is not half as high as the peak is no top: it may be noise on a flank. Tops nearer to each other than half the
    gap, a focus width, or than `_LEAST_APART` frames misplace a height by no more than is usual.
    """
    turn, turn_at, dip_top, dip_low, dip_at = found.turn, found.turn_at, found.dip_top, found.dip_low, found.dip_at
    u = np.uint16
    first, width, here, half = u(k - gap + 1), u(2 * gap - 1), u(k), u(octave)
    apart = u(max(_LEAST_APART, (gap + 1) // 2))
    for x in range(level.size):
        q, old, top, low, at = level[x], turn[x], dip_top[x], dip_low[x], peak[x]
        near, behind = u(at - first) < width, at < here
        lower, higher = min(q, old), max(q, old)
        above, below = q if behind else higher, lower if behind else q
        is_apart = u(here - at if behind else at - here) >= apart
        counts = near & (is_apart | (not behind)) & (u(best[x] - above) < half)
        deeper = counts & (u(above - below) > u(top - low))
        kept = near & (is_apart | behind | (at == here))
        extreme = lower if behind else higher
        dip_top[x], dip_low[x] = above if deeper else top, below if deeper else low
        dip_at[x] = (here if behind else turn_at[x]) if deeper else dip_at[x]
        turn_at[x] = here if kept & (extreme == q) else turn_at[x]
        turn[x] = extreme if kept else old


@lean_part
def accept_middles(z_um: Float64s, peak: UInt16s, dip_at: UInt16s, found_um: Float32s, dip: Float32s) -> None:
    """Take the dip of a row of heights for none where a wide window found the middle of both tops."""
    for x in range(found_um.size):
        one_um, other_um = z_um[peak[x]], z_um[dip_at[x]]
        off_um = abs(found_um[x] - np.float32(0.5 * (one_um + other_um)))
        is_middle = off_um < _MIDDLE_SHARE * abs(np.float32(other_um - one_um))
        dip[x] = np.float32(0) if is_middle else dip[x]


# ----------------------------------------------------------------------------------------------------------------- peak


_DIP_SIGMAS = np.float32(3.0)
"""Depth of the dips that noise makes, in standard deviations of a level: of several frames it is the deepest."""


class PeakScratch(NamedTuple):
    """Scratch rows of the peaks of one row of pixels, and what decodes its levels.

    table, modulation: log2 of the focus of a level, and focus^0.4 of every level. rivals: the other tops of the curves;
    points: three points of each. mean_level, leverage_um: float32 [col], log2 of the focus in the window of a centred
    peak, and standard deviation of its height per octave of noise of the levels.
    """

    table: LevelTable
    modulation: Float32s
    rivals: Rivals
    points: ThreePoints
    mean_level: Float32s
    leverage_um: Float32s

    @classmethod
    def make(cls, cols: int, fractions: Float32s) -> PeakScratch:
        """Allocate rows of `cols` pixels for levels whose lower bits `fractions` decodes."""
        return cls(
            LevelTable.of(fractions),
            modulations(fractions.tobytes()),
            Rivals.make(cols),
            ThreePoints.make(cols),
            aligned((cols,), np.float32),
            aligned((cols,), np.float32),
        )


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
        """Arrays that the kernels fill."""
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


@lean_kernel
def describe_interpolated(
    curves: FocusCurves,
    source: StackSource,
    z_um: Float64s,
    how: PeakInterpolation,
    spots: PeakScratch,
    out: PeakScores,
) -> None:
    """Compute height, scores and all-in-focus grey of peaks of three points, one row at a time to stay in cache."""
    least, table, points = spots.rivals.least, spots.table, spots.points
    for y in range(curves.peak.shape[0]):
        _score_row(curves, source, y, how.gap, 0, spots, out)
        if how.blend:
            gather_blended(curves, y, least, z_um, how, table, points)
        else:
            gather(curves, y, least, z_um, how, table, points)
        place_row(how, points, out.z_um[y])
        out.noise_um[y, :] = np.nan
        out.dip[y, :] = 0


@lean_kernel
def describe_centred(
    curves: FocusCurves,
    source: StackSource,
    z_um: Float64s,
    gap: Int,
    window: CentringWindow,
    noise: LevelNoise,
    spots: PeakScratch,
    out: PeakScores,
) -> None:
    """Compute the same of centred peaks, and the noise of their heights."""
    for y in range(curves.peak.shape[0]):
        _score_row(curves, source, y, gap, 1 << spots.table.bits, spots, out)
        peak, mean_level, leverage_um = curves.peak[y], spots.mean_level, spots.leverage_um
        centre_row(curves.levels, peak, y, z_um, window, spots.modulation, out.z_um[y], mean_level, leverage_um)
        _propagate_noise(noise, out.all_in_focus[y], spots, out.noise_um[y], out.dip[y])
        accept_middles(z_um, peak, spots.rivals.dip_at, out.z_um[y], out.dip[y])


@inlined_part
def _score_row(
    curves: FocusCurves, source: StackSource, y: Int, gap: Int, octave: Int, spots: PeakScratch, out: PeakScores
) -> None:
    """Compute what does not depend on the kind of the peak: scores and all-in-focus grey of row y."""
    find_rivals(curves, y, gap, octave, spots.rivals)
    _score(curves, y, gap, spots.table, spots.rivals, out)
    row = source.top + y
    for x in range(curves.peak.shape[1]):
        out.all_in_focus[y, x] = source.images[source.slots[curves.peak[y, x]], row, source.left + x]


@lean_part
def _score(curves: FocusCurves, y: Int, gap: Int, table: LevelTable, rivals: Rivals, out: PeakScores) -> None:
    """Compute lead, fall, contrast and dip of the peaks of row y."""
    levels = curves.levels
    last = levels.shape[0] - 1
    for x in range(curves.peak.shape[1]):
        k = np.int64(curves.peak[y, x])
        sides = max(levels[max(0, k - gap), y, x], levels[min(last, k + gap), y, x])
        top = log2_of(curves.best[y, x], table)
        out.lead[y, x] = top - log2_of(rivals.rival[x], table)
        out.contrast[y, x] = top - log2_of(rivals.least[x], table)
        out.fall[y, x] = top - log2_of(sides, table)
        out.dip[y, x] = log2_of(rivals.dip_top[x], table) - log2_of(rivals.dip_low[x], table)


@lean_part
def _propagate_noise(noise: LevelNoise, grey: Greys, spots: PeakScratch, noise_um: Float32s, dip: Float32s) -> None:
    """Compute the standard deviation of a row of heights from that of the levels, and take theirs from the dips."""
    f, u = np.float32, np.uint32  # an unsigned index is not tested for counting from the end
    last, steps, zero, half = f(noise.octaves.size - 1), f(NOISE_STEPS), f(0), f(0.5)
    mean_level, leverage_um, octaves, of_noise = spots.mean_level, spots.leverage_um, noise.octaves, noise.of_noise
    for x in range(noise_um.size):
        over = (mean_level[x] - of_noise[u(grey[x])]) * steps + half
        of_level = octaves[u(np.int32(min(max(over, zero), last)))]
        noise_um[x] = leverage_um[x] * of_level
        dip[x] -= _DIP_SIGMAS * of_level
