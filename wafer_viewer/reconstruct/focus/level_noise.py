"""Noise of the levels of a focus volume, from frames of one texture that differ by the noise of the camera alone.

The window of a measure and the strength of the texture over the noise determine by how much a level varies between two
frames. Both are simulated for the measure and window in use, so that a measure of another package needs no formula.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.numerics.jit import Float32s
from wafer_viewer.reconstruct.focus.focus_measures import focus_kernels
from wafer_viewer.reconstruct.focus.focus_volume import Focusing, LevelTable, StackSource, Volume
from wafer_viewer.reconstruct.preprocess.camera_noise import CameraNoise

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
