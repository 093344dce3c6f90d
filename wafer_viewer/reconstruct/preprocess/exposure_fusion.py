"""Fusion of several exposures into linear radiance in 16 bits, clipped only with the shortest exposure.

The camera is assumed to be linear: counts = black + gain x light. The gain between exposures and the black level are
estimated from pixels that are well exposed in both. Exposure times are unreliable: sensors add some time of their own,
and a strobe shorter than the exposure ends it early. A pixel is the sum of its counts above black in all exposures that
are not too bright, divided by the sum of their gains. This is optimal for photon noise, so the longest valid exposure
dominates. An exposure fades out as it nears white, to avoid a contour from a small gain error. The variance of the
result is again linear in grey where all exposures are valid; above, where the longer ones have faded out, the gain of
that line is higher by the ratio of the missing light: three times for x2, nine times for x8.

Exposures that were taken in turn lie at different z: each is interpolated linearly between its own frames to the z of
the stack, else dark and bright areas would differ in height by a part of the z step.

The shading of a pixel is constant over z: it multiplies the focus curve of the pixel and does not move its peak. So the
frames stay as they are, and the one image that is made of them is corrected, from which overlaps are registered and the
texture of the surface is blended.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.calibration import ImageShading
from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.errors import ComputeError
from wafer_viewer.numerics.jit import Float32s, Greys, Real, UInt16s, kernel
from wafer_viewer.reconstruct.frame_blocks import Correction, FramePixels

# ------------------------------------------------------------------------------------------------------ exposure fusion


FULL_COUNTS = 65535
"""White of the shortest exposure in a fused image."""
FADES_FROM = 0.8
"""An exposure loses weight from this fraction of the clipping level on."""


OFFSET_STEPS = 0.06
"""Largest offset of an exposure from the z of the stack that is not interpolated, as a fraction of the z step: half the
motion in an exposure, 5 % of the step at most, by which passes one after the other differ."""


@dataclass(frozen=True, slots=True)
class ExposureRatioParameters:
    """Sample of a stack and limits of the estimate of gains and black level from its exposures.

    Parameters
    ----------
    frames : int
        Largest number of sampled frames.
    strips : int
        Largest number of sampled strips of a frame.
    cell_px : int, px
        Side of a square whose mean grey is compared.
    enough_cells : int
        Smallest number of squares that are well exposed in both of two exposures.
    groups : int
        Number of groups of squares of similar grey, through whose means a line is fitted.
    enough_range : float
        Minimum grey range of the longer exposure, as a fraction of white, to separate gain and black level.
    alike : float
        Exposures with a smaller ratio do not determine the black level.
    most_black : float
        Largest black level, as a fraction of white.
    """

    frames: int = 12
    strips: int = 6
    cell_px: int = 8
    enough_cells: int = 40
    groups: int = 10
    enough_range: float = 0.2
    alike: float = 1.15
    most_black: float = 0.1


EXPOSURE_RATIO = ExposureRatioParameters()
Cells = tuple[NDArray[np.float32], NDArray[np.float32]]


@dataclass(frozen=True, slots=True, eq=False)
class ZTaps:
    """Interpolation of an exposure to the z of the stack: two of its frames and the weight of the upper, [k]."""

    lower: NDArray[np.intp]
    upper: NDArray[np.intp]
    weight: NDArray[np.float32]

    def between(self, below: Image, above: Image, frames: slice, clipped_counts: int) -> Image:
        """Return the pixels [n, row, col] between those of two frames; clipped where one of them is."""
        between = below + self.weight[frames, None, None] * (above.astype(np.float32) - below)
        part: Image = np.maximum(below, above)
        np.copyto(part, np.rint(between), where=part < clipped_counts, casting="unsafe")
        return part


def z_taps(own_um: NDArray[np.float64], z_um: NDArray[np.float64]) -> ZTaps | None:
    """Return the interpolation of an exposure at own_um [k] to z_um [k], which rise; None if they hardly differ.

    At the ends the nearest frame is used.
    """
    if np.abs(own_um - z_um).max() <= OFFSET_STEPS * np.median(np.diff(z_um)):
        return None
    above = np.clip(np.searchsorted(own_um, z_um), 1, len(own_um) - 1)
    weight = np.clip((z_um - own_um[above - 1]) / (own_um[above] - own_um[above - 1]), 0.0, 1.0)
    return ZTaps(above - 1, above, weight.astype(np.float32))


@dataclass(frozen=True, slots=True, eq=False)
class Fusion(Correction):
    """Fusion of exposures, the shortest first, with gains relative to it.

    taps: interpolation to the z of the stack, for each exposure that was taken at other z; order: of the exposures in
    the stack; flicker: gains of each exposure [k] relative to their median, empty without flicker.
    """

    gains: tuple[float, ...]
    black_counts: float
    white_counts: int
    clipped_counts: int
    taps: tuple[ZTaps | None, ...]
    order: tuple[int, ...]
    flicker: tuple[NDArray[np.float32], ...] = ()

    @property
    def scale(self) -> float:
        """Fused counts per count above black of the shortest exposure."""
        return FULL_COUNTS / (self.white_counts - self.black_counts)

    @property
    def fused_clipped_counts(self) -> int:
        """Grey from which a pixel of the fused image counts as clipped."""
        return int(self.scale * (self.clipped_counts - self.black_counts)) - 1

    def fused_counts(self, counts: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return counts of the shortest exposure as fused counts."""
        return np.float32(self.scale) * (counts - np.float32(self.black_counts))

    def with_flicker(self, gains: Sequence[NDArray[np.float64]]) -> Fusion:
        """Return the fusion of exposures that flicker: the gains [k] of each, in the order of the stack."""
        found: list[NDArray[np.float32]] = []
        for n, taps in zip(self.order, self.taps, strict=True):
            own = gains[n].astype(np.float32)
            between = None if taps is None else own[taps.lower] * (1 - taps.weight) + own[taps.upper] * taps.weight
            found.append(own if between is None else between.astype(np.float32))
        return dataclasses.replace(self, flicker=tuple(found))

    def applied(self, pixels: FramePixels) -> FramePixels:
        """Fuse the exposures, of which those with taps have two layers."""
        layers, frames = iter(pixels.layers), pixels.frames
        exposures = [
            next(layers) if taps is None else taps.between(next(layers), next(layers), frames, self.clipped_counts)
            for taps in self.taps
        ]
        out = np.empty(exposures[0].shape, np.uint16)
        for n, k in enumerate(range(frames.start, frames.stop)):
            self._fuse([exposure[n] for exposure in exposures], self._gains_at(k), out[n])
        return pixels._replace(layers=(out,))

    def _gains_at(self, k: int) -> list[np.float32]:
        """Return the gain of each exposure in a frame."""
        steady = [np.float32(gain) for gain in self.gains]
        if not self.flicker:
            return steady
        return [np.float32(gain * of_frames[k]) for gain, of_frames in zip(steady, self.flicker, strict=True)]

    def _fuse(self, parts: list[Image], gains: list[np.float32], out: NDArray[np.uint16]) -> None:
        """Fuse a part of a frame [row, col] from all exposures."""
        light, gain = np.zeros(out.shape, np.float32), np.zeros(out.shape, np.float32)
        knee = np.float32(FADES_FROM * self.clipped_counts)
        fade = np.float32(1 / (self.clipped_counts - knee))
        for part, of_part in zip(parts[1:], gains[1:], strict=True):
            _add(part, np.float32(self.black_counts), of_part, knee, fade, light, gain)
        _finish(parts[0], np.float32(self.black_counts), gains[0], np.float32(self.scale), light, gain, out)


def fusion_of(
    images: Sequence[Image],
    slots: NDArray[np.intp],
    nominal: tuple[float, ...],
    white_counts: int,
    clipped: int,
    taps: Sequence[ZTaps | None],
) -> Fusion:
    """Estimate the fusion parameters of exposures (order, gains, black level) from a sample of frames `slots`.

    nominal: exposure times, used where too few pixels are well exposed in two exposures; nan if unknown. taps: of the
    exposures. Raises ComputeError if the gain is undetermined.
    """
    cells = [_cells(one, slots) for one in images]
    order = np.argsort([mean.mean() for mean, _ in cells], kind="stable")
    pairs = [_compare(cells[a], cells[b], nominal[b] / nominal[a], clipped) for a, b in pairwise(order)]
    black = [pair[1] for pair in pairs if pair[0] > EXPOSURE_RATIO.alike]
    black_counts = float(np.clip(np.median(black), 0, EXPOSURE_RATIO.most_black * white_counts)) if black else 0.0
    gains = np.cumprod([1.0, *(pair[0] for pair in pairs)])
    in_order = tuple(taps[i] for i in order), tuple(order.tolist())
    return Fusion(tuple(gains.tolist()), black_counts, white_counts, clipped, *in_order)


def _cells(images: Image, slots: NDArray[np.intp]) -> Cells:
    """Return mean and highest grey of small squares in some strips of some frames."""
    n_rows, n_cols = images.shape[1:]
    high, wide = min(EXPOSURE_RATIO.cell_px, n_rows), min(EXPOSURE_RATIO.cell_px, n_cols)
    tops = np.unique(np.linspace(0, n_rows - high, EXPOSURE_RATIO.strips).astype(int))
    picked = slots[np.unique(np.linspace(0, len(slots) - 1, EXPOSURE_RATIO.frames).astype(int))]
    cut = n_cols // wide * wide
    strips = np.concatenate([images[picked, top : top + high, :cut] for top in tops]).astype(np.float32)
    squares = strips.reshape(len(strips), high, cut // wide, wide)
    return squares.mean(axis=(1, 3)).ravel(), squares.max(axis=(1, 3)).ravel()


def _compare(short: Cells, long: Cells, nominal: float, clipped_counts: int) -> tuple[float, float]:
    """Return (brightness ratio of the longer exposure, black level).

    A line is fitted through the means of groups of cells. Cells are grouped by the sum of both greys, so that noise
    does not bias the grouping. Where all well-exposed cells are about equally bright, the ratio is that of the times;
    if these are unknown, black is taken as 0.
    """
    has_nominal = bool(np.isfinite(nominal)) and nominal > 1
    unclipped = long[1] < clipped_counts
    if np.count_nonzero(unclipped) < EXPOSURE_RATIO.enough_cells:
        return _by_times(nominal if has_nominal else None), 0.0
    x, y = short[0][unclipped].astype(np.float64), long[0][unclipped].astype(np.float64)
    groups = np.array_split(np.argsort(x * y.mean() / max(x.mean(), 1.0) + y), EXPOSURE_RATIO.groups)
    means = np.array([(x[g].mean(), y[g].mean()) for g in groups])
    if np.ptp(means[:, 1]) > EXPOSURE_RATIO.enough_range * clipped_counts:
        slope, offset = np.polyfit(means[:, 0], means[:, 1], 1)
    else:
        slope = nominal if has_nominal else y.mean() / max(x.mean(), 1.0)
        offset = y.mean() - slope * x.mean() if has_nominal else 0.0
    if slope < 1 / EXPOSURE_RATIO.alike:
        return _by_times(nominal if has_nominal else None), 0.0
    return float(slope), float(offset / (1 - slope)) if slope > EXPOSURE_RATIO.alike else 0.0


def _by_times(nominal: float | None) -> float:
    """Return the ratio of the exposure times where the pixels do not determine the gain."""
    if nominal is not None:
        return nominal
    raise ComputeError(
        "The exposures of the stack cannot be compared, too few pixels are well exposed in two of them: "
        "take them at most 8 times apart, or give their times."
    )


@kernel
def _add(counts: Greys, black: Real, of_part: Real, knee: Real, fade: Real, light: Float32s, gain: Float32s) -> None:
    """Add an exposure to the accumulated light and gain of each pixel."""
    one, none = np.float32(1), np.float32(0)
    for r in range(counts.shape[0]):
        row, light_row, gain_row = counts[r], light[r], gain[r]
        for x in range(row.size):
            value = np.float32(row[x])
            weight = min(one, max(none, one - (value - knee) * fade))
            light_row[x] += weight * (value - black)
            gain_row[x] += weight * of_part


@kernel
def _finish(
    shortest: Greys, black: Real, of_shortest: Real, scale: Real, light: Float32s, gain: Float32s, out: UInt16s
) -> None:
    """Add the shortest exposure, which always counts, and scale to 16 bits."""
    half, none, full = np.float32(0.5), np.float32(0), np.float32(65535)
    for r in range(shortest.shape[0]):
        row, light_row, gain_row, out_row = shortest[r], light[r], gain[r], out[r]
        for x in range(row.size):
            fused = (light_row[x] + np.float32(row[x]) - black) / (gain_row[x] + of_shortest) * scale
            out_row[x] = np.uint16(np.int32(min(full, max(none, fused + half))))


# ----------------------------------------------------------------------------------------------------------- flat field


def without_shading(picture: Image, shading: ImageShading | None) -> Image:
    """Return an image as a camera of equal sensitivity and without a dark level takes it.

    shading: in the counts of the image.
    """
    if shading is None:
        return picture
    light = (picture - shading.dark_counts) / shading.sensitivity
    counts: Any = np.clip(np.rint(light), 0, np.iinfo(picture.dtype).max)
    return counts.astype(picture.dtype)
