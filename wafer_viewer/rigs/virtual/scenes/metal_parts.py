"""Samples of metal: a ground plate, a turned cone, a staircase of ground treads, and two lapped gauge blocks.

The plate is tilted by 4 mrad along x and 1.5 mrad along y. The cone, 120 um high with a slope of 0.30, stands on a flat
plate; its tip is at stage (0, 0). The treads are 180 um deep with a rise of 20 um and climb towards +x.

The gauge blocks lie side by side, 399.88 um apart in height, with a dark chamfer gap between them. The joint is at
stage x = 0: the upper block is left of it, the lower one right, tilted relative to the upper by 0.3 mrad.
"""

from __future__ import annotations

import math

import numpy as np

from wafer_viewer.numerics.jit import fast_kernel, fast_part
from wafer_viewer.rigs.virtual.scenes.drawing import Integer, Points, SceneSheets, bars, grain, inside

PLATE, CONE, STAIRCASE, BLOCKS = np.arange(4)

PLATE_TILT_X, PLATE_TILT_Y = 4e-3, 1.5e-3
CONE_HEIGHT_UM, CONE_SLOPE = 120.0, 0.30
TREAD_UM, RISE_UM = 180.0, 20.0
STEP_UM = 399.88
GAP_UM, CHAMFER_UM = 70.0, 45.0
TILT_X, TILT_Y = 3e-4, 1.2e-4
GAP_DEPTH_UM = 60.0
LAPPED_UPPER, LAPPED_LOWER, CHAMFER, GAP = 0.42, 0.40, 0.028, 0.008  # radiances

# Salts, as numpy integers: numba would compile the noise anew for every literal one.
PLATE_GRAIN, PLATE_MARKS = np.arange(31, 33)
TREAD_GRAIN, TREAD_MARKS = np.arange(41, 43)
CONE_GRAIN, CONE_RINGS = np.arange(51, 53)
EDGE, UPPER_LAPPING, LOWER_LAPPING = np.arange(61, 82, 10)  # lapping takes four


@fast_kernel
def fill(kind: Integer, x_um: Points, y_um: Points, footprint_um: float, out: SceneSheets) -> None:
    """Fill the two sheets of a sample at the given points."""
    for r in range(x_um.shape[0]):
        for c in range(x_um.shape[1]):
            x, y = x_um[r, c], y_um[r, c]
            if kind == BLOCKS:
                values = blocks(x, y, footprint_um)
            elif kind == STAIRCASE:
                values = staircase(x, y, footprint_um)
            else:
                height, radiance = cone(x, y) if kind == CONE else plate(x, y)
                values = height, radiance, height, radiance, 1.0
            out.height_a[r, c], out.radiance_a[r, c], out.height_b[r, c], out.radiance_b[r, c], out.cover[r, c] = values


@fast_part
def plate(x: float, y: float) -> tuple[float, float]:
    """Return (height, radiance) of a ground surface, with grain and marks along x."""
    return PLATE_TILT_X * x + PLATE_TILT_Y * y, ground(x, y, 45.0, PLATE_GRAIN, PLATE_MARKS)


@fast_part
def ground(x: float, y: float, marks_um: float, grain_salt: Integer, marks_salt: Integer) -> float:
    """Return the radiance of a ground surface: grain, and marks along x."""
    return 0.40 * (1.0 + 0.10 * grain(x / 1.6, y / 1.6, grain_salt) + 0.05 * grain(x / marks_um, y / 1.3, marks_salt))


@fast_part
def cone(x: float, y: float) -> tuple[float, float]:
    """Return (height, radiance) of a turned surface, with grain and rings."""
    out, around = math.sqrt(x * x + y * y), math.atan2(y, x)
    rings = 0.05 * grain(out / 1.4, around * 40.0, CONE_RINGS)
    return max(0.0, CONE_HEIGHT_UM - CONE_SLOPE * out), 0.40 * (
        1.0 + 0.10 * grain(x / 1.6, y / 1.6, CONE_GRAIN) + rings
    )


@fast_part
def staircase(x: float, y: float, footprint: float) -> tuple[float, float, float, float, float]:
    """Return (height A, radiance A, height B, radiance B, cover of A): even treads on A, odd ones on B.

    Neighbouring treads are thus on different sheets, and each sheet continues level past its own treads.
    """
    here = math.floor(x / TREAD_UM)
    nearest = here + 1 if x - here * TREAD_UM > TREAD_UM / 2 else here - 1
    even, odd = (here, nearest) if here % 2 == 0 else (nearest, here)
    metal = ground(x, y, 40.0, TREAD_GRAIN, TREAD_MARKS)
    cover = bars(x, 2 * TREAD_UM, 0.5, footprint)
    return even * RISE_UM, metal * tone(even), odd * RISE_UM, metal * tone(odd), cover


@fast_part
def tone(tread: int) -> float:
    """Return a brightness factor that distinguishes neighbouring treads."""
    return 0.9 + 0.1 * (tread % 3)


@fast_part
def blocks(x: float, y: float, footprint: float) -> tuple[float, float, float, float, float]:
    """Return (height A, radiance A, height B, radiance B, cover of A): upper block (A), lower block and gap (B)."""
    ragged = 0.8 * grain(y / 7.0, 0.5, EDGE)
    height_a, radiance_a = upper_block(x, y)
    height_b, radiance_b = lower_block(x, y)
    return height_a, radiance_a, height_b, radiance_b, inside(ragged - x - GAP_UM / 2, footprint)


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
