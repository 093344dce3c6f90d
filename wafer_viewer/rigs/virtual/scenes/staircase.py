"""Staircase of ground treads, 180 um deep with a rise of 20 um, climbing towards +x."""

from __future__ import annotations

import math

import numpy as np

from wafer_viewer.numerics.jit import fast_kernel, fast_part
from wafer_viewer.rigs.virtual.scenes.drawing import Points, SceneSheets, bars, grain

TREAD_UM, RISE_UM = 180.0, 20.0

# Salts, as numpy integers: numba would compile the noise anew for every literal one.
GRAIN, MARKS = np.arange(41, 43)


@fast_kernel
def fill(x_um: Points, y_um: Points, footprint_um: float, out: SceneSheets) -> None:
    """Fill the two sheets at the given points: even treads on A, odd ones on B.

    Neighbouring treads are thus on different sheets, and each sheet continues level past its own treads.
    """
    for r in range(x_um.shape[0]):
        for c in range(x_um.shape[1]):
            x, y = x_um[r, c], y_um[r, c]
            here = math.floor(x / TREAD_UM)
            nearest = here + 1 if x - here * TREAD_UM > TREAD_UM / 2 else here - 1
            even, odd = (here, nearest) if here % 2 == 0 else (nearest, here)
            out.cover[r, c] = bars(x, 2 * TREAD_UM, 0.5, footprint_um)
            out.height_a[r, c], out.height_b[r, c] = even * RISE_UM, odd * RISE_UM
            ground = ground_metal(x, y)
            out.radiance_a[r, c], out.radiance_b[r, c] = ground * tone(even), ground * tone(odd)


@fast_part
def ground_metal(x: float, y: float) -> float:
    """Return the radiance of a ground surface: grain and marks along x."""
    return 0.40 * (1.0 + 0.10 * grain(x / 1.6, y / 1.6, GRAIN) + 0.05 * grain(x / 40.0, y / 1.3, MARKS))


@fast_part
def tone(tread: int) -> float:
    """Return a brightness factor that distinguishes neighbouring treads."""
    return 0.9 + 0.1 * (tread % 3)
