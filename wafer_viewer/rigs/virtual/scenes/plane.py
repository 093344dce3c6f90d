"""Ground plate, tilted by 4 mrad along x and 1.5 mrad along y: the simplest sample."""

from __future__ import annotations

import numpy as np

from wafer_viewer.numerics.jit import fast_kernel, fast_part
from wafer_viewer.rigs.virtual.scenes.drawing import Points, SceneSheets, grain

TILT_X, TILT_Y = 4e-3, 1.5e-3

# Salts, as numpy integers: numba would compile the noise anew for every literal one.
GRAIN, MARKS = np.arange(31, 33)


@fast_kernel
def fill(x_um: Points, y_um: Points, footprint_um: float, out: SceneSheets) -> None:
    """Fill the sheets at the given points; the surface is on A, and B equals A."""
    for r in range(x_um.shape[0]):
        for c in range(x_um.shape[1]):
            x, y = x_um[r, c], y_um[r, c]
            out.height_a[r, c] = out.height_b[r, c] = TILT_X * x + TILT_Y * y
            out.radiance_a[r, c] = out.radiance_b[r, c] = ground_metal(x, y)
            out.cover[r, c] = 1.0


@fast_part
def ground_metal(x: float, y: float) -> float:
    """Return the radiance of a ground surface: grain and marks along x."""
    return 0.40 * (1.0 + 0.10 * grain(x / 1.6, y / 1.6, GRAIN) + 0.05 * grain(x / 45.0, y / 1.3, MARKS))
