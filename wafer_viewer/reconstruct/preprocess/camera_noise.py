"""How much the camera's grey scatters, told from the stack itself: variance = gain x grey + floor.

Photon transfer without a picture of its own: most of a focus stack is out of focus, so that wherever a high-pass finds
least it finds noise alone. Cells of the sampled frames are sorted by their grey, a low percentile of their variance is
taken at every grey level, and the line that most levels agree on is the camera's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.recipe import Noise
from wafer_viewer.numerics.array_types import Greys
from wafer_viewer.reconstruct.preprocess.frames import Frames, read_block

Floats = NDArray[np.floating[Any]]

QUANTISATION_COUNTS2 = 1 / 12
"""The variance of rounding to whole counts."""

_MOST_ELECTRONS = 1e6
"""White of no camera holds more electrons: this keeps the gain of a noise-free stack over nothing."""

_USUAL_ELECTRONS = 1e4
"""White of a small pixel, where the stack says nothing."""

_FRAMES = 12
_STRIPS = 3
_CELL_PX = (8, 16)
_PERCENTILE = 20.0
_OF_THE_MEAN = 0.80
"""What the 20th percentile of a cell's variance is of its mean, on noise."""

_HIGH_PASS_GAIN = 36.0
"""The sum of the squares of [1 -2 1] x [1 -2 1]."""

_LEVELS = 16
_ENOUGH_CELLS = 24
_TOO_LOW = 3.0
"""A level under the line counts three times one above it: texture adds to noise, nothing takes from it."""


@dataclass(frozen=True, slots=True)
class CameraNoise:
    """The variance of a grey I is gain_counts I + floor_counts2, in counts^2; both over 0."""

    gain_counts: float
    floor_counts2: float

    def variance_counts2(self, grey_counts: float) -> float:
        """The variance of the noise at a grey."""
        return self.gain_counts * grey_counts + self.floor_counts2


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """Small rectangles of the sampled frames: their mean grey and the variance of their noise."""

    grey: Floats
    variance: Floats


def estimate_camera_noise(frames: Frames) -> CameraNoise:
    """The noise of the camera that took a stack; clipped pixels are left out.

    A stack without any noise gets the rounding of its counts, and one that is clipped all over a usual camera's noise.
    """
    strips = _sample(frames)
    step = _count_step(strips)
    least = CameraNoise(_white(frames) / _MOST_ELECTRONS, QUANTISATION_COUNTS2 * step**2)
    grey, variance, weight = _levels(_unclipped_cells(strips, frames.clipped_counts))
    if not grey.size:
        return CameraNoise(_white(frames) / _USUAL_ELECTRONS, least.floor_counts2)
    return _line(grey, variance, weight, least)


def settled_noise(frames: Frames, noise: Noise) -> Noise:
    """A recipe's noise with every `auto` replaced by what the stack says."""
    if "auto" not in (noise.gain_counts, noise.floor_counts2):
        return noise
    found = estimate_camera_noise(frames)
    gain = found.gain_counts if noise.gain_counts == "auto" else noise.gain_counts
    floor = found.floor_counts2 if noise.floor_counts2 == "auto" else noise.floor_counts2
    return Noise(gain_counts=gain, floor_counts2=floor)


def camera_of(noise: Noise) -> CameraNoise:
    """The camera of a recipe whose noise is settled."""
    return CameraNoise(float(noise.gain_counts), float(noise.floor_counts2))


def _sample(frames: Frames) -> Greys:
    """Strips of a few frames, two rows of cells and their neighbours each: [strip, row, col]."""
    n_rows, n_cols = frames.shape
    high = min(2 * _CELL_PX[0] + 2, n_rows)
    picked = np.unique(np.linspace(0, frames.n_frames - 1, _FRAMES).round().astype(int))
    strips: list[Greys] = []
    for top in np.unique(np.linspace(0, n_rows - high, 2 * _STRIPS + 1).astype(int)[1::2]):
        strip = np.empty((frames.n_frames, high, n_cols), frames.dtype)
        read_block(frames, slice(int(top), int(top) + high), slice(0, n_cols), 0, strip)
        strips.append(strip[picked])
    return np.concatenate(strips)


def _count_step(strips: Greys) -> int:
    """By how much neighbouring greys differ: 16 where 12 bits were shifted up to fill 16."""
    used = int(np.bitwise_or.reduce(strips, axis=None))
    lowest = used & -used
    return lowest if strips.dtype.itemsize > 1 and 0 < lowest <= 256 else 1


def _white(frames: Frames) -> float:
    return float(frames.clipped_counts)


def _unclipped_cells(strips: Greys, clipped_counts: int) -> _Cells:
    """The cells in which no pixel is black or too bright."""
    inner = strips[:, 1:-1, 1:-1]
    clipped = _by_cell(((inner == 0) | (inner >= clipped_counts)).astype(np.float32))
    cells = _Cells(_by_cell(inner.astype(np.float32)), _by_cell(_high_pass(strips) ** 2) / _HIGH_PASS_GAIN)
    clear = clipped == 0
    return _Cells(cells.grey[clear], cells.variance[clear])


def _high_pass(strips: Greys) -> Floats:
    """[1 -2 1] down the columns and along the rows: no slope or bend of the light passes."""
    grey = strips.astype(np.float32)
    down = grey[:, :-2] + grey[:, 2:] - 2 * grey[:, 1:-1]
    return down[:, :, :-2] + down[:, :, 2:] - 2 * down[:, :, 1:-1]


def _by_cell(values: Floats) -> Floats:
    """The mean of every whole cell, or of what there is of an image that is smaller than one; none of an empty one."""
    if not values.size:
        return values.ravel()
    high, wide = (min(size, cell) for size, cell in zip(values.shape[1:], _CELL_PX, strict=True))
    n_rows, n_cols = values.shape[1] // high, values.shape[2] // wide
    whole = values[:, : n_rows * high, : n_cols * wide]
    return whole.reshape(len(values), n_rows, high, n_cols, wide).mean(axis=(2, 4)).ravel()


def _levels(cells: _Cells) -> tuple[Floats, Floats, Floats]:
    """Grey, variance and number of cells of every grey level with enough cells; without any, of all cells as one."""
    if not cells.grey.size:
        return cells.grey, cells.variance, cells.grey
    edges = np.linspace(cells.grey.min(), cells.grey.max(), _LEVELS + 1)[1:-1]
    level = np.digitize(cells.grey, edges)
    enough = [n for n in range(_LEVELS) if np.count_nonzero(level == n) >= _ENOUGH_CELLS]
    groups = [level == n for n in enough] or [np.ones(level.shape, bool)]
    grey = np.array([cells.grey[group].mean() for group in groups], np.float64)
    variance = np.array([np.percentile(cells.variance[group], _PERCENTILE) for group in groups]) / _OF_THE_MEAN
    return grey, variance, np.array([float(np.count_nonzero(group)) for group in groups])


def _line(grey: Floats, variance: Floats, weight: Floats, least: CameraNoise) -> CameraNoise:
    """The line of least misfit among those through two levels, and through one level with the least gain or floor."""
    i, j = np.triu_indices(grey.size, 1)
    through_two = (variance[j] - variance[i]) / (grey[j] - grey[i])
    steepest = (variance - least.floor_counts2) / np.maximum(grey, 1.0)
    gain = np.maximum(np.concatenate([through_two, steepest, np.zeros_like(grey)]), least.gain_counts)
    at = np.concatenate([i, np.arange(grey.size), np.arange(grey.size)])
    floor = np.maximum(variance[at] - gain * grey[at], least.floor_counts2)
    best = int(np.argmin([_misfit(grey, variance, weight, g, f) for g, f in zip(gain, floor, strict=True)]))
    return CameraNoise(float(gain[best]), float(floor[best]))


def _misfit(grey: Floats, variance: Floats, weight: Floats, gain: float, floor: float) -> float:
    """How far the levels are from a line, as logarithms, so that dark and bright ones count alike.

    Texture only adds to the variance: a level far over the line says little, one under it that the line is wrong.
    """
    off = np.log(np.maximum(variance, QUANTISATION_COUNTS2) / (gain * grey + floor))
    return float((np.sqrt(weight) * np.where(off < 0, -_TOO_LOW * off, np.minimum(off, 1.0))).sum())
