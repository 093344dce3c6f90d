"""Subpixel shift between two pictures, with covariance.

Gauss-Newton on grey values (B. D. Lucas, T. Kanade, IJCAI 1981), block by block. Each block has its own contrast and
brightness, which slopes along both axes, so differences in illumination do not matter, and a weight by its quality of
fit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from wafer_viewer.numerics.block_gradients import (
    LOOSE_PX,
    N_BEND_TERMS,
    BlockGradients,
    agreement_fraction,
    bend_terms,
    block_gradients,
    decreases,
    lag_errors,
    shift_gradient,
)
from wafer_viewer.numerics.block_sums import Numbers, block_sums, smoothed
from wafer_viewer.numerics.jit import Float32s


@dataclass(frozen=True, slots=True)
class AlignmentParameters:
    """Limits of the subpixel alignment.

    Parameters
    ----------
    most_steps : int
        Largest number of Gauss-Newton steps.
    close_px : float, px
        Step below which the alignment ends.
    roughly_close_px : float, px
        The same for a rough alignment.
    telling_px : float, px
        Step above which the change of the gradient shows the real fraction of the Hessian.
    probe_px : float, px
        Distance to either side of the lag for a Hessian by finite differences.
    anisotropic : float
        Stiffness of a direction beyond that of noise, relative to the other, below which it may be undetermined, as
        along lines.
    loose_noise : float
        Stiffness of such a direction, in that of noise, above which it is determined.
    loose_fraction : float
        The same, relative to the other direction.
    surely_rises : float, per px
        Smallest rise of the misfit in that direction, in the scatter of its gradient; a random picture rises by 1, at
        its best place by 2.
    least_rise : float
        The same without noise, relative to the other direction.
    surely_pulls : float
        Smallest gradient in that direction, in its scatter, for an alignment to go along it at first.
    beside_px : tuple[float, ...], px
        Distances to either side in that direction at which the pictures are compared once more: a dent of the misfit
        may be shallower than the slope it lies on.
    clearly_lowest : float
        Smallest unexplained variance there, relative to that at the place. Of the overlaps of tuning seeds below 110,
        those far off along lines had 0.97 to 1.06 within 4 px, good ones 1.13 and more.
    least_hessian_fraction : float
        Lower limit of the real fraction of the Hessian.
    noise_slope : float, per px
        Slope of the interpolated noise, relative to the noise of a pixel.
    clearly : float
        Smallest ratio of the stiffness to that of noise, to attribute it to the picture; a weaker one is
        probed.
    least_filled : float
        Smallest known fraction of a block's pixels, relative to the fullest block.
    least_pixels : float, px
        Smallest number of known pixels of a block.

    Notes
    -----
    `tests/bench/bench_overlaps.py` compares the errors of overlaps with their uncertainties.
    """

    most_steps: int = 6
    close_px: float = 0.005
    roughly_close_px: float = 0.05
    telling_px: float = 0.05
    probe_px: float = 0.2
    anisotropic: float = 0.2
    loose_noise: float = 2.0
    loose_fraction: float = 0.001
    surely_rises: float = 4.0
    least_rise: float = 1e-5
    surely_pulls: float = 2.0
    beside_px: tuple[float, ...] = (2.0, 4.0, 8.0)
    clearly_lowest: float = 1.1
    least_hessian_fraction: float = 0.05
    noise_slope: float = 0.3
    clearly: float = 10.0
    least_filled: float = 0.2
    least_pixels: float = 12.0


ALIGNMENT = AlignmentParameters()

_BOTH = np.eye(2)
"""Unit vectors where a picture determines both directions."""

Lag = tuple[float, float]


@dataclass(frozen=True, eq=False)
class RegisteredImage:
    """Part of a picture with its mask of known pixels (1 or 0), float32 [row, col].

    noise: upper bound of the standard deviation of its pixel-to-pixel noise.
    """

    values: Float32s
    valid: Float32s
    noise: float

    @cached_property
    def smoothed(self) -> Float32s:
        """The picture as it is compared with others: smoothed once for all lags."""
        return smoothed(self.values)


@dataclass(frozen=True, slots=True, eq=False)
class SubpixelShift:
    """A lag (rows, cols) in pixels: pixel (r, c) of the second is at (r + lag row, c + lag col) of the first.

    covariance: [2, 2], infinite if undetermined, `LOOSE_PX` squared along lines; correlation: within blocks, -1 ... 1;
    agreeing: fraction of the contrast in blocks that fit on their own; bent_px: deviation of the lags of the outermost
    blocks from that in the middle, and bent_sigmas: its significance; n_blocks: number of blocks; unexplained: fraction
    of the variance within them that the lag leaves; held: unit vectors of the directions that the picture determines,
    [2, k]; drift, drift_freedom: as in `LagErrors`; bend: as of `bend_terms`, NaN if undetermined or aligned roughly.
    """

    lag: Lag
    covariance: Numbers
    correlation: float
    agreeing: float
    bent_px: float
    bent_sigmas: float
    n_pixels: float
    n_blocks: int
    unexplained: float
    held: Numbers
    drift: Numbers
    drift_freedom: float
    bend: Numbers


def held_directions(covariance: Numbers) -> Numbers:
    """Return the unit vectors along which a covariance is not that of a loose direction, [2, k]."""
    (a, b), (c, d) = covariance.tolist()
    if not math.isfinite(a + b + c + d):
        return np.zeros((2, 0))
    if a + d < (LOOSE_PX / 2) ** 2:
        return _BOTH
    small, large, *axes = _principal_axes(covariance)
    held = [axis for variance, axis in zip((small, large), axes, strict=True) if variance < (LOOSE_PX / 2) ** 2]
    return np.array(held).reshape(-1, 2).T


def align(first: RegisteredImage, second: RegisteredImage, lag: Lag, side: int, roughly: bool = False) -> SubpixelShift:
    """Refine a lag that is correct within about a pixel.

    side: approximate block size in pixels; roughly: stop at a twentieth of a pixel, with a covariance that is too small
    under strong noise.
    """
    pulls, ease, close_px = (
        _gradients(first, second, lag, side),
        1.0,
        ALIGNMENT.roughly_close_px if roughly else ALIGNMENT.close_px,
    )
    noise = math.sqrt(first.noise * second.noise)
    surface = _Surface.of(first, second, lag, side, pulls, noise, begins=True)
    for _ in range(ALIGNMENT.most_steps):
        step, before = surface.step(pulls, ease), pulls
        lag, length = (lag[0] + step[0], lag[1] + step[1]), max(abs(step[0]), abs(step[1]))
        if length < close_px:
            break
        pulls = _gradients(first, second, lag, side)
        if length > ALIGNMENT.telling_px and surface.measured is None:
            ease = _hessian_fraction(before, pulls, step)
    surface = _Surface.of(first, second, lag, side, pulls, noise)
    if not roughly:
        surface = surface.unless_lower_beside(first, second, lag, side, pulls)
    stiffness = pulls.total_stiffness
    if surface.measured is not None:
        stiffness = surface.measured
    elif not roughly and not _is_clear(pulls, noise, surface.held):
        stiffness = _hessian_by_differences(first, second, lag, side)
    alike, errors = pulls.correlation, lag_errors(pulls, stiffness, surface.held)
    is_held = surface.held.shape[1] == 2
    bent_px, bent_sigmas = shift_gradient(pulls) if is_held else (0.0, 0.0)
    bend = bend_terms(pulls) if is_held and not roughly else np.full((2, N_BEND_TERMS), np.nan)
    of_picture = 1 - _noise_stiffness(pulls, noise) / np.maximum(np.diag(pulls.total_stiffness), 1e-30)
    bend = bend / np.tile(np.clip(of_picture, ALIGNMENT.least_hessian_fraction, 1.0), N_BEND_TERMS // 2)
    return SubpixelShift(
        lag,
        errors.covariance,
        alike,
        agreement_fraction(pulls, noise),
        bent_px / ease,
        bent_sigmas,
        float(pulls.pixels.sum()),
        len(pulls.pixels),
        1 - alike**2,
        held_directions(errors.covariance),
        errors.drift,
        errors.freedom,
        bend,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Surface:
    """Rise of the misfit of two pictures about a lag.

    held: unit vectors of the directions in which it rises, [2, k]: one of lines, both of anything else; measured: its
    Hessian by differences, where the slopes in one direction are mostly those of noise; None elsewhere.
    """

    held: Numbers
    measured: Numbers | None

    @classmethod
    def of(
        cls,
        first: RegisteredImage,
        second: RegisteredImage,
        lag: Lag,
        side: int,
        pulls: BlockGradients,
        noise: float,
        begins: bool = False,
    ) -> _Surface:
        """Look whether the picture determines the weaker direction, where its slopes are hardly more than noise.

        It does where the misfit really rises there, by more than that of a random picture may. Where an alignment
        begins the misfit need not be hollow yet: there it is enough that all blocks pull the same way.
        """
        weak, strong, along, across = _principal_axes(pulls.total_stiffness)
        of_noise = _noise_stiffness(pulls, noise)
        doubtful = max(ALIGNMENT.loose_noise * of_noise, ALIGNMENT.loose_fraction * strong)
        if weak >= doubtful or max(weak - of_noise, 0) >= ALIGNMENT.anisotropic * (strong - of_noise):
            return cls(_BOTH, None)
        scatter = float(np.sqrt(np.sum((pulls.pull @ along) ** 2)))
        if begins and abs(float(pulls.total_pull @ along)) > ALIGNMENT.surely_pulls * scatter:
            return cls(_BOTH, None)
        change = _change_along(first, second, lag, side, along)
        if float(along @ change) > max(ALIGNMENT.surely_rises * scatter, ALIGNMENT.least_rise * strong):
            beside = _change_along(first, second, lag, side, across)
            return cls(_BOTH, _symmetric(np.outer(change, along) + np.outer(beside, across)))
        return cls(across[:, None], None)

    def unless_lower_beside(
        self, first: RegisteredImage, second: RegisteredImage, lag: Lag, side: int, pulls: BlockGradients
    ) -> _Surface:
        """Return a surface that rises in one direction only if the pictures are as alike beside the lag in the other.

        Noise and single marks on lines make dents of the misfit, in which an alignment ends wherever it began.
        """
        if self.measured is None:
            return self
        _, _, along, across = _principal_axes(pulls.total_stiffness)
        limit = ALIGNMENT.clearly_lowest * (1 - pulls.correlation**2)
        for off_px in (sign * d for d in ALIGNMENT.beside_px for sign in (1, -1)):
            beside = lag[0] + off_px * float(along[0]), lag[1] + off_px * float(along[1])
            if 1 - _gradients(first, second, beside, side).correlation ** 2 < limit:
                return _Surface(across[:, None], None)
        return self

    def step(self, pulls: BlockGradients, ease: float) -> Lag:
        """Return one Gauss-Newton step of at most a pixel, along the determined directions."""
        stiffness, ease = (pulls.total_stiffness, ease) if self.measured is None else (self.measured, 1.0)
        (a, b), (c, d) = (stiffness * ease).tolist()
        more = 1e-6 * (a + d) + 1e-30
        a, d, (down, right) = a + more, d + more, pulls.total_pull.tolist()
        if self.held.shape[1] == 1:
            r, q = self.held[:, 0].tolist()
            length = (r * down + q * right) / (r * (a * r + b * q) + q * (c * r + d * q))
            return _within_a_pixel(r * length, q * length)
        determinant = a * d - b * c
        return _within_a_pixel((d * down - b * right) / determinant, (a * right - c * down) / determinant)


def _within_a_pixel(down: float, right: float) -> Lag:
    return min(max(down, -1.0), 1.0), min(max(right, -1.0), 1.0)


def _principal_axes(matrix: Numbers) -> tuple[float, float, Numbers, Numbers]:
    """Return the smaller and the larger eigenvalue of a symmetric matrix [2, 2], and their unit vectors."""
    (a, b), (_, c) = matrix.tolist()
    middle, half, angle = (a + c) / 2, math.hypot((a - c) / 2, b), math.atan2(2 * b, a - c) / 2
    cos, sin = math.cos(angle), math.sin(angle)
    return middle - half, middle + half, np.array([-sin, cos]), np.array([cos, sin])


def _noise_stiffness(pulls: BlockGradients, noise: float) -> float:
    """Return the stiffness along any direction that slopes of pixel noise alone would have."""
    return float((pulls.trust * pulls.pixels).sum()) * (ALIGNMENT.noise_slope * noise) ** 2


def _hessian_fraction(before: BlockGradients, after: BlockGradients, step: Lag) -> float:
    """Return the real fraction of the Hessian: slopes of the noise do not move with the picture."""
    found = decreases(before, after, step)
    if found is None:
        return 1.0
    decrease, expected = found
    return min(1.0, max(ALIGNMENT.least_hessian_fraction, decrease / max(expected, 1e-30)))


def _is_clear(pulls: BlockGradients, noise: float, held: Numbers) -> bool:
    """Return whether the slopes are those of the picture in all determined directions."""
    weak, strong, *_ = _principal_axes(pulls.total_stiffness)
    weakest = weak if held.shape[1] == 2 else strong
    return bool(weakest > ALIGNMENT.clearly * _noise_stiffness(pulls, noise))


def _hessian_by_differences(first: RegisteredImage, second: RegisteredImage, lag: Lag, side: int) -> Numbers:
    """Return the Hessian by finite differences of the gradient on both sides of a lag."""
    return _symmetric(np.stack([_change_along(first, second, lag, side, axis) for axis in _BOTH]))


def _change_along(first: RegisteredImage, second: RegisteredImage, lag: Lag, side: int, along: Numbers) -> Numbers:
    """Return the decrease of the gradient per pixel along a unit vector, [2]."""
    down, right = (ALIGNMENT.probe_px * along).tolist()
    ahead = _gradients(first, second, (lag[0] + down, lag[1] + right), side).total_pull
    behind = _gradients(first, second, (lag[0] - down, lag[1] - right), side).total_pull
    return (behind - ahead) / (2 * ALIGNMENT.probe_px)


def _symmetric(matrix: Numbers) -> Numbers:
    return (matrix + matrix.T) / 2


def _gradients(first: RegisteredImage, second: RegisteredImage, lag: Lag, side: int) -> BlockGradients:
    sums = block_sums(first.smoothed, first.valid, second.values, second.valid, lag, side)
    return block_gradients(sums, second.noise, ALIGNMENT.least_pixels, ALIGNMENT.least_filled)
