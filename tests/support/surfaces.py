"""Surfaces with known answers that the tests of measurements share."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.surface.height_map import HeightMap, Origin, Provenance
from wafer_viewer.model.surface.recipe import Recipe

PIXEL_UM = 0.5
STEP_UM = 399.88


def calibration(u_z_scale=5e-4) -> Calibration:
    return Calibration(
        pixel_um=PIXEL_UM, u_pixel_um=0.0, u_z_scale=u_z_scale, made="2026-01-01", due="2027-01-01", against="blocks"
    )


def coordinates(rows, cols):
    """Stage x [col] and y [row] of a map centred on (0, 0)."""
    return (np.arange(cols) - (cols - 1) / 2) * PIXEL_UM, ((rows - 1) / 2 - np.arange(rows)) * PIXEL_UM


def height_map(
    z_um,
    pixel_um=PIXEL_UM,
    x0_um=0.0,
    y0_um=0.0,
    *,
    z_raw_um=None,
    grey: Any = 0,
    confidence: Any = 1.0,
    origin=None,
    **provenance,
) -> HeightMap:
    """A map of heights, NaN without texture; grey and confidence are arrays, or one value for all pixels."""
    z = np.asarray(z_um, np.float32)
    raw = z if z_raw_um is None else np.asarray(z_raw_um, np.float32)
    sure, picture = (
        layer if isinstance(layer, np.ndarray) else np.full(z.shape, layer, kind)
        for layer, kind in ((confidence, np.float32), (grey, np.uint8))
    )
    if origin is None:
        origin = np.where(np.isfinite(z), Origin.MEASURED, Origin.NO_TEXTURE).astype(np.uint8)
    return HeightMap(z, raw, sure, picture, origin, pixel_um, x0_um, y0_um, Provenance(**provenance))


def surface_of(z_um, z_raw_um=None, origin=None, **provenance) -> HeightMap:
    """A map centred on (0, 0)."""
    x_um, y_um = coordinates(*np.shape(z_um))
    place = PIXEL_UM, float(x_um[0]), float(y_um[0])
    return height_map(z_um, *place, z_raw_um=z_raw_um, origin=origin, **provenance)


def gauge_blocks(
    seed, noise_um=1.0, correlation_px=8.0, tilt=3e-4, level=5e-4, u_z_scale=5e-4, scale_error=0.0, **about
) -> HeightMap:
    """Two faces STEP_UM apart at x = 0, the lower tilted against the upper; noise correlated over some pixels,
    1 in 1000 points off by 50 um, and the whole surface not level."""
    rng = np.random.default_rng(seed)
    x_um, y_um = (a for a in np.meshgrid(*coordinates(240, 640)))
    z = np.where(x_um < 0, STEP_UM, tilt * x_um + 0.4 * tilt * y_um) + level * x_um - 0.6 * level * y_um
    noise = rng.normal(size=z.shape)
    if correlation_px:
        noise = gaussian_filter(noise, correlation_px / 2)
    z = z * (1 + scale_error) + noise_um * noise / noise.std()
    outliers = rng.random(z.shape) < 1e-3
    z[outliers] += rng.choice([-50.0, 50.0], np.count_nonzero(outliers))
    about.setdefault("calibration", calibration(u_z_scale))
    return surface_of(z, z_step_um=4.0, recipe=Recipe(window=9), **about)


def noise_of(seed, shape, noise_um, correlation_px=0.0):
    """Normal noise, correlated over some pixels as that of a focus window is."""
    noise = np.random.default_rng(seed).normal(size=shape)
    if correlation_px:
        noise = gaussian_filter(noise, correlation_px / 2)
    return noise_um * noise / noise.std()
