"""Diced wafer, 6 mm across: dies on a bright ground floor, with typical defects.

One die has a drop of gel, a scratch crosses several, edges are chipped and there are particles. The wafer is tilted and
bowed. Dies are numbered by column and row from the lower left of the grid, as in the lettering on them.
"""

from __future__ import annotations

import math

import numpy as np

from wafer_viewer.numerics.jit import fast_kernel, fast_part
from wafer_viewer.rigs.virtual.scenes.die import HEIGHT_UM, WIDTH_UM, bevel_drop, die
from wafer_viewer.rigs.virtual.scenes.drawing import (
    Points,
    SceneSheets,
    bar,
    bars,
    blend,
    chance,
    grain,
    inside,
    rectangle,
    wrapped,
)

PITCH_X_UM, PITCH_Y_UM, TRENCH_UM = 520.0, 400.0, 64.0
FIRST_COLUMN, FIRST_ROW = -5, -6  # the cell of the die numbered column 0, row 0, counted from stage (0, 0)
DEPTH_UM = 30.0
CORNER_UM = 14.0
RADIUS_UM, FLAT_UM, EDGE_EXCLUSION_UM = 3000.0, -2700.0, 50.0
GEL_COLUMN, GEL_ROW = 1, 1
GEL_U_UM, GEL_V_UM, GEL_RADIUS_UM, GEL_HEIGHT_UM = 318.0, 196.0, 66.0, 16.0
SCRATCH_LEFT_UM, SCRATCH_RIGHT_UM = 250.0, 1240.0
PARTICLE_CELL_UM, PARTICLE_SHARE = 130.0, 0.4
FLOOR, TAPE = 0.80, 0.05  # radiances
FAR_UM = 1000.0

# Salts, as numpy integers: numba would compile the noise anew for every literal one.
FINE, COARSE, BROAD, WANDER, CHIPS, DIE_TONE, GEL_OUTLINE, SCRATCH_WIDTH, SCRATCH_SKIPS = np.arange(1, 10)
PARTICLE, PARTICLE_X, PARTICLE_Y, PARTICLE_SIZE, PARTICLE_SHAPE, UPRIGHT_CUT, LEVEL_CUT = np.arange(90, 97)


@fast_kernel
def fill(x_um: Points, y_um: Points, footprint_um: float, out: SceneSheets) -> None:
    """Fill the two sheets at the given points: die tops (A) and trench floor (B)."""
    for r in range(x_um.shape[0]):
        for c in range(x_um.shape[1]):
            values = wafer(x_um[r, c], y_um[r, c], footprint_um)
            out.height_a[r, c], out.radiance_a[r, c], out.height_b[r, c], out.radiance_b[r, c], out.cover[r, c] = values


@fast_kernel
def wafer(x: float, y: float, footprint: float) -> tuple[float, float, float, float, float]:
    """Return (height A, radiance A, height B, radiance B, cover of A) at one point."""
    column, row = math.floor(x / PITCH_X_UM), math.floor(y / PITCH_Y_UM)
    u, v = x - column * PITCH_X_UM - TRENCH_UM / 2, y - row * PITCH_Y_UM - TRENCH_UM / 2
    base = 1.2e-3 * x - 0.7e-3 * y - 0.3e-6 * (x * x + y * y)
    inset = chipped(die_inset(u, v), x, y) if whole_die(column, row) else -FAR_UM
    cover = inside(inset, footprint)
    speck, speck_um, speck_radiance = particle(x, y, footprint)
    height_a, radiance_a = base + DEPTH_UM - bevel_drop(inset), 0.022
    height_b, radiance_b = base, 0.0
    if cover > 0.0:
        radiance, rise_um = die_top(x, y, u, v, column, row, inset, footprint)
        height_a = base + DEPTH_UM + rise_um + speck * speck_um
        radiance_a = blend(radiance, speck_radiance, speck)
    if cover < 1.0:
        ground = floor(x, y, u, v, -inset, footprint)
        height_b = base + speck * speck_um + 0.08 * grain(x / 1.5, y / 1.5, FINE)
        radiance_b = blend(ground, speck_radiance, speck)
    return height_a, radiance_a, height_b, radiance_b, cover


def is_whole_die(column: int, row: int) -> bool:
    """Return whether a die is inside the wafer's edge exclusion; partial dies are not printed."""
    left, lower = column * PITCH_X_UM + TRENCH_UM / 2, row * PITCH_Y_UM + TRENCH_UM / 2
    x = max(abs(left), abs(left + WIDTH_UM))
    y = max(abs(lower), abs(lower + HEIGHT_UM))
    return x * x + y * y < (RADIUS_UM - EDGE_EXCLUSION_UM) ** 2 and lower > FLAT_UM + EDGE_EXCLUSION_UM


whole_die = fast_part(is_whole_die)


@fast_kernel
def die_inset(u: float, v: float) -> float:
    """Return the distance of (u, v) inside the die's rounded outline; negative outside."""
    x = abs(u - WIDTH_UM / 2) - WIDTH_UM / 2 + CORNER_UM
    y = abs(v - HEIGHT_UM / 2) - HEIGHT_UM / 2 + CORNER_UM
    beyond = math.sqrt(max(x, 0.0) ** 2 + max(y, 0.0) ** 2)
    return CORNER_UM - beyond - min(max(x, y), 0.0)


@fast_part
def chipped(inset: float, x: float, y: float) -> float:
    """Return the inset after sawing, with edge roughness and occasional chips."""
    if inset < -2.0 or inset > 9.0:
        return inset
    return inset - 0.45 * grain(x / 2.6, y / 2.6, WANDER) - 5.0 * max(0.0, grain(x / 9.0, y / 9.0, CHIPS) - 0.9)


@fast_part
def die_top(
    x: float, y: float, u: float, v: float, column: int, row: int, inset: float, footprint: float
) -> tuple[float, float]:
    """Return (radiance, height over the die's top) of a die with its gel, scratch and grain."""
    radiance, rise_um, contrast = die(u, v, column - FIRST_COLUMN, row - FIRST_ROW, inset, footprint)
    gel = 0.0
    if column == GEL_COLUMN and row == GEL_ROW:
        gel, gel_um, gel_radiance, gel_contrast = gel_drop(u - GEL_U_UM, v - GEL_V_UM, radiance, footprint)
        radiance, rise_um = blend(radiance, gel_radiance, gel), blend(rise_um, gel_um, gel)
        contrast = blend(contrast, gel_contrast, gel)
    if contrast > 0.0 and SCRATCH_LEFT_UM < x < SCRATCH_RIGHT_UM:
        groove, lip = scratch(x, y, footprint)
        groove, lip = groove * (1.0 - gel), lip * (1.0 - gel)
        radiance = radiance * (1.0 - 0.7 * groove) + 0.30 * lip
        rise_um += 0.25 * lip - 1.3 * groove
        contrast += 0.1 * groove
    fine, coarse = grain(x / 1.5, y / 1.5, FINE), grain(x / 3.1, y / 3.1, COARSE)
    shade = 0.05 * grain(x / 170.0, y / 170.0, BROAD) + 0.03 * (chance(column, row, DIE_TONE) - 0.5)
    relief_um = 0.05 * coarse if contrast > 0.01 else 0.0
    return radiance * (1.0 + contrast * (0.8 * fine + 0.6 * coarse) + shade), rise_um + relief_um


@fast_part
def gel_drop(x: float, y: float, under: float, footprint: float) -> tuple[float, float, float, float]:
    """Return (share, height_um, radiance, contrast) of a clear drop; (x, y) from its centre.

    under: radiance below the drop. The drop mirrors the lamp where it is nearly level, and faintly shows the die below.
    """
    out = math.sqrt(x * x + y * y)
    if out > 1.0:
        out *= 1.0 + 0.035 * grain(1.6 * x / out, 1.6 * y / out, GEL_OUTLINE)
    if out > GEL_RADIUS_UM + 2.0:
        return 0.0, 0.0, 0.0, 0.0
    steepness = 2.0 * GEL_HEIGHT_UM * out / GEL_RADIUS_UM**2
    mirror = 1.0 / (1.0 + (steepness / 0.15) ** 4)
    meniscus = math.exp(-(((out - GEL_RADIUS_UM + 7.0) / 3.0) ** 2))
    height_um = GEL_HEIGHT_UM * max(0.0, 1.0 - (out / GEL_RADIUS_UM) ** 2)
    radiance = 0.05 + 0.33 * under + 0.22 * mirror + 0.05 * meniscus
    return inside(GEL_RADIUS_UM - out, footprint), height_um, radiance, 0.05 + 0.03 * mirror


@fast_kernel
def scratch(x: float, y: float, footprint: float) -> tuple[float, float]:
    """Return (groove, lip): coverage of a bent scratch that fades at both ends, with occasional interruptions."""
    middle = 214.0 + 0.31 * (x - SCRATCH_LEFT_UM) + 13.0 * math.sin(x / 190.0)
    away = abs(y - middle) * 0.955
    if away > 6.0:
        return 0.0, 0.0
    fade = min(1.0, (x - SCRATCH_LEFT_UM) / 120.0, (SCRATCH_RIGHT_UM - x) / 120.0)
    half_width = 1.5 * (1.0 + 0.35 * grain(x / 14.0, 0.5, SCRATCH_WIDTH)) * fade
    touching = inside((grain(x / 22.0, 0.7, SCRATCH_SKIPS) + 1.1) * 8.0, footprint)
    groove = inside(half_width - away, footprint)
    lip = inside(half_width + 1.1 - away, footprint) - groove
    return groove * touching, lip * touching


@fast_kernel
def particle(x: float, y: float, footprint: float) -> tuple[float, float, float]:
    """Return (share, height_um, radiance) of the random dust particle near a point: dark, with a glint."""
    i, j = math.floor(x / PARTICLE_CELL_UM), math.floor(y / PARTICLE_CELL_UM)
    if chance(i, j, PARTICLE) >= PARTICLE_SHARE:
        return 0.0, 0.0, 0.0
    radius = 1.6 + 4.6 * chance(i, j, PARTICLE_SIZE) ** 2
    across = x - (i + 0.1 + 0.8 * chance(i, j, PARTICLE_X)) * PARTICLE_CELL_UM
    along = y - (j + 0.1 + 0.8 * chance(i, j, PARTICLE_Y)) * PARTICLE_CELL_UM
    return dust(x, y, across, along, radius, footprint)


@fast_part
def dust(
    x: float, y: float, across: float, along: float, radius: float, footprint: float
) -> tuple[float, float, float]:
    """Return (share, height_um, radiance) of one dust particle.

    (across, along) are relative to its centre, (x, y) select its random outline.
    """
    far2 = (across * across + along * along) / (radius * radius)
    if far2 > 2.3:
        return 0.0, 0.0, 0.0
    far = math.sqrt(far2) * (1.0 + 0.12 * grain(x / 2.0, y / 2.0, PARTICLE_SHAPE))
    height_um = 1.2 * radius * math.sqrt(max(0.0, 1.0 - far * far))
    return inside((1.0 - far) * radius, footprint), height_um, 0.03 + 0.45 * math.exp(-6.0 * far2)


@fast_part
def floor(x: float, y: float, u: float, v: float, from_wall: float, footprint: float) -> float:
    """Return the radiance of the trench floor and of the tape beyond the wafer's edge."""
    edge = min(RADIUS_UM - math.sqrt(x * x + y * y), y - FLAT_UM)
    fine = grain(x / 1.5, y / 1.5, FINE)
    broad = grain(x / 170.0, y / 170.0, BROAD)
    upright, level = u < 0.0 or u > WIDTH_UM, v < 0.0 or v > HEIGHT_UM
    ground = FLOOR * (1.0 + 0.10 * fine + 0.05 * saw_marks(x, y, upright, level) + 0.03 * broad)
    ground *= (1.0 - 0.72 * printed(x, y, u, v, footprint)) * wall_shade(from_wall, DEPTH_UM)
    tape = TAPE * (1.0 + 0.12 * fine + 0.2 * broad)
    return blend(tape, ground, inside(edge, footprint))


@fast_part
def saw_marks(x: float, y: float, upright: bool, level: bool) -> float:
    """Return streaks along the cut: vertical in a column trench, horizontal in a row trench, both at crossings."""
    marks = grain(x / 1.1, y / 70.0, UPRIGHT_CUT) * upright + grain(x / 70.0, y / 1.1, LEVEL_CUT) * level
    return marks / max(1.0, 1.0 * upright + level)


@fast_part
def printed(x: float, y: float, u: float, v: float, footprint: float) -> float:
    """Return the coverage by print in the trenches.

    There are crosses at their intersections and barred test squares along the columns.
    """
    across = wrapped(x + PITCH_X_UM / 2, PITCH_X_UM) - PITCH_X_UM / 2
    along = wrapped(y + PITCH_Y_UM / 2, PITCH_Y_UM) - PITCH_Y_UM / 2
    cross, squares = crossing_mark(across, along, 15.0, footprint), 0.0
    if (u < 0.0 or u > WIDTH_UM) and 0.0 <= v <= HEIGHT_UM:
        square = rectangle(abs(across), wrapped(along - 20.0, 60.0), -1.0, 11.0, 0.0, 22.0, footprint)
        slits = bars(y, 5.5, 0.5, footprint) * bar(abs(across), -1.0, 8.5, footprint)
        squares = 0.8 * square * (1.0 - 0.75 * slits)
    return max(cross, squares)


@fast_part
def crossing_mark(across: float, along: float, arm_um: float, footprint: float) -> float:
    """Return the coverage by a cross with a given arm length; (across, along) from its centre."""
    upright = rectangle(across, along, -2.0, 2.0, -arm_um, arm_um, footprint)
    level = rectangle(across, along, -arm_um, arm_um, -2.0, 2.0, footprint)
    return max(upright, level)


@fast_part
def wall_shade(from_wall: float, depth_um: float) -> float:
    """Return the relative light at a distance from the foot of a wall, which blocks part of the light cone.

    Without it a trench's edge would bloom when it is out of focus, which no microscope shows.
    """
    cut_off = 0.5 * math.erfc(max(from_wall, 0.0) / (0.14 * depth_um * math.sqrt(2.0)))
    return 1.0 - 0.7 * cut_off / (1.0 - cut_off)
