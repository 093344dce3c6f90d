"""Subpixel shift between two pictures, with covariance.

Gauss-Newton on grey values (B. D. Lucas, T. Kanade, IJCAI 1981), block by block. Each block has its own brightness and
contrast, so differences in illumination do not matter, and a weight by its quality of fit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.array_types import Float32s
from wafer_viewer.numerics.registration.block_moments import block_sums
from wafer_viewer.numerics.registration.shift_estimation import (
    BlockGradients,
    agreement_fraction,
    block_gradients,
    correlation,
    covariance,
    shift_gradient,
)

MOST_STEPS = 6
CLOSE_PX, ROUGHLY_PX = 0.005, 0.05
_TELLING_PX, _PROBE_PX = 0.05, 0.2
_LEAST_EASE = 0.05
_NOISE_SLOPE = 0.3
_CLEARLY = 10.0
"""Slopes above ten times those of the noise are attributed to the picture; weaker ones are probed."""
_LEAST_PIXELS = 0.2
"""Smallest known fraction of a block's pixels, relative to the fullest block."""

Numbers = NDArray[np.float64]
Lag = tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class RegisteredImage:
    """Part of a picture with its mask of known pixels (1 or 0), float32 [row, col].

    noise: upper bound of the standard deviation of its pixel-to-pixel noise.
    """

    values: Float32s
    known: Float32s
    noise: float


@dataclass(frozen=True, slots=True, eq=False)
class SubpixelShift:
    """A lag (rows, cols) in pixels: pixel (r, c) of the second is at (r + lag row, c + lag col) of the first.

    covariance: [2, 2], infinite if undetermined; correlation: within blocks, -1 ... 1; agreeing: fraction of the
    contrast in blocks that fit on their own; bent_px: deviation of the lags of the outermost blocks from that in the
    middle, and bent_sigmas: its significance.
    """

    lag: Lag
    covariance: Numbers
    correlation: float
    agreeing: float
    bent_px: float
    bent_sigmas: float
    n_pixels: float


def align(first: RegisteredImage, second: RegisteredImage, lag: Lag, side: int, roughly: bool = False) -> SubpixelShift:
    """Refine a lag that is correct within about a pixel.

    side: approximate block size in pixels; roughly: stop at a twentieth of a pixel, with a covariance that is too small
    under strong noise.
    """
    pulls, ease, close_px = _gradients(first, second, lag, side), 1.0, ROUGHLY_PX if roughly else CLOSE_PX
    for _ in range(MOST_STEPS):
        step, before = _step(pulls, ease), pulls
        lag = lag[0] + float(step[0]), lag[1] + float(step[1])
        if np.abs(step).max() < close_px:
            break
        pulls = _gradients(first, second, lag, side)
        if np.abs(step).max() > _TELLING_PX:
            ease = _hessian_fraction(before, pulls, step)
    noise = math.sqrt(first.noise * second.noise)
    clear = roughly or _is_clear(pulls, noise)
    stiffness = pulls.stiffness.sum(axis=0) if clear else _hessian_by_differences(first, second, lag, side)
    bent_px, bent_sigmas = shift_gradient(pulls)
    shares = correlation(pulls), agreement_fraction(pulls, noise)
    return SubpixelShift(
        lag, covariance(pulls, stiffness), *shares, bent_px / ease, bent_sigmas, float(pulls.pixels.sum())
    )


def _hessian_fraction(before: BlockGradients, after: BlockGradients, step: Numbers) -> float:
    """Return the real fraction of the Hessian: slopes of the noise do not move with the picture."""
    told = float(step @ (before.pull.sum(axis=0) - after.pull.sum(axis=0)))
    return min(1.0, max(_LEAST_EASE, told / max(float(step @ before.stiffness.sum(axis=0) @ step), 1e-30)))


def _is_clear(pulls: BlockGradients, noise: float) -> bool:
    """Return whether the slopes are those of the picture in every direction."""
    of_noise = float((pulls.trust * pulls.pixels).sum()) * (_NOISE_SLOPE * noise) ** 2
    return bool(np.linalg.eigvalsh(pulls.stiffness.sum(axis=0))[0] > _CLEARLY * of_noise)


def _hessian_by_differences(first: RegisteredImage, second: RegisteredImage, lag: Lag, side: int) -> Numbers:
    """Return the Hessian by finite differences of the gradient on both sides of a lag."""
    felt = np.empty((2, 2))
    for axis in (0, 1):
        ahead, behind = (
            _gradients(first, second, (lag[0] + off * (1 - axis), lag[1] + off * axis), side).pull.sum(axis=0)
            for off in (_PROBE_PX, -_PROBE_PX)
        )
        felt[axis] = (behind - ahead) / (2 * _PROBE_PX)
    return (felt + felt.T) / 2


def _gradients(first: RegisteredImage, second: RegisteredImage, lag: Lag, side: int) -> BlockGradients:
    sums = block_sums(first.values, first.known, second.values, second.known, lag, side)
    index = np.indices(sums.shape[:2]).reshape(2, -1).T
    place = 2 * (index + 0.5) / np.array(sums.shape[:2]) - 1
    flat = sums.reshape(-1, *sums.shape[2:])
    pixels = flat[:, 0, 0]
    enough = pixels > max(_LEAST_PIXELS * pixels.max(initial=0), 12.0)
    return block_gradients(flat[enough], index[enough], place[enough])


def _step(pulls: BlockGradients, ease: float) -> Numbers:
    """Return one Gauss-Newton step of at most a pixel."""
    stiffness = pulls.stiffness.sum(axis=0) * ease
    stiffness = stiffness + 1e-6 * np.trace(stiffness) * np.eye(2) + 1e-30 * np.eye(2)
    return np.linalg.solve(stiffness, pulls.pull.sum(axis=0)).clip(-1, 1)
