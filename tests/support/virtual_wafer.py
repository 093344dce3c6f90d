"""The true surface of the virtual rig's wafer, with noise and holes, without a scan."""

from __future__ import annotations

import numpy as np

from tests.support.surfaces import height_map
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.rigs.virtual.scenes.catalogue import SCENES, SceneWindow
from wafer_viewer.rigs.virtual.scenes.wafer import RADIUS_UM


def virtual_wafer(pixel_um: float, noise_um: float = 0.3, unmeasured_fraction: float = 0.02) -> HeightMap:
    half_um, rng = RADIUS_UM + 50, np.random.default_rng(3)
    side = round(2 * half_um / pixel_um)
    window = SceneWindow(-half_um + pixel_um / 2, half_um - pixel_um / 2, pixel_um, side, side)
    sheets = SCENES["wafer"].raster(window)
    z = sheets.surface_um().astype(np.float32)
    z += noise_um * rng.standard_normal(z.shape).astype(np.float32)
    z[rng.random(z.shape) < unmeasured_fraction] = np.nan
    grey = sheets.radiance_a * sheets.cover + sheets.radiance_b * (1 - sheets.cover)
    seen = np.clip(250 * grey, 0, 255).astype(np.uint8)
    return height_map(z, pixel_um, window.x0_um, window.y0_um, grey=seen, simulated=True)
