"""Effect of the z jitter of single frames on heights, from a smooth surface that spans several depths of field.

A frame that is off along z pulls all heights near it the same way. Where the surface is tilted or curved, the mean
residual of a smooth fit per height shows that, alike in separate parts of the field; noise and form differ between the
parts, and cancel in the product of their residuals. What repeats with every step is interpolation, not jitter. Slow
deviations are fitted as form, so that the result is a lower bound. On level faces heights do not show jitter, but the
frames do (`frame_jitter`).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA

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
    design = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    keep = np.ones(len(x), np.bool_)
    fitted, residual, spread = height, height, np.inf
    for _ in range(3):
        used = design[keep]
        coefficients = np.linalg.lstsq(used.T @ used, used.T @ height[keep], rcond=None)[0]
        fitted = design @ coefficients
        residual = height - fitted
        spread = MAD_TO_SIGMA * float(np.median(np.abs(residual)))
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
