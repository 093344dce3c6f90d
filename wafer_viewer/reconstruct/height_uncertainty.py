"""Standard uncertainty of each height of a field.

Noise of the camera reaches a height through the levels in the window of its peak. Two terms are common to all pixels of
a field: interpolation between frames, and what the frames are seen to do (`FrameHealth`). Two come from the surface
under the focus window: where it is inclined, texture weighs one side of the window more than the other, and where it is
curved, the window lowers a summit and fills a hollow.

Errors of pixels that share a focus window are correlated: a mean of n neighbours is hardly more certain than one pixel.

A frame that is off along z pulls all heights near it the same way. Where the surface is tilted or curved, the mean
residual of a smooth fit per height shows that, alike in separate parts of the field; noise and form differ between the
parts, and cancel in the product of their residuals. What repeats with every step is interpolation, not jitter. Slow
deviations are fitted as form, so that the result is a lower bound. On level faces heights do not show jitter, but the
frames do (`frame_jitter`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.frame_health import FrameHealth
from wafer_viewer.numerics.jit import Float32s, Int, Real, inline_kernel, lean_kernel
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA, median

# ------------------------------------------------------------------------------------------------------------- z jitter


Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ZJitterParameters:
    """Sample of a height map and limits of the effect of z jitter.

    Parameters
    ----------
    sampled_px : int
        Approximate number of sampled pixels.
    per_step : int
        Height bins per z step.
    least_depths : float
        Smallest height range of a part, in depths of field.
    least_fill : float
        Smallest measured fraction of a part.
    most_residual : float
        Largest standard deviation of the residuals of a part, in depths of field; rougher parts have form of their own.
    least_points : int
        Smallest number of points of a bin.
    least_blocks : int
        Smallest number of independent blocks of heights, a depth of field each.
    sigmas : float
        Smallest mean product, in standard errors.
    lower_bound : float
        Factor for the jitter that the fit absorbs, from simulated planes.
    """

    sampled_px: int = 1 << 17
    per_step: int = 5
    least_depths: float = 3.0
    least_fill: float = 0.3
    most_residual: float = 0.3
    least_points: int = 12
    least_blocks: int = 5
    sigmas: float = 2.5
    lower_bound: float = 1.2


Z_JITTER = ZJitterParameters()


def jitter_effect_um(z_um: NDArray[np.float32], frames_um: Floats, depth_of_field_um: float) -> float:
    """Return the standard uncertainty of a height due to z jitter, 0 where it is not significant.

    Parameters
    ----------
    z_um : ndarray, [row, col], um
        Measured heights, neither smoothed nor filled, NaN elsewhere.
    frames_um : ndarray, [k], um
        z of the frames, rising.
    depth_of_field_um : float, um
        Depth of field.

    Returns
    -------
    float
        Root mean square of the common residuals, um.
    """
    step_um = float(np.median(np.diff(frames_um)))
    bin_um = step_um / Z_JITTER.per_step
    n_bins = int(np.ceil((frames_um[-1] - frames_um[0]) / bin_um)) + 1
    every = max(1, int(np.sqrt(z_um.size / Z_JITTER.sampled_px)))
    sampled = z_um[::every, ::every].astype(np.float64) - frames_um[0]
    found = [_profile(part, bin_um, n_bins, depth_of_field_um) for part in _quarters(sampled)]
    profiles = [profile for profile in found if profile is not None]
    if len(profiles) < 2:
        return 0.0
    products = np.full((len(profiles) * (len(profiles) - 1) // 2, n_bins), np.nan)
    for n, (one, other) in enumerate(combinations(profiles, 2)):
        products[n] = one * other
    shared = np.isfinite(products).any(axis=0)
    mean = np.nanmean(products[:, shared], axis=0)
    block = (np.flatnonzero(shared) * bin_um // depth_of_field_um).astype(int)
    blocks = np.array([mean[block == b].mean() for b in np.unique(block)])
    if len(blocks) < Z_JITTER.least_blocks:
        return 0.0
    variance, error = float(blocks.mean()), float(blocks.std(ddof=1)) / np.sqrt(len(blocks))
    return Z_JITTER.lower_bound * float(np.sqrt(variance)) if variance > Z_JITTER.sigmas * error else 0.0


def _quarters(z_um: Floats) -> list[Floats]:
    return [part for half in np.array_split(z_um, 2, axis=0) for part in np.array_split(half, 2, axis=1)]


def _profile(z_um: Floats, bin_um: float, n_bins: int, depth_um: float) -> Floats | None:
    """Return the mean residual of a quadratic fit per height bin, without what repeats with the step; NaN if empty."""
    rows, cols = np.nonzero(np.isfinite(z_um))
    if len(rows) < Z_JITTER.least_fill * z_um.size or len(rows) < 100:
        return None
    height, y, x = z_um[rows, cols], rows / z_um.shape[0] - 0.5, cols / z_um.shape[1] - 0.5
    low, high = np.percentile(height, (2, 98))
    if high - low < Z_JITTER.least_depths * depth_um:
        return None
    design = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    keep, weighted = np.ones(len(x), np.bool_), np.empty_like(design)
    fitted, residual, spread = height, height, np.inf
    for _ in range(3):
        np.multiply(design, keep, out=weighted)
        coefficients = np.linalg.lstsq(weighted @ design.T, weighted @ height, rcond=None)[0]
        fitted = coefficients @ design
        residual = height - fitted
        spread = MAD_TO_SIGMA * median(np.abs(residual))
        keep = np.abs(residual) <= 4 * spread
    if spread > Z_JITTER.most_residual * depth_um:
        return None
    index = np.clip((fitted[keep] / bin_um).astype(int), 0, n_bins - 1)  # by the fit: a bin of heights selects noise
    count = np.bincount(index, minlength=n_bins)
    mean = np.bincount(index, residual[keep], n_bins) / np.maximum(count, 1)
    profile = np.where(count >= Z_JITTER.least_points, mean, np.nan)
    for phase in range(Z_JITTER.per_step):
        of_phase = profile[phase :: Z_JITTER.per_step]
        if np.isfinite(of_phase).any():
            of_phase -= np.nanmean(of_phase)
    return profile


# --------------------------------------------------------------------------------------------------- height uncertainty


TEXTURE_SHARE = 0.07
"""Standard deviation of the centre of texture in a focus window, in windows: tests/bench/bench_pixel_u.py --seed 1."""
SLOPE_WINDOWS = 0.5
"""Distance of the two heights from whose difference the slope at a pixel between them is taken, in windows."""


def window_variance_px2(window: int, passes: int) -> float:
    """Return the variance of a window of `passes` boxes along one axis, in square pixels."""
    return passes * (window**2 - 1) / 12


def uncertainty_um(
    noise_um: NDArray[np.float32],
    z_um: NDArray[np.float32],
    window: int,
    passes: int,
    health: FrameHealth,
) -> NDArray[np.float32]:
    """Return the standard uncertainty (k = 1) of each height in um, NaN where there is none.

    noise_um: that of the peaks due to the noise of the camera; z_um: measured heights, NaN elsewhere; both [row, col].
    """
    common_um2 = health.u_between_um**2 + health.u_jitter_um**2 + health.u_flicker_um**2
    near, far = max(1, round(SLOPE_WINDOWS * window)), window
    out = np.empty(z_um.shape, np.float32)
    _combine(
        np.ascontiguousarray(noise_um),
        np.ascontiguousarray(z_um),
        common_um2,
        near,
        TEXTURE_SHARE * window / near,
        far,
        window_variance_px2(window, passes) / 2 / far**2,
        out,
    )
    return out


@lean_kernel
def _combine(
    noise_um: Float32s,
    z_um: Float32s,
    common_um2: Real,
    near: Int,
    per_rise: Real,
    far: Int,
    per_bend: Real,
    out: Float32s,
) -> None:
    rows, cols = z_um.shape
    for r in range(rows):
        for x in range(cols):
            z, noise = z_um[r, x], noise_um[r, x]
            if z != z:
                out[r, x] = np.nan
                continue
            along_y = _rise(_height(z_um, r - near, x), z, _height(z_um, r + near, x))
            along_x = _rise(_height(z_um, r, x - near), z, _height(z_um, r, x + near))
            bend = _bend(_height(z_um, r - far, x), z, _height(z_um, r + far, x))
            bend += _bend(_height(z_um, r, x - far), z, _height(z_um, r, x + far))
            of_form_um2 = per_rise**2 * (along_x**2 + along_y**2) + (per_bend * bend) ** 2
            out[r, x] = math.sqrt(noise * noise + common_um2 + of_form_um2)


@inline_kernel
def _height(z_um: Float32s, r: Int, x: Int) -> Real:
    """Return a height, NaN beyond the border."""
    inside = (r >= 0) & (r < z_um.shape[0]) & (x >= 0) & (x < z_um.shape[1])
    return z_um[r, x] if inside else np.float32(np.nan)


@inline_kernel
def _rise(before: Real, z: Real, after: Real) -> Real:
    """Return the mean rise from one height to the next of three, as far as they are measured."""
    first, last = z if before != before else before, z if after != after else after
    return (last - first) * (0.5 if (after == after) & (before == before) else 1.0)


@inline_kernel
def _bend(before: Real, z: Real, after: Real) -> Real:
    """Return the second difference of three heights, 0 if one is not measured."""
    second = before - 2 * z + after
    return second if second == second else 0.0
