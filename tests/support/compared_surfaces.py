"""Surfaces of one wafer, taken twice: laid down again with a shift, a turn and a tilt, and with something changed."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from tests.support.surfaces import height_map
from tests.truth.endless_wafer import Lattice, Wafer, look
from wafer_viewer.model.surface.height_map import HeightMap, Origin

X0_UM, Y0_UM, SHAPE = 100.0, 700.0, (480, 640)


def taken(
    x_um: float = 0.0,
    y_um: float = 0.0,
    turn_mrad: float = 0.0,
    *,
    shape: tuple[int, int] = SHAPE,
    pixel_um: float = 1.0,
    wafer: Wafer = Wafer(),
    seed: int = 0,
    x0_um: float = X0_UM,
    y0_um: float = Y0_UM,
) -> HeightMap:
    """A surface whose content lies shifted by (-x, -y) and turned by -turn about its first pixel.

    Shifting it by (x, y) and turning it by the turn about its first pixel lays it on that of `taken()`.
    """
    cos, sin = math.cos(turn_mrad * 1e-3) * pixel_um, math.sin(turn_mrad * 1e-3) * pixel_um
    z, grey, sure = look(wafer, Lattice(shape, (x0_um + x_um, y0_um + y_um), (cos, sin), (sin, -cos)))
    rng = np.random.default_rng(seed)
    z = (z + rng.normal(0, 0.05, shape)).astype(np.float32)
    seen = np.clip(grey + rng.normal(0, 2, shape), 0, 255).astype(np.uint8)
    return height_map(z, pixel_um, x0_um, y0_um, grey=seen, confidence=sure, z_step_um=2.0)


def with_heights(surface: HeightMap, z_um: np.ndarray) -> HeightMap:
    z = z_um.astype(np.float32)
    origin = np.where(np.isfinite(z), surface.origin, np.uint8(Origin.NO_TEXTURE))
    return dataclasses.replace(surface, z_um=z, z_raw_um=z.copy(), origin=origin)


def tilted(surface: HeightMap, z_um: float, tilt_x_mrad: float = 0.0, tilt_y_mrad: float = 0.0) -> HeightMap:
    """Higher by z at the first pixel, and more to the right and upward."""
    x, y = (surface.x_um - X0_UM)[None, :], (surface.y_um - Y0_UM)[:, None]
    return with_heights(surface, surface.z_um + z_um + 1e-3 * (tilt_x_mrad * x + tilt_y_mrad * y))


def with_bump(surface: HeightMap, rows: slice, cols: slice, height_um: float) -> HeightMap:
    z = surface.z_um.copy()
    z[rows, cols] += height_um
    return with_heights(surface, z)


def a_texture(seed: int, contrast: float = 20.0) -> HeightMap:
    """A sample that has nothing in common with one of another seed."""
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(seed)
    grey = gaussian_filter(rng.normal(size=SHAPE), 2.5)
    grey = 110 + contrast * grey / grey.std() + rng.normal(0, 2, SHAPE)
    flat = with_heights(taken(), rng.normal(0, 0.05, SHAPE))
    return dataclasses.replace(flat, all_in_focus=np.clip(grey, 0, 255).astype(np.uint8))
