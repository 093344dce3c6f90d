"""A part of a virtual wafer as it is measured, without a scan: noise, and no heights at walls and where it is dark."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter

from tests.support.surfaces import height_map
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.rigs.virtual.scenes.catalogue import SCENES, SceneWindow

WALL_UM, DARK_GREY = 4.0, 18


def virtual_part(
    scene: str, half_um: tuple[float, float] = (470.0, 353.0), pixel_um: float = 0.93458, seed: int = 3
) -> HeightMap:
    """The part of a scene round the middle of its tour."""
    sample, rng = SCENES[scene], np.random.default_rng(seed)
    x_um, y_um = sample.tour_center_um
    rows, cols = round(2 * half_um[1] / pixel_um), round(2 * half_um[0] / pixel_um)
    sheets = sample.raster(SceneWindow(x_um - half_um[0], y_um + half_um[1], pixel_um, rows, cols))
    truth_um, grey = sheets.surface_um(), 250 * sample.gain * sheets.radiance()
    walls = maximum_filter(truth_um, 5) - minimum_filter(truth_um, 5) > WALL_UM
    z = gaussian_filter(truth_um, 1.0) + 0.5 * gaussian_filter(rng.standard_normal(truth_um.shape), 1.2)
    z = np.where(walls | (grey < DARK_GREY) | (rng.random(z.shape) < 0.02), np.nan, z).astype(np.float32)
    seen = np.clip(grey + 3 * rng.standard_normal(z.shape), 0, 255).astype(np.uint8)
    return height_map(z, pixel_um, x_um - half_um[0], y_um + half_um[1], grey=seen, simulated=True)
