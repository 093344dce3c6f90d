"""Peak of the focus curve of each pixel along z: its height, the noise of that, and its scores.

All values of the focus volume are logarithms (base 2).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.numerics.jit import (
    Float32s,
    Float64s,
    Greys,
    Int,
    aligned,
    inlined_part,
    lean_kernel,
    lean_part,
)
from wafer_viewer.reconstruct.focus.focus_volume import COARSE_PX, FocusCurves, LevelTable, StackSource, log2_of
from wafer_viewer.reconstruct.focus.level_noise import NOISE_STEPS, LevelNoise
from wafer_viewer.reconstruct.focus.peak_centring import CentringWindow, centre_row, modulations
from wafer_viewer.reconstruct.focus.peak_interpolation import (
    PeakInterpolation,
    ThreePoints,
    gather,
    gather_blended,
    place_row,
)
from wafer_viewer.reconstruct.focus.peak_rivals import Rivals, accept_middles, find_rivals

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
        _score_row(curves, source, y, how.gap, spots, out)
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
        _score_row(curves, source, y, gap, spots, out)
        peak, mean_level, leverage_um = curves.peak[y], spots.mean_level, spots.leverage_um
        centre_row(curves.levels, peak, y, z_um, window, spots.modulation, out.z_um[y], mean_level, leverage_um)
        _propagate_noise(noise, out.all_in_focus[y], spots, out.noise_um[y], out.dip[y])
        accept_middles(z_um, peak, spots.rivals.dip_at, out.z_um[y], out.dip[y])


@inlined_part
def _score_row(curves: FocusCurves, source: StackSource, y: Int, gap: Int, spots: PeakScratch, out: PeakScores) -> None:
    """Compute what does not depend on the kind of the peak: scores and all-in-focus grey of row y."""
    find_rivals(curves, y, gap, 1 << spots.table.bits, spots.rivals)
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
