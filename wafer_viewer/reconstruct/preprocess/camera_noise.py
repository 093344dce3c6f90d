"""Estimation of the camera noise from the stack itself: variance = gain x grey + floor.

Photon transfer without a calibration image: most of a focus stack is out of focus, so that the minima of a high-pass
filter contain only noise. Cells of the sampled frames are sorted by their grey, a low percentile of their variance is
taken at every grey level, and the line that most levels agree on describes the camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.recipe import Noise
from wafer_viewer.numerics.jit import Greys
from wafer_viewer.reconstruct.frame_blocks import Frames, StackWindow, read_part

Floats = NDArray[np.floating[Any]]

QUANTISATION_COUNTS2 = 1 / 12
"""Variance of rounding to integer counts."""


@dataclass(frozen=True, slots=True)
class NoiseEstimateParameters:
    """Sample of a stack and limits of the estimate of its camera noise.

    Parameters
    ----------
    frames : int
        Largest number of sampled frames.
    strips : int
        Largest number of sampled strips of a frame.
    cell_px : tuple[int, int], px
        Rows and columns of a cell; a strip has two rows of cells.
    levels : int
        Number of grey levels, of equal width, by which the cells are sorted.
    enough_cells : int
        Smallest number of cells of a level that counts.
    percentile : float
        Percentile of the variance of the cells of a level.
    of_the_mean : float
        Ratio of the 20th percentile of a cell's variance to its mean, for pure noise.
    too_low : float
        Weight of a level below the line against one above it: texture only adds to the noise variance.
    most_electrons : float, electrons
        Upper bound of the full-well capacity; it keeps the gain of a noise-free stack positive.
    usual_electrons : float, electrons
        Full-well capacity of a small pixel, used where the stack gives no estimate.
    """

    frames: int = 12
    strips: int = 3
    cell_px: tuple[int, int] = (8, 16)
    levels: int = 16
    enough_cells: int = 24
    percentile: float = 20.0
    of_the_mean: float = 0.80
    too_low: float = 3.0
    most_electrons: float = 1e6
    usual_electrons: float = 1e4


NOISE_ESTIMATE = NoiseEstimateParameters()
_HIGH_PASS_GAIN = 36.0
"""Sum of the squares of [1 -2 1] x [1 -2 1]."""


@dataclass(frozen=True, slots=True)
class CameraNoise:
    """Noise model: the variance of a grey I is gain_counts I + floor_counts2, in counts^2; both positive."""

    gain_counts: float
    floor_counts2: float

    def variance_counts2(self, grey_counts: float) -> float:
        """Return the noise variance at a grey."""
        return self.gain_counts * grey_counts + self.floor_counts2


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """Small rectangles of the sampled frames: mean grey and noise variance."""

    grey: Floats
    variance: Floats


def estimate_camera_noise(frames: Frames) -> CameraNoise:
    """Estimate the camera noise of a stack, without its clipped pixels.

    A stack without any noise gets the rounding noise of its counts, and one that is clipped everywhere the noise of a
    typical camera.
    """
    strips = _sample(frames)
    step = _count_step(strips)
    least = CameraNoise(
        frames.clipped_counts / NOISE_ESTIMATE.most_electrons, QUANTISATION_COUNTS2 * max(step, frames.scale) ** 2
    )
    grey, variance, weight = _levels(_unclipped_cells(strips, frames.clipped_counts))
    if not grey.size:
        return CameraNoise(frames.clipped_counts / NOISE_ESTIMATE.usual_electrons, least.floor_counts2)
    return _line(grey, variance, weight, least)


def settled_noise(frames: Frames, noise: Noise) -> Noise:
    """Replace every `auto` of a recipe's noise, in counts of the camera, by an estimate from the stack."""
    if "auto" not in (noise.gain_counts, noise.floor_counts2):
        return noise
    found = estimate_camera_noise(frames)
    gain = found.gain_counts / frames.scale if noise.gain_counts == "auto" else noise.gain_counts
    floor = found.floor_counts2 / frames.scale**2 if noise.floor_counts2 == "auto" else noise.floor_counts2
    return Noise(gain_counts=gain, floor_counts2=floor)


def camera_of(noise: Noise, scale: float = 1.0) -> CameraNoise:
    """Return the camera noise of a recipe whose noise is settled, in frames with `scale` counts per count."""
    return CameraNoise(scale * float(noise.gain_counts), scale**2 * float(noise.floor_counts2))


def _sample(frames: Frames) -> Greys:
    """Sample strips of a few frames, two rows of cells and their neighbours each: [strip, row, col]."""
    n_rows, n_cols = frames.shape
    high = min(2 * NOISE_ESTIMATE.cell_px[0] + 2, n_rows)
    picked = np.unique(np.linspace(0, frames.n_frames - 1, NOISE_ESTIMATE.frames).round().astype(int))
    strips: list[Greys] = []
    for top in np.unique(np.linspace(0, n_rows - high, 2 * NOISE_ESTIMATE.strips + 1).astype(int)[1::2]):
        strip = read_part(frames, StackWindow(slice(int(top), int(top) + high), slice(0, n_cols)))
        strips.append(strip[picked])
    return np.concatenate(strips)


def _count_step(strips: Greys) -> int:
    """Return the grey level step: 16 where 12 bits were shifted up to fill 16."""
    used = int(np.bitwise_or.reduce(strips, axis=None))
    lowest = used & -used
    return lowest if strips.dtype.itemsize > 1 and 0 < lowest <= 256 else 1


def _unclipped_cells(strips: Greys, clipped_counts: int) -> _Cells:
    """Return the cells in which no pixel is black or clipped."""
    inner = strips[:, 1:-1, 1:-1]
    clipped = _by_cell(((inner == 0) | (inner >= clipped_counts)).astype(np.float32))
    cells = _Cells(_by_cell(inner.astype(np.float32)), _by_cell(_high_pass(strips) ** 2) / _HIGH_PASS_GAIN)
    clear = clipped == 0
    return _Cells(cells.grey[clear], cells.variance[clear])


def _high_pass(strips: Greys) -> Floats:
    """Apply [1 -2 1] along columns and rows, which removes gradients and curvature along each axis."""
    grey = strips.astype(np.float32)
    down = grey[:, :-2] + grey[:, 2:] - 2 * grey[:, 1:-1]
    return down[:, :, :-2] + down[:, :, 2:] - 2 * down[:, :, 1:-1]


def _by_cell(values: Floats) -> Floats:
    """Return the mean of every complete cell, or of a smaller image as one cell; nothing for an empty image."""
    if not values.size:
        return values.ravel()
    high, wide = (min(size, cell) for size, cell in zip(values.shape[1:], NOISE_ESTIMATE.cell_px, strict=True))
    n_rows, n_cols = values.shape[1] // high, values.shape[2] // wide
    cropped = values[:, : n_rows * high, : n_cols * wide]
    return cropped.reshape(len(values), n_rows, high, n_cols, wide).mean(axis=(2, 4)).ravel()


def _levels(cells: _Cells) -> tuple[Floats, Floats, Floats]:
    """Return grey, variance and cell count of every sufficiently filled grey level, or else of all cells."""
    if not cells.grey.size:
        return cells.grey, cells.variance, cells.grey
    edges = np.linspace(cells.grey.min(), cells.grey.max(), NOISE_ESTIMATE.levels + 1)[1:-1]
    level = np.digitize(cells.grey, edges)
    enough = [n for n in range(NOISE_ESTIMATE.levels) if np.count_nonzero(level == n) >= NOISE_ESTIMATE.enough_cells]
    groups = [level == n for n in enough] or [np.ones(level.shape, bool)]
    grey = np.array([cells.grey[group].mean() for group in groups], np.float64)
    low = np.array([np.percentile(cells.variance[group], NOISE_ESTIMATE.percentile) for group in groups])
    return grey, low / NOISE_ESTIMATE.of_the_mean, np.array([float(np.count_nonzero(group)) for group in groups])


def _line(grey: Floats, variance: Floats, weight: Floats, least: CameraNoise) -> CameraNoise:
    """Return the best-fitting line through two levels, or through one level with minimum gain or floor."""
    i, j = np.triu_indices(grey.size, 1)
    through_two = (variance[j] - variance[i]) / (grey[j] - grey[i])
    steepest = (variance - least.floor_counts2) / np.maximum(grey, 1.0)
    gain = np.maximum(np.concatenate([through_two, steepest, np.zeros_like(grey)]), least.gain_counts)
    pixel = np.concatenate([i, np.arange(grey.size), np.arange(grey.size)])
    floor = np.maximum(variance[pixel] - gain * grey[pixel], least.floor_counts2)
    best = int(np.argmin([_misfit(grey, variance, weight, g, f) for g, f in zip(gain, floor, strict=True)]))
    return CameraNoise(float(gain[best]), float(floor[best]))


def _misfit(grey: Floats, variance: Floats, weight: Floats, gain: float, floor: float) -> float:
    """Return the logarithmic misfit of the levels to a line, so that dark and bright levels count equally.

    Texture only adds to the variance: a level far above the line carries little information, one below it indicates a
    wrong line.
    """
    off = np.log(np.maximum(variance, QUANTISATION_COUNTS2) / (gain * grey + floor))
    return float((np.sqrt(weight) * np.where(off < 0, -NOISE_ESTIMATE.too_low * off, np.minimum(off, 1.0))).sum())
