"""What the scores of a peak are where there is nothing to see: the search run on pure noise.

A gate that asks for more than noise reaches once in a hundred pixels has a known false rate, for whatever number of
frames, window and measure. The scores are ratios, so the strength of the noise does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from wafer_viewer.reconstruct.focus import margin_px
from wafer_viewer.reconstruct.peak import Peaks
from wafer_viewer.reconstruct.search import Bench, Search, search_block
from wafer_viewer.reconstruct.volume import Source

_SIDE_PX = 112
_DEVIATION_COUNTS = 12.0
_PERCENTILE = 99.0
_SEED = 20240229


@dataclass(frozen=True, slots=True)
class NoiseScores:
    """The scores, in powers of two, that 99 % of the pixels of pure noise stay under."""

    lead: float
    fall: float
    contrast: float


@lru_cache(maxsize=64)
def noise_scores(search: Search, n_frames: int) -> NoiseScores:
    """Search a patch of white noise of `n_frames` frames, always the same one."""
    shape, margin = (_SIDE_PX, _SIDE_PX), margin_px(search.window)
    side = _SIDE_PX + 2 * margin
    noise = np.random.default_rng(_SEED).standard_normal((n_frames, side, side), dtype=np.float32)
    grey = np.clip(noise * np.float32(_DEVIATION_COUNTS) + np.float32(128.5), 0, 255).astype(np.uint8)
    source = Source.of(grey, np.arange(n_frames), margin, margin, 256)
    peaks = Peaks.empty(shape, grey.dtype)
    bench = Bench.make(n_frames, shape, search.window, grey.dtype)
    search_block(source, np.arange(n_frames, dtype=np.float64), search, bench, peaks)
    inside = ~peaks.at_end
    lead, fall, contrast = (
        float(np.percentile(score[inside] if inside.any() else score, _PERCENTILE))
        for score in (peaks.lead, peaks.fall, peaks.contrast)
    )
    return NoiseScores(lead, fall, contrast)
