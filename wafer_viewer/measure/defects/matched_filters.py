"""Matched filters for image defects, by size, against the measured grain and local contrast. Pure.

Grain is coarse: its noise is correlated over some pixels, so that a sharp outline stands out much more clearly than a
mean over pixels shows. A filter weights every spatial frequency by the spectrum of a defect of its size divided by that
of the noise (Turin, An introduction to matched filters, 1960). The noise is measured for each surface.

Local contrast is meaningful on a plain surface only: on a pattern every edge contrasts with its neighbourhood.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.defects.golden_die import SPREAD, robust_sigma
from wafer_viewer.measure.dies.die_cells import Plane
from wafer_viewer.numerics.filters.gaussian import FINE_PX, binned, coarseness, smooth

SHARP, SOFT = "sharp", "soft"
"""Score layers: discs with an outline as sharp as the optics resolve, and Gaussian profiles."""
DIAMETERS_PX = (4.0, 6.0, 9.0, 14.0)
"""Disc diameters; wider defects are detected by their outline."""
BLUR_PX = 0.9
"""Standard deviation of the Gaussian blur of an outline by optics and interpolation."""
FLOOR = 0.05
"""Lower limit of the noise power at any frequency, relative to the noise of a pixel."""
BINS = 96
"""Number of frequency bins of a spectrum."""
HIGHEST = 0.7072
"""Highest frequency of a spectrum, in cycles per pixel: that of a diagonal."""
PADDED_PX = 24
"""Width of the mirrored border of a cell under the filters, px."""
Spectrum = NDArray[np.float32]
"""Noise power by spatial frequency, [BINS]; 1 everywhere for uncorrelated noise of deviation 1."""


def spectrum_of(quotients: Iterable[Plane]) -> Spectrum:
    """Return the median spectrum of some cells, which few defects do not affect; uncorrelated if none is known."""
    each = [power for plane in quotients if (power := _power(plane)) is not None]
    return np.median(each, axis=0).astype(np.float32) if each else np.ones(BINS, np.float32)


def matched(quotient: Plane, spectrum: Spectrum, scales_px: Iterable[float]) -> dict[tuple[str, float], Plane]:
    """Return the filter responses by layer and size, NaN where unknown.

    Wide filters are sampled on squares of `coarseness` pixels. scales_px: deviations of the Gaussian filters; those
    below FINE_PX are covered by the discs.
    """
    finite = np.isfinite(quotient)
    if not finite.any():
        return {}
    padded = _padded(quotient, finite)
    inner = tuple(slice(PADDED_PX, PADDED_PX + n) for n in quotient.shape)
    parts = np.fft.rfft2(padded)
    soft = tuple(scale for scale in scales_px if scale >= FINE_PX)
    filters = _filters((padded.shape[0], padded.shape[1]), spectrum.tobytes(), soft)
    answers = ((key, np.fft.irfft2(parts * weights, padded.shape)[inner]) for key, weights in filters.items())
    return {key: _where_valid(answer.astype(np.float32), finite, side_of(*key)) for key, answer in answers}


def side_of(layer: str, scale_px: float) -> int:
    """Return the side of the pixel squares on which a layer is filtered at a scale."""
    return 1 if layer == SHARP else coarseness(scale_px)


def _power(plane: Plane) -> NDArray[np.float64] | None:
    """Return the mean power by frequency under a Hann window; None where too little is known."""
    finite = np.isfinite(plane)
    window = (np.hanning(plane.shape[0])[:, None] * np.hanning(plane.shape[1])[None, :]).astype(np.float32) * finite
    weight = float(np.sum(window**2, dtype=np.float64))
    if finite.mean() < 0.5 or weight == 0:
        return None
    power = np.abs(np.fft.rfft2(np.where(finite, plane, np.float32(0)) * window)) ** 2 / weight
    bins = np.minimum((_frequency(plane.shape) * (BINS / HIGHEST)).astype(np.int32), BINS - 1).ravel()
    count = np.bincount(bins, minlength=BINS)
    filled = np.flatnonzero(count)
    mean = np.bincount(bins, power.ravel(), BINS)[filled] / count[filled]
    return np.exp(np.interp(np.arange(BINS), filled, np.log(np.maximum(mean, 1e-12))))


@lru_cache(maxsize=4)
def _filters(shape: tuple[int, int], spectrum: bytes, soft: tuple[float, ...]) -> dict[tuple[str, float], Plane]:
    """Return filters by layer and size: defect spectrum over noise spectrum, with zero mean."""
    from scipy.special import j1

    frequency = _frequency(shape)
    middles = (np.arange(BINS) + 0.5) * (HIGHEST / BINS)
    noise = np.interp(frequency, middles, np.frombuffer(spectrum, np.float32)) + FLOOR
    found: dict[tuple[str, float], NDArray[np.float64]] = {}
    for diameter in DIAMETERS_PX:
        turn = np.maximum(np.pi * diameter * frequency, 1e-6)
        found[SHARP, diameter] = 2 * j1(turn) / turn * _gaussian(frequency, BLUR_PX) / noise
    for scale in soft:
        found[SOFT, scale] = _gaussian(frequency, scale) / noise
    for weights in found.values():
        weights[0, 0] = 0
    return {key: weights.astype(np.float32) for key, weights in found.items()}


def _gaussian(frequency: NDArray[np.float64], sigma_px: float) -> NDArray[np.float64]:
    return np.exp(-2 * (np.pi * sigma_px * frequency) ** 2)


def _frequency(shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return the frequencies of `rfft2` coefficients, in cycles per pixel."""
    return np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :])


def _padded(plane: Plane, finite: NDArray[np.bool_]) -> Plane:
    """Pad by mirroring to a fast transform size; unknown pixels take the nearest known value."""
    from scipy.fft import next_fast_len
    from scipy.ndimage import distance_transform_edt

    if not finite.all():
        nearest = np.asarray(distance_transform_edt(~finite, return_distances=False, return_indices=True))
        plane = plane[nearest[0], nearest[1]]
    more = [next_fast_len(n + 2 * PADDED_PX, real=True) - n - PADDED_PX for n in plane.shape]
    return np.pad(plane, [(PADDED_PX, after) for after in more], "symmetric")


def _where_valid(answer: Plane, finite: NDArray[np.bool_], side: int) -> Plane:
    if side == 1:
        return np.where(finite, answer, np.float32(np.nan))
    share = binned(finite.astype(np.float32), side)
    return np.where(share >= side**2 / 2, binned(answer, side), np.float32(np.nan))


@dataclass(frozen=True, slots=True)
class PlainnessParameters:
    """Limits of a plain image, which is compared with its local mean.

    Parameters
    ----------
    around_px : float, px
        Standard deviation of the Gaussian for the local mean.
    far : float
        Outlier limit in deviations of the local contrast.
    few : float
        Largest outlier fraction of a plain surface, defects aside.
    wide_px : float, px
        Standard deviation of the Gaussian over which noise and grain average out.
    even : float
        Largest ratio of so smoothed to single-pixel scatter of a plain surface.
    """

    around_px: float = 20.0
    far: float = 6.0
    few: float = 0.003
    wide_px: float = 8.0
    even: float = 0.3


PLAIN = PlainnessParameters()
LOOKED_AT = "The picture was compared with what is around each place: wide and faint stains do not show there."
LEFT_OUT = "The picture shows a pattern, or nothing, and was not looked at: only the heights were."


def subtract_local_mean(picture: Plane) -> Plane:
    """Subtract the local mean of the known pixels; NaN where unknown."""
    finite = np.isfinite(picture)
    total, weight = (
        smooth(np.where(finite, picture, np.float32(0)), PLAIN.around_px),
        smooth(finite.astype(np.float32), PLAIN.around_px),
    )
    return np.where(finite, picture - total / np.maximum(weight, np.float32(1e-6)), np.float32(np.nan)).astype(
        np.float32
    )


def contrast_of(picture: Plane) -> tuple[float, float]:
    """Return the scatter of the local contrast and a pattern measure: over 1 for a pattern, NaN for an empty image.

    Noise and grain average out over `PLAIN.wide_px`, and few pixels of a plain surface are outliers; a pattern violates
    either.
    """
    contrast = subtract_local_mean(picture)
    sigma = robust_sigma(contrast)
    if not sigma > 0:
        return float("nan"), float("nan")
    finite = np.isfinite(contrast)
    wide = robust_sigma(smooth(np.where(finite, contrast, np.float32(0)), PLAIN.wide_px)) / sigma
    far = float((np.abs(contrast[finite]) > PLAIN.far * max(sigma, SPREAD.least_contrast)).mean())
    return sigma, max(wide / PLAIN.even, far / PLAIN.few)


def is_plain(patterned: NDArray[np.float64]) -> bool:
    """Return whether a surface is plain, by the pattern measures of some cells; up to half may have defects."""
    return bool(np.isfinite(patterned).any() and np.nanmedian(patterned) <= 1)
