"""Peak scores on pure noise, used as thresholds of the gates.

A gate that requires more than noise reaches in 1 % of the pixels has a known false positive rate, for any number of
frames, window and measure. The scores are ratios, so they do not depend on the strength of the noise, except for a
measure that uses the camera noise: it is given the noise of the simulation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.reconstruct.focus.focus_volume import StackSource
from wafer_viewer.reconstruct.focus.log_laplacian import log_margin_px
from wafer_viewer.reconstruct.focus.peak import Peaks
from wafer_viewer.reconstruct.focus.peak_search import Search, ThreadScratch, search_block
from wafer_viewer.reconstruct.preprocess.camera_noise import CameraNoise

_SIDE_PX = 224
"""Noise peaks are correlated over the window, so a large patch is needed to estimate the 99th percentile."""

_MARGIN_PX = log_margin_px(25)
_DEVIATION_COUNTS = 12.0
_CAMERA = CameraNoise(gain_counts=1e-2, floor_counts2=_DEVIATION_COUNTS**2)
_PERCENTILE = 99.0
_SEED = 20240229


@dataclass(frozen=True, slots=True)
class NoiseScores:
    """99th percentiles of the peak scores on pure noise, in powers of two."""

    lead: float
    fall: float
    contrast: float


def noise_scores(search: Search, n_frames: int) -> NoiseScores:
    """Return the scores on a fixed patch of white noise of `n_frames` frames."""
    return _noise_scores(replace(search, camera=_CAMERA), n_frames)


@lru_cache(maxsize=64)
def _noise_scores(search: Search, n_frames: int) -> NoiseScores:
    grey, shape = _noise(n_frames), (_SIDE_PX, _SIDE_PX)
    source = StackSource.of(grey, np.arange(n_frames), _MARGIN_PX, _MARGIN_PX, 256)
    peaks = Peaks.empty(shape, grey.dtype)
    bench = ThreadScratch.make(n_frames, shape, search, grey.dtype)
    search_block(source, np.arange(n_frames, dtype=np.float64), search, bench, peaks)
    inside = ~peaks.at_end
    lead, fall, contrast = (
        float(np.percentile(score[inside] if inside.any() else score, _PERCENTILE))
        for score in (peaks.lead, peaks.fall, peaks.contrast)
    )
    return NoiseScores(lead, fall, contrast)


@lru_cache(maxsize=1)
def _noise(n_frames: int) -> NDArray[np.uint8]:
    """Return white noise [k, row, col] with a margin for the largest window."""
    side = _SIDE_PX + 2 * _MARGIN_PX
    noise = np.random.default_rng(_SEED).standard_normal((n_frames, side, side), dtype=np.float32)
    noise *= np.float32(_DEVIATION_COUNTS)
    noise += np.float32(128.5)
    return np.clip(noise, 0, 255, out=noise).astype(np.uint8)
