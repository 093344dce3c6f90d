"""z jitter of single frames, from how smoothly the pictures change along z.

A detail of period p changes along z by at most NA / p periods per um: the geometrical blur of an aperture, which
diffraction only slows. Means over blocks of pixels keep the coarse periods, whose change is so slow that each frame
follows from those beside it. What a frame differs by is its offset along z times the change there: the ratio of both
over all blocks is its offset against its neighbours. The noise of the camera differs between two halves of the blocks,
and cancels in the product of their offsets.

The mean over a block passes some of the finer periods. In coarse steps a single frame sees them, which looks like an
offset of it. Windows with a smooth edge do not pass them: jitter counts where these show it too.

Level faces show it as well as tilted ones. An offset that all frames of a face share does not show, but moves the face:
its size follows from the jitter of the single frames, as far as they are independent.

A focus curve that is not sampled over a gap pulls its peak to one side: by up to half of a step where one frame is
missing, and nothing shows it. Only heights whose peak takes frames from both sides of the gap are concerned.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.calibration import WAVELENGTH_UM
from wafer_viewer.model.quantity import coverage_factor
from wafer_viewer.model.surface.frame_health import gap_u_um
from wafer_viewer.reconstruct.frame_blocks import Frames, StackWindow, read_part

# ----------------------------------------------------------------------------------------------------------- frame gaps


LEAST_GAP = 1.5
"""Smallest distance of neighbouring frames that is a gap, in median distances."""
REACH_DOF = 0.75
"""Distance from the ends of a gap up to which it moves peaks, in depths of field: tests/bench/bench_gaps.py."""
LEAST_CONCERNED = 0.01
"""Smallest fraction of the measured heights that a gap of a field concerns."""


@dataclass(frozen=True, slots=True)
class FrameGap:
    """Heights from low_um to high_um are concerned by a gap; u_um: their standard uncertainty due to it."""

    low_um: float
    high_um: float
    u_um: float

    def concerns(self, z_um: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Return which heights a gap concerns."""
        return (z_um >= self.low_um) & (z_um <= self.high_um)


def frame_gaps(frames_um: NDArray[np.float64], depth_of_field_um: float) -> tuple[FrameGap, ...]:
    """Return the gaps between frames at rising z."""
    apart_um = np.diff(frames_um)
    at = np.flatnonzero(apart_um > LEAST_GAP * np.median(apart_um)).tolist()
    reach_um = REACH_DOF * depth_of_field_um
    return tuple(
        FrameGap(frames_um[k] - reach_um, frames_um[k + 1] + reach_um, gap_u_um(apart_um[k], depth_of_field_um))
        for k in at
    )


def worst_gap_u_um(gaps: Sequence[FrameGap], z_um: NDArray[np.float32]) -> float:
    """Return the largest uncertainty by a gap that concerns the heights z_um, NaN where there are none; 0 without."""
    if not gaps:
        return 0.0
    measured = z_um[np.isfinite(z_um)]
    least = max(1.0, LEAST_CONCERNED * measured.size)
    return max((gap.u_um for gap in gaps if np.count_nonzero(gap.concerns(measured)) >= least), default=0.0)


def add_gaps(u_um: NDArray[np.float32], z_um: NDArray[np.float32], gaps: Sequence[FrameGap]) -> NDArray[np.float32]:
    """Return uncertainties of heights, both [row, col], with that by gaps."""
    out = u_um
    for gap in gaps:
        out = np.where(gap.concerns(z_um), np.hypot(out, np.float32(gap.u_um)), out)
    return out


# --------------------------------------------------------------------------------------------------------- frame jitter


Floats = NDArray[np.float64]
Blocks = NDArray[np.float32]
PREDICTS = np.array([0.79962126, -0.39134527, 0.09172401])
"""Weights of the sums of both frames at one, two and three steps that predict the frame between them.

Least squares over all changes of up to 0.2 periods a step, exact for what does not change.
"""
REACH = len(PREDICTS)
DIFFERS = np.concatenate([-PREDICTS[::-1], [1.0], -PREDICTS])
"""Weights of seven frames in the difference of the middle one from its prediction."""
CHANGES = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12
"""Weights of five frames in the change along z per step."""
NEIGHBOURS = 4
"""Adjacent smooth windows of one half; the last of them is left out, as it overlaps the other half."""
FRAMES_PER_FREEDOM = 3.5
"""Frames per independent offset: neighbours share most of the frames that they are compared with."""


@dataclass(frozen=True, slots=True)
class FrameJitterParameters:
    """Sample of a stack and limits of the jitter of its frames.

    Parameters
    ----------
    periods_per_step : float
        Fastest change along z that blocks of pixels keep.
    sampled_px : int, px
        Approximate number of sampled pixels of a frame.
    least_blocks : int
        Smallest number of blocks in a frame.
    least_change : float
        Smallest sum of squared changes of a frame that counts, relative to the largest one.
    least_frames : int
        Smallest number of frames that count.
    uneven : float, steps
        Largest deviation from even distances among the frames that are compared; a gap is larger.
    least : float, steps
        Smallest jitter that is told: sharp frames show 0.01 by the prediction (`smooth_scenes`, seeds below 60).
    sigmas : float
        Smallest jitter in standard errors of the noise.
    least_freedom : float
        Smallest degrees of freedom of the jitter.
    confirmed : float
        Smallest variance that smooth windows show within their standard error, relative to that of the blocks. Of 72
        scenes of rays without jitter, steps of 0.3 to 0.9 depths of field, 4 show some, without smooth windows 27; of
        144 with 0.03 depths of field 122, without them 126 (test_frame_jitter.py).
    """

    periods_per_step: float = 0.2
    sampled_px: int = 1 << 16
    least_blocks: int = 100
    least_change: float = 0.1
    least_frames: int = 3
    uneven: float = 0.3
    least: float = 0.015
    sigmas: float = 2.5
    least_freedom: float = 3.0
    confirmed: float = 0.5


FRAME_JITTER = FrameJitterParameters()


@dataclass(frozen=True, slots=True)
class FrameJitter:
    """Standard deviation of the z of single frames in um, 0 where it is not significant, and its degrees of freedom."""

    sigma_um: float
    freedom: float

    @property
    def widened_um(self) -> float:
        """Standard deviation widened by Student's t, so that k = 2 covers 95.45 % with few frames."""
        return self.sigma_um * coverage_factor(self.freedom) / 2 if self.sigma_um > 0 else 0.0


UNSEEN = FrameJitter(0.0, math.inf)
"""Jitter that does not show."""


class BlockMeans(NamedTuple):
    """Means of blocks, [k, block] each: flat over a block, and smooth by a raised cosine over two by two."""

    flat: Blocks
    smooth: Blocks

    @property
    def contrast(self) -> Blocks:
        """Deviation of the flat means from the mean of their frame, as a fraction."""
        return _contrast(self.flat)

    def in_order(self, order: NDArray[np.intp]) -> BlockMeans:
        """Return the means of the frames in another order."""
        return BlockMeans(self.flat[order], self.smooth[order])


def block_means(frames: Frames, depth_of_field_um: float) -> BlockMeans | None:
    """Return the means of blocks; None of too few.

    depth_of_field_um: of the lens, wavelength / NA^2 + pixel / NA.
    """
    if frames.n_frames < 2 * REACH + FRAME_JITTER.least_frames:
        return None
    side = _block_px(frames, depth_of_field_um)
    rows, cols = (n // side for n in frames.shape)
    if rows * cols < FRAME_JITTER.least_blocks or rows < 2 or cols < 2 * NEIGHBOURS:
        return None
    flat, smooth = zip(*_band_means(frames, side), strict=True)
    return BlockMeans(np.concatenate(flat, axis=1), np.concatenate(smooth, axis=1))


def frame_jitter(means: BlockMeans | None, z_um: Floats, step_um: float) -> FrameJitter:
    """Return the z jitter of the frames as far as means of blocks show it."""
    if means is None:
        return UNSEEN
    seen = _offsets(means.flat, z_um, step_um)
    if seen is None or not seen.significant:
        return UNSEEN
    confirmed = _offsets(means.smooth, z_um, step_um)
    if confirmed is None or confirmed.variance + confirmed.noise < FRAME_JITTER.confirmed * seen.variance:
        return UNSEEN
    freedom = max(FRAME_JITTER.least_freedom, seen.frames / FRAMES_PER_FREEDOM)
    variance = np.clip(confirmed.variance, FRAME_JITTER.confirmed * seen.variance, seen.variance)
    return FrameJitter(math.sqrt(variance) * step_um, freedom)


def _block_px(frames: Frames, depth_of_field_um: float) -> int:
    """Return the side of the smallest blocks that change slowly enough; their finest period is two blocks."""
    rise = frames.pixel_um + math.sqrt(frames.pixel_um**2 + 4 * depth_of_field_um * WAVELENGTH_UM)
    aperture = rise / (2 * depth_of_field_um)
    return math.ceil(aperture * frames.step_um / (2 * FRAME_JITTER.periods_per_step * frames.pixel_um))


def _band_means(frames: Frames, side: int) -> Iterator[tuple[Blocks, Blocks]]:
    """Yield means [k, block] of bands of rows spread over the frame, blocks of two halves in turn: flat and smooth.

    Flat over a block; smooth, by a raised cosine, over two by two blocks.
    """
    rows, cols = frames.shape[0] // side - 1, frames.shape[1] // side
    weights = np.sin(np.pi * (np.arange(2 * side) + 0.5) / (2 * side)).astype(np.float32) ** 2 / side
    first = np.flatnonzero(np.arange(cols - 1 - NEIGHBOURS) % (2 * NEIGHBOURS) < NEIGHBOURS - 1)
    halves = np.stack([first, first + NEIGHBOURS], axis=1).ravel()
    bands = min(rows, max(1, round(FRAME_JITTER.sampled_px / (side**2 * cols))))
    for band in np.unique(np.linspace(0, rows - 1, bands).astype(int)).tolist():
        block = read_part(frames, StackWindow(slice(band * side, (band + 2) * side), slice(0, cols * side)))
        flat = block[:, :side].sum(axis=1, dtype=np.uint32).reshape(frames.n_frames, cols, side)
        windows = np.einsum("r,krc->kc", weights, block.astype(np.float32)).reshape(flat.shape)
        smooth = windows[:, :-1] @ weights[:side] + windows[:, 1:] @ weights[side:]
        yield flat.sum(axis=2).astype(np.float32) / side**2, smooth[:, halves]


def _contrast(blocks: Blocks) -> Blocks:
    """Return the deviation of blocks [k, block] from the mean of their frame, as a fraction: flicker drops out."""
    return blocks / np.maximum(blocks.mean(axis=1, keepdims=True), 1e-9) - 1


class _Offsets(NamedTuple):
    """Variance of the offsets of single frames in steps squared, its standard error by noise, and number of frames."""

    variance: float
    noise: float
    frames: int

    @property
    def significant(self) -> bool:
        return self.variance >= max(FRAME_JITTER.least**2, FRAME_JITTER.sigmas * self.noise)


def _offsets(means: Blocks, z_um: Floats, step_um: float) -> _Offsets | None:
    """Return what means of blocks [k, block] show; None if too few frames change."""
    contrast = _contrast(means)
    every = _weighted(contrast, CHANGES)  # of the frames from the third on
    change = every[REACH - 2 : len(every) - REACH + 2]
    power, uneven = np.sum(change**2, axis=1), _uneven(z_um / step_um)
    counts = (power > FRAME_JITTER.least_change * power.max()) & (np.abs(uneven).max(axis=1) < FRAME_JITTER.uneven)
    if np.count_nonzero(counts) < FRAME_JITTER.least_frames:
        return None
    differs, change = _weighted(contrast, DIFFERS)[counts], change[counts]
    shares = _shares(every, change, np.flatnonzero(counts))
    known = np.sum(shares * uneven[counts], axis=1)
    odd = np.arange(contrast.shape[1]) % 2 == 1
    first, second = (
        np.sum((differs * change)[:, half], axis=1) / np.maximum(np.sum(change[:, half] ** 2, axis=1), 1e-30) - known
        for half in (odd, ~odd)
    )
    gain = float(np.sum(shares**2))
    variance = float(np.sum(first * second)) / gain
    noise = float(np.sum((first - second) ** 2)) / 2 / gain / math.sqrt(len(first))
    return _Offsets(variance, noise, len(first))


def _weighted(values: Blocks, weights: Floats) -> Blocks:
    """Return the weighted sums of neighbouring frames, [k - taps + 1, block]."""
    n = len(values) - len(weights) + 1
    out = np.zeros((n, values.shape[1]), np.float32)
    for k, weight in enumerate(weights.tolist()):
        if weight:
            out += weight * values[k : k + n]
    return out


def _uneven(place: Floats) -> Floats:
    """Return the deviations of the known places of frames, in steps, from even distances about the middle of seven."""
    seven = np.lib.stride_tricks.sliding_window_view(place, 2 * REACH + 1)
    return seven - seven[:, REACH : REACH + 1] - np.arange(-REACH, REACH + 1)


def _shares(every: Blocks, change: Blocks, first: NDArray[np.intp]) -> Floats:
    """Return how far an offset of each of seven frames shows in the offset of the middle one, [n, 7].

    every: changes of the frames from the third on; change: of the middle ones; first: the first of each seven frames.
    The change of the first and the last two frames of the stack is not known: they are far from focus.
    """
    known = np.pad(every, ((2, 2), (0, 0)))
    along = [np.sum(known[first + j] * change, axis=1) for j in range(len(DIFFERS))]
    return DIFFERS * np.stack(along, axis=1) / np.sum(change**2, axis=1, keepdims=True)
