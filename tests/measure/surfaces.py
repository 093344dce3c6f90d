"""Surfaces made for the tests of this room."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from wafer_viewer.model.calibration import Calibration
from wafer_viewer.model.surface import HeightMap, Origin, Provenance

PIXEL_UM = 0.5
CALIBRATION = Calibration(
    pixel_um=PIXEL_UM, u_pixel_um=0.0001, u_z_scale=5e-4, made="2026-01-01", due="2999-01-01", against="test"
)


def height_map(z_um: np.ndarray, calibration: Calibration | None = CALIBRATION, z_step_um: float = 0.0) -> HeightMap:
    z = z_um.astype(np.float32)
    origin = np.where(np.isfinite(z), Origin.MEASURED, Origin.NO_TEXTURE).astype(np.uint8)
    return HeightMap(
        z_um=z,
        z_raw_um=z,
        confidence=np.ones_like(z),
        all_in_focus=np.zeros(z.shape, np.uint8),
        origin=origin,
        pixel_um=PIXEL_UM,
        x0_um=-(z.shape[1] - 1) / 2 * PIXEL_UM,
        y0_um=(z.shape[0] - 1) / 2 * PIXEL_UM,
        provenance=Provenance(calibration=calibration, z_step_um=z_step_um),
    )


def step_surface(
    step_um: float, *, rows=200, cols=400, tilt=0.0, noise_um=0.0, correlation_px=0.0, seed=0, **kind
) -> HeightMap:
    """The left half stands step_um over the right one; all of it tilted along x."""
    rng = np.random.default_rng(seed)
    x = (np.arange(cols) - (cols - 1) / 2) * PIXEL_UM
    noise = rng.standard_normal((rows, cols))
    if correlation_px:
        noise = gaussian_filter(noise, correlation_px)
        noise /= noise.std()
    return height_map(np.where(x < 0, step_um, 0.0) + tilt * x + noise_um * noise, **kind)
