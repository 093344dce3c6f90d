"""Turned cone, 120 um high with a slope of 0.30, on a flat plate; its tip is at stage (0, 0)."""

from __future__ import annotations

import math

import numpy as np

from wafer_viewer.numerics.jit import fast_kernel, fast_part
from wafer_viewer.rigs.virtual.scenes.drawing import Points, SceneSheets, grain

HEIGHT_UM, SLOPE = 120.0, 0.30

# Salts, as numpy integers: numba would compile the noise anew for every literal one.
GRAIN, RINGS = np.arange(51, 53)


@fast_kernel
def fill(x_um: Points, y_um: Points, footprint_um: float, out: SceneSheets) -> None:
    """Fill the sheets at the given points; the surface is on A, and B equals A."""
    for r in range(x_um.shape[0]):
        for c in range(x_um.shape[1]):
            x, y = x_um[r, c], y_um[r, c]
            height = max(0.0, HEIGHT_UM - SLOPE * math.sqrt(x * x + y * y))
            out.height_a[r, c] = out.height_b[r, c] = height
            out.radiance_a[r, c] = out.radiance_b[r, c] = turned_metal(x, y)
            out.cover[r, c] = 1.0


@fast_part
def turned_metal(x: float, y: float) -> float:
    """Return the radiance of a turned surface: grain and rings."""
    out, around = math.sqrt(x * x + y * y), math.atan2(y, x)
    return 0.40 * (1.0 + 0.10 * grain(x / 1.6, y / 1.6, GRAIN) + 0.05 * grain(out / 1.4, around * 40.0, RINGS))
