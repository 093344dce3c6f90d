"""Two lapped gauge blocks side by side, 399.88 um apart in height, with a dark chamfer gap between them.

The joint is at stage x = 0: the upper block is left of it, the lower one right. The lower block is tilted relative to
the upper by 0.3 mrad.
"""

from __future__ import annotations

import math

import numpy as np

from wafer_viewer.numerics.jit import fast_kernel, fast_part
from wafer_viewer.rigs.virtual.scenes.drawing import Integer, Points, SceneSheets, grain, inside

STEP_UM = 399.88
GAP_UM, CHAMFER_UM = 70.0, 45.0
TILT_X, TILT_Y = 3e-4, 1.2e-4
GAP_DEPTH_UM = 60.0
LAPPED_UPPER, LAPPED_LOWER, CHAMFER, GAP = 0.42, 0.40, 0.028, 0.008  # radiances

# Salts, as numpy integers: numba would compile the noise anew for every literal one.
EDGE, UPPER_LAPPING, LOWER_LAPPING = np.arange(61, 82, 10)  # lapping takes four


@fast_kernel
def fill(x_um: Points, y_um: Points, footprint_um: float, out: SceneSheets) -> None:
    """Fill the two sheets at the given points: upper block (A), lower block and gap (B)."""
    for r in range(x_um.shape[0]):
        for c in range(x_um.shape[1]):
            x, y = x_um[r, c], y_um[r, c]
            ragged = 0.8 * grain(y / 7.0, 0.5, EDGE)
            out.cover[r, c] = inside(ragged - x - GAP_UM / 2, footprint_um)
            out.height_a[r, c], out.radiance_a[r, c] = upper_block(x, y)
            out.height_b[r, c], out.radiance_b[r, c] = lower_block(x, y)


@fast_part
def upper_block(x: float, y: float) -> tuple[float, float]:
    """Return (height, radiance); past its edge the chamfer is mirrored, so that the sheet is continuous."""
    bevel = max(0.0, CHAMFER_UM - abs(x + GAP_UM / 2))
    if bevel <= 0.0:
        return STEP_UM, LAPPED_UPPER * (1.0 + 0.10 * lapping(x, y, UPPER_LAPPING, 0.35))
    return STEP_UM - bevel, CHAMFER + burnish(bevel)


@fast_part
def lower_block(x: float, y: float) -> tuple[float, float]:
    """Return (height, radiance) of the lower block and of the floor of the gap."""
    plane = TILT_X * x + TILT_Y * y
    inset = x - GAP_UM / 2
    if inset <= 0.0:
        return plane - GAP_DEPTH_UM, GAP
    bevel = max(0.0, CHAMFER_UM - inset)
    if bevel > 0.0:
        return plane - bevel, CHAMFER + burnish(bevel)
    return plane, LAPPED_LOWER * (1.0 + 0.10 * lapping(x, y, LOWER_LAPPING, -0.5))


@fast_part
def burnish(bevel: float) -> float:
    """Return the radiance of the thin bright line at the start of a chamfer."""
    return 0.3 * math.exp(-(((bevel - 0.8) / 0.8) ** 2))


@fast_part
def lapping(x: float, y: float, salt: Integer, turn_rad: float) -> float:
    """Return crossed lapping scratches and grain, of about unit standard deviation."""
    u = x * math.cos(turn_rad) + y * math.sin(turn_rad)
    v = y * math.cos(turn_rad) - x * math.sin(turn_rad)
    fine = 0.60 * grain(u / 1.3, v / 45.0, salt)
    long = 0.45 * grain(u / 2.9 + v / 90.0, v / 160.0, salt + 1)
    crossing = 0.30 * grain(v / 1.7, u / 30.0, salt + 3)
    return fine + long + crossing + 0.45 * grain(x / 1.6, y / 1.6, salt + 2)
