"""Matched filters for what differs in the picture: each size of defect against the grain that is seen there. Pure.

Grain is coarse: what it adds is alike over some pixels, so that a sharp outline stands out of it much more clearly than
a mean over pixels shows. A filter weighs every spatial frequency by what a defect of its size has there over what noise
has (Turin, An introduction to matched filters, 1960). The noise is measured, for each surface.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.dies.die_cells import Plane
from wafer_viewer.numerics.filters.binning import binned
from wafer_viewer.numerics.filters.multiscale_gaussian import FINE_PX, coarseness

SHARP, SOFT = "sharp", "soft"
"""Layers of scores: of discs with an outline as sharp as the optics show it, of what fades like a Gaussian."""
DIAMETERS_PX = (4.0, 6.0, 9.0, 14.0)
"""Of the discs; what is wider shows by its outline, wherever that is."""
BLUR_PX = 0.9
"""Deviation of the Gaussian by which optics and interpolation blur an outline."""
FLOOR = 0.05
"""Of the noise of a pixel: no frequency is taken to have less, for none is known so well."""
BINS, HIGHEST = 96, 0.7072
"""Frequencies in cycles a pixel, up to that along a diagonal."""
PADDED_PX = 24
Spectrum = NDArray[np.float32]
"""Power of the noise by spatial frequency, [BINS]; 1 everywhere: noise of deviation 1 that is uncorrelated."""


def spectrum_of(quotients: Iterable[Plane]) -> Spectrum:
    """Of the usual one of some cells, so that few defects are not taken for noise; uncorrelated where there is none."""
    each = [power for plane in quotients if (power := _power(plane)) is not None]
    return np.median(each, axis=0).astype(np.float32) if each else np.ones(BINS, np.float32)


def matched(quotient: Plane, spectrum: Spectrum, scales_px: Iterable[float]) -> dict[tuple[str, float], Plane]:
    """The answers of all filters by layer and size, wide ones on squares of `coarseness` pixels, NaN where unknown.

    scales_px: deviations of the soft ones; too narrow ones are left to the discs.
    """
    known = np.isfinite(quotient)
    if not known.any():
        return {}
    padded = _padded(quotient, known)
    inner = tuple(slice(PADDED_PX, PADDED_PX + n) for n in quotient.shape)
    parts = np.fft.rfft2(padded)
    soft = tuple(scale for scale in scales_px if scale >= FINE_PX)
    filters = _filters((padded.shape[0], padded.shape[1]), spectrum.tobytes(), soft)
    answers = ((key, np.fft.irfft2(parts * weights, padded.shape)[inner]) for key, weights in filters.items())
    return {key: _where_known(answer.astype(np.float32), known, side_of(*key)) for key, answer in answers}


def side_of(layer: str, scale_px: float) -> int:
    """The side of the squares of pixels on which a layer is filtered at a scale."""
    return 1 if layer == SHARP else coarseness(scale_px)


def _power(plane: Plane) -> NDArray[np.float64] | None:
    """Mean power by frequency under a window that fades to the borders; None where too little is known."""
    known = np.isfinite(plane)
    window = (np.hanning(plane.shape[0])[:, None] * np.hanning(plane.shape[1])[None, :]).astype(np.float32) * known
    weight = float(np.sum(window**2, dtype=np.float64))
    if known.mean() < 0.5 or weight == 0:
        return None
    power = np.abs(np.fft.rfft2(np.where(known, plane, np.float32(0)) * window)) ** 2 / weight
    at = np.minimum((_frequency(plane.shape) * (BINS / HIGHEST)).astype(np.int32), BINS - 1).ravel()
    count = np.bincount(at, minlength=BINS)
    filled = np.flatnonzero(count)
    mean = np.bincount(at, power.ravel(), BINS)[filled] / count[filled]
    return np.exp(np.interp(np.arange(BINS), filled, np.log(np.maximum(mean, 1e-12))))


@lru_cache(maxsize=4)
def _filters(shape: tuple[int, int], spectrum: bytes, soft: tuple[float, ...]) -> dict[tuple[str, float], Plane]:
    """By layer and size: the defect's own spectrum over the noise's, without a mean."""
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
    """Cycles a pixel of what `rfft2` gives."""
    return np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :])


def _padded(plane: Plane, known: NDArray[np.bool_]) -> Plane:
    """With its border mirrored, to a size that is quick to transform; unknown pixels are as the nearest known one."""
    from scipy.fft import next_fast_len
    from scipy.ndimage import distance_transform_edt

    if not known.all():
        nearest = np.asarray(distance_transform_edt(~known, return_distances=False, return_indices=True))
        plane = plane[nearest[0], nearest[1]]
    more = [next_fast_len(n + 2 * PADDED_PX, real=True) - n - PADDED_PX for n in plane.shape]
    return np.pad(plane, [(PADDED_PX, after) for after in more], "symmetric")


def _where_known(answer: Plane, known: NDArray[np.bool_], side: int) -> Plane:
    if side == 1:
        return np.where(known, answer, np.float32(np.nan))
    share = binned(known.astype(np.float32), side)
    return np.where(share >= side**2 / 2, binned(answer, side), np.float32(np.nan))
