"""Flat field and dark level of the camera from frames of a flat out of focus, at two exposures and several places.

With the counts B at the exposure t and D at the shortest exposure s, a linear camera has the dark level

    d = (t D - s B) / (t - s)

which are its counts at an exposure of zero, so that nobody has to cover the light. The sensitivity is B - d over its
mean in the image. Texture that remains out of focus differs from place to place, so the mean over places is without it
and their scatter is the uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.calibrate.image_geometry import Estimate
from wafer_viewer.model.acquisition.calibration import FlatField
from wafer_viewer.model.errors import RigError
from wafer_viewer.numerics.normal_statistics import u_of_mean

BLOCKS = 32
"""Blocks along the longer side of the image: vignetting of 10 % is linear within one to 0.02 %."""
SHADING_BLOCKS = 3
"""Blocks along each axis over which the sensitivity is averaged before its range is taken: a tenth of the image."""
LEAST_PLACES = 4
"""Fewest places for a flat field with an uncertainty."""
LEAST_LIGHT = 0.5
"""Smallest part of the counts that the longer exposure must have more than the shortest."""
U_ROUNDING_COUNTS = 0.01
"""Standard uncertainty of a mean of rounded counts with noise of 0.4 counts or more, which every lit pixel has: the
bias is at most exp(-2 pi^2 0.4^2) / pi = 0.014 counts."""
Blocks = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FlatFrames:
    """Exposures in us of the frames of a flat: of the bright ones, and the shortest of the camera."""

    bright_us: float
    short_us: float


@dataclass(frozen=True, slots=True)
class FlatFieldEstimate:
    """Flat field with its shading, the range of the sensitivity in the image, and the mean dark level in counts."""

    flat_field: FlatField
    shading: Estimate
    dark_counts: Estimate


def block_means(image: NDArray[np.floating]) -> Blocks:
    """Return the means of an image over equal blocks, `BLOCKS` along its longer side, [row][col]."""
    side = max(1.0, max(image.shape) / BLOCKS)
    edges = [np.linspace(0, n, max(1, round(n / side)) + 1).round().astype(int) for n in image.shape]
    sums = np.add.reduceat(np.add.reduceat(image, edges[0][:-1], axis=0, dtype=np.float64), edges[1][:-1], axis=1)
    return sums / np.outer(np.diff(edges[0]), np.diff(edges[1]))


def flat_field(
    shape: tuple[int, int],
    bright: Sequence[Blocks],
    short: Sequence[Blocks],
    exposures: FlatFrames,
    dark_counts: float | None = None,
) -> FlatFieldEstimate:
    """Return the flat field and the dark level from block means at several places.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of the images.
    bright, short : sequence of float64 [row, col]
        Block means in counts at the two exposures, of the same places; at least four.
    exposures : FlatFrames
        The two exposures in us.
    dark_counts : float, optional
        Dark level in counts as measured with the light covered. Default: by the two exposures.

    Returns
    -------
    FlatFieldEstimate
        Maps with standard uncertainties (k = 1) from the scatter of the places, widened by Student's t.

    Raises
    ------
    RigError
        With too few places, or where the light does not follow the exposure.

    Notes
    -----
    The dark level by two exposures assumes a camera whose exposure is as long as it says. A strobe that is shorter than
    both exposures gives them the same light, and is refused.

    References
    ----------
    .. [1] EMVA Standard 1288, Standard for Characterization of Image Sensors and Cameras, Release 4.0 (2021).
    """
    if len(bright) < LEAST_PLACES:
        raise RigError(f"The flat field takes {LEAST_PLACES} places; there are {len(bright)}.")
    lit, dim = np.stack(bright), np.stack(short)
    if dark_counts is None:
        _require_light_by_exposure(lit, dim, exposures)
        span_us = exposures.bright_us - exposures.short_us
        darks = (exposures.bright_us * dim - exposures.short_us * lit) / span_us
    else:
        darks = np.full_like(lit, dark_counts)
    dark, u_dark = darks.mean(axis=0), np.hypot(u_of_mean(darks), U_ROUNDING_COUNTS)
    light = lit - dark
    relative = light / light.mean(axis=(1, 2), keepdims=True)
    sensitivity = relative.mean(axis=0)
    u = np.hypot(u_of_mean(relative), u_dark / light.mean())
    level = darks.mean(axis=(1, 2))
    return FlatFieldEstimate(
        FlatField(
            rows=shape[0],
            cols=shape[1],
            sensitivity=_table(sensitivity),
            u_sensitivity=_table(u),
            dark_counts=_table(dark),
            u_dark_counts=_table(u_dark),
        ),
        shading=_shading(relative),
        dark_counts=Estimate(float(level.mean()), math.hypot(float(u_of_mean(level)), U_ROUNDING_COUNTS)),
    )


def _shading(relative: Blocks) -> Estimate:
    """Return the range of the sensitivity [place, row, col], averaged over neighbouring blocks.

    The highest of many blocks with some noise is too high: averages have less of it.
    """
    from scipy.ndimage import uniform_filter1d

    smooth = relative
    for axis in (1, 2):
        smooth = uniform_filter1d(smooth, SHADING_BLOCKS, axis=axis, mode="nearest")
    mean, u = smooth.mean(axis=0), u_of_mean(smooth)
    high, low = (np.unravel_index(int(at), u.shape) for at in (mean.argmax(), mean.argmin()))
    return Estimate(float(mean[high] - mean[low]), float(math.hypot(u[high], u[low])))


def _require_light_by_exposure(lit: Blocks, dim: Blocks, exposures: FlatFrames) -> None:
    """Raise RigError when the counts hardly rise with the exposure."""
    rise = 1 - float(dim.mean()) / float(lit.mean())
    if rise < LEAST_LIGHT * (1 - exposures.short_us / exposures.bright_us):
        raise RigError(
            f"Of the counts at {exposures.bright_us:.0f} us only {rise:.0%} are more than those at "
            f"{exposures.short_us:.0f} us: the light does not follow the exposure, as with a strobe. Cover the light, "
            "read the mean counts, and give them as the dark level."
        )


def _table(blocks: Blocks) -> tuple[tuple[float, ...], ...]:
    """Return blocks as numbers of seven digits."""
    return tuple(tuple(float(f"{value:.7g}") for value in row) for row in blocks)
