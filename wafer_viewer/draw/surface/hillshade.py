"""Lighting of a height map: hillshade from the north-west, weak gloss, and occlusion in hollows.

All functions take heights without gaps (`without_gaps`) and a gain that `light_gain` derives from the surface, so that
a lapped block and a bumped die both show their relief, independent of pixel size and exaggeration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Heights = NDArray[np.float32]

_AZIMUTH, _ALTITUDE = np.radians(315.0), np.radians(42.0)
_LIGHT = np.array([np.sin(_AZIMUTH) * np.cos(_ALTITUDE), np.cos(_AZIMUTH) * np.cos(_ALTITUDE), np.sin(_ALTITUDE)])
_UP = np.array([0.0, 0.0, 1.0])
_HALFWAY = (_LIGHT + _UP) / np.linalg.norm(_LIGHT + _UP)
_GLOSS_EXPONENT = 60
_NOISE_PX = 0.9
"""Sigma of the smoothing before differentiation, against glitter from pixel noise."""
_WIDE_PX, _NARROW_PX = 19, 7


@dataclass(frozen=True, slots=True)
class Shading:
    """Per pixel: `lambert` relative to level ground (1), `gloss` in 0 ... 1, `occlusion` in 0 ... 0.5."""

    lambert: Heights
    gloss: Heights
    occlusion: Heights


def without_gaps(z_um: Heights) -> Heights:
    """Return the heights with gaps filled from the nearest measured pixel; zeros if nothing is measured."""
    gaps = ~np.isfinite(z_um)
    if not gaps.any():
        return z_um
    if gaps.all():
        return np.zeros_like(z_um)
    rows, cols = np.asarray(ndimage.distance_transform_edt(gaps, return_distances=False, return_indices=True))
    return z_um[rows, cols]


def light_gain(z_um: Heights, pixel_um: float) -> float:
    """Return the slope gain for lighting, by which a typical slope of the surface is lit as one of 0.4."""
    step_y, step_x = np.abs(np.diff(z_um, axis=0)), np.abs(np.diff(z_um, axis=1))
    slopes = np.concatenate([step_y[np.isfinite(step_y)], step_x[np.isfinite(step_x)]]) / pixel_um
    typical = float(np.sqrt(np.mean(np.minimum(slopes, 2.0) ** 2))) if slopes.size else 0.0
    return float(np.clip(0.4 / max(typical, 1e-6), 0.4, 8.0))


def shade(z_um: Heights, pixel_um: float, gain: float, span_um: float) -> Shading:
    """Return the shading of heights without gaps; `span_um` is the height range that scales the occlusion."""
    smooth = ndimage.gaussian_filter(z_um, _NOISE_PX) * np.float32(gain / pixel_um)
    down, right = np.gradient(smooth)
    flat = 1 / np.sqrt(right * right + down * down + 1)
    lambert = np.clip((_LIGHT[2] - _LIGHT[0] * right + _LIGHT[1] * down) * flat, 0, None) / _LIGHT[2]
    gloss = np.clip((_HALFWAY[2] - _HALFWAY[0] * right + _HALFWAY[1] * down) * flat, 0, 1) ** _GLOSS_EXPONENT
    return Shading(lambert.astype(np.float32), gloss.astype(np.float32), _occlusion(z_um, span_um))


def _occlusion(z_um: Heights, span_um: float) -> Heights:
    """Return the depth of a pixel below its wide and narrow surroundings, relative to the height range."""
    scale = np.float32(1 / max(span_um, 1e-6))
    wide = np.clip((_mean(z_um, _WIDE_PX) - z_um) * scale * 0.66, 0, 0.28)
    narrow = np.clip((_mean(z_um, _NARROW_PX) - z_um) * scale * 0.9, 0, 0.22)
    return (wide + narrow).astype(np.float32)


def _mean(z_um: Heights, width_px: int) -> Heights:
    """Return two passes of a box filter: close to a Gaussian, with a cost independent of its width."""
    once = ndimage.uniform_filter(z_um, width_px, mode="nearest")
    return np.asarray(ndimage.uniform_filter(once, width_px, mode="nearest"), np.float32)
