"""Which pixels have a height that can be believed, and why the others have none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface import Origin
from wafer_viewer.reconstruct.noise import NoiseScores
from wafer_viewer.reconstruct.peak import Peaks, confidence_of, lead_of

LEAD_OVER_NOISE = 2.0
"""A peak must lead its rival by twice what noise reaches: noise that varies along z reaches more than steady noise."""

CLIPPED_FRAMES_FRACTION = 0.02


@dataclass(frozen=True, slots=True)
class Gate:
    """What a peak must show to count as a measurement; scores in powers of two of the focus measure."""

    min_confidence: float
    min_fall: float
    min_contrast: float
    clipped_fraction: float
    window: int


def auto_min_confidence(noise: NoiseScores) -> float:
    """The confidence that tells a peak from noise, for this number of frames and this window."""
    return confidence_of(LEAD_OVER_NOISE * noise.lead)


def gate_of(noise: NoiseScores, min_confidence: float, clipped_fraction: float, window: int) -> Gate:
    """The gate for a recipe's confidence; without a least confidence only clipping and the ends of the range count."""
    wanted = min_confidence > 0
    return Gate(
        min_confidence=min_confidence,
        min_fall=noise.fall if wanted else -np.inf,
        min_contrast=noise.contrast if wanted else -np.inf,
        clipped_fraction=clipped_fraction,
        window=window,
    )


def origins(peaks: Peaks, gate: Gate, n_frames: int) -> NDArray[np.uint8]:
    """The code of `Origin` of each pixel, uint8 [row, col]; where several reasons hold, the one that explains most."""
    origin = np.full(peaks.z_um.shape, Origin.MEASURED, np.uint8)
    weak = (peaks.lead <= lead_of(gate.min_confidence)) | (peaks.fall <= gate.min_fall)
    if gate.min_confidence > 0:
        origin[weak] = Origin.AMBIGUOUS
    origin[peaks.at_end] = Origin.END_OF_RANGE
    origin[peaks.contrast <= gate.min_contrast] = Origin.NO_TEXTURE
    origin[_clipped(peaks, gate, n_frames)] = Origin.CLIPPED
    return origin


def _clipped(peaks: Peaks, gate: Gate, n_frames: int) -> NDArray[np.bool_]:
    """Where more of the window than the recipe allows was too bright, in more frames than a lucky noise peak is."""
    too_bright = peaks.clipped >= max(1, round(CLIPPED_FRAMES_FRACTION * n_frames))
    if not too_bright.any():
        return too_bright
    from scipy.ndimage import uniform_filter

    return uniform_filter(too_bright.astype(np.float32), gate.window, mode="nearest") > gate.clipped_fraction
