"""The shift between two pictures to a small part of a pixel, and how sure it is.

Gauss-Newton on grey values (B. D. Lucas, T. Kanade, IJCAI 1981), block by block: each block has a brightness and a
contrast of its own, so that no light that differs matters, and counts by how well it fits.
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
    agreeing,
    bent,
    correlation,
    covariance,
    pulls_of,
)

MOST_STEPS = 6
CLOSE_PX, ROUGHLY_PX = 0.005, 0.05
_TELLING_PX, _PROBE_PX = 0.05, 0.2
_LEAST_EASE = 0.05
_NOISE_SLOPE = 0.3
_CLEARLY = 10.0
"""Slopes ten times those of the noise move with the picture; weaker ones are looked at."""
_LEAST_PIXELS = 0.2
"""A block that knows fewer of its pixels tells nothing."""

Numbers = NDArray[np.float64]
Lag = tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class RegisteredImage:
    """A part of a picture and which of its pixels are known (1 or 0), float32 [row, col].

    noise: at most the standard deviation of its noise, as far as it differs from pixel to pixel.
    """

    values: Float32s
    known: Float32s
    noise: float


@dataclass(frozen=True, slots=True, eq=False)
class SubpixelShift:
    """A lag (rows, cols) in pixels: pixel (r, c) of the second lies on (r + lag row, c + lag col) of the first.

    covariance: [2, 2], infinite where nothing tells; correlation: of what varies within blocks, -1 ... 1; agreeing:
    share of the contrast that lies in blocks which fit on their own; bent_px: by how much the blocks at the far ends
    want other lags than the middle, and bent_sigmas, how surely they do.
    """

    lag: Lag
    covariance: Numbers
    correlation: float
    agreeing: float
    bent_px: float
    bent_sigmas: float
    n_pixels: float


def align(first: RegisteredImage, second: RegisteredImage, lag: Lag, side: int, roughly: bool = False) -> SubpixelShift:
    """Refine a lag that is right within about a pixel.

    side: of the blocks, about, in pixels; roughly: to a twentieth of a pixel, with a covariance that is too small where
    there is much noise.
    """
    pulls, ease, close_px = _pulls(first, second, lag, side), 1.0, ROUGHLY_PX if roughly else CLOSE_PX
    for _ in range(MOST_STEPS):
        step, before = _step(pulls, ease), pulls
        lag = lag[0] + float(step[0]), lag[1] + float(step[1])
        if np.abs(step).max() < close_px:
            break
        pulls = _pulls(first, second, lag, side)
        if np.abs(step).max() > _TELLING_PX:
            ease = _eased(before, pulls, step)
    noise = math.sqrt(first.noise * second.noise)
    clear = roughly or _is_clear(pulls, noise)
    stiffness = pulls.stiffness.sum(axis=0) if clear else _probed(first, second, lag, side)
    bent_px, bent_sigmas = bent(pulls)
    shares = correlation(pulls), agreeing(pulls, noise)
    return SubpixelShift(
        lag, covariance(pulls, stiffness), *shares, bent_px / ease, bent_sigmas, float(pulls.pixels.sum())
    )


def _eased(before: BlockGradients, after: BlockGradients, step: Numbers) -> float:
    """How much of the stiffness is real: noise makes slopes too, which do not move with the picture."""
    told = float(step @ (before.pull.sum(axis=0) - after.pull.sum(axis=0)))
    return min(1.0, max(_LEAST_EASE, told / max(float(step @ before.stiffness.sum(axis=0) @ step), 1e-30)))


def _is_clear(pulls: BlockGradients, noise: float) -> bool:
    """Whether the slopes are those of the picture in every direction."""
    of_noise = float((pulls.trust * pulls.pixels).sum()) * (_NOISE_SLOPE * noise) ** 2
    return bool(np.linalg.eigvalsh(pulls.stiffness.sum(axis=0))[0] > _CLEARLY * of_noise)


def _probed(first: RegisteredImage, second: RegisteredImage, lag: Lag, side: int) -> Numbers:
    """The stiffness as it is felt: by how much the pull grows to both sides of a lag."""
    felt = np.empty((2, 2))
    for axis in (0, 1):
        ahead, behind = (
            _pulls(first, second, (lag[0] + off * (1 - axis), lag[1] + off * axis), side).pull.sum(axis=0)
            for off in (_PROBE_PX, -_PROBE_PX)
        )
        felt[axis] = (behind - ahead) / (2 * _PROBE_PX)
    return (felt + felt.T) / 2


def _pulls(first: RegisteredImage, second: RegisteredImage, lag: Lag, side: int) -> BlockGradients:
    sums = block_sums(first.values, first.known, second.values, second.known, lag, side)
    index = np.indices(sums.shape[:2]).reshape(2, -1).T
    place = 2 * (index + 0.5) / np.array(sums.shape[:2]) - 1
    flat = sums.reshape(-1, *sums.shape[2:])
    pixels = flat[:, 0, 0]
    enough = pixels > max(_LEAST_PIXELS * pixels.max(initial=0), 12.0)
    return pulls_of(flat[enough], index[enough], place[enough])


def _step(pulls: BlockGradients, ease: float) -> Numbers:
    """One step of Gauss-Newton, a pixel at most."""
    stiffness = pulls.stiffness.sum(axis=0) * ease
    stiffness = stiffness + 1e-6 * np.trace(stiffness) * np.eye(2) + 1e-30 * np.eye(2)
    return np.linalg.solve(stiffness, pulls.pull.sum(axis=0)).clip(-1, 1)
