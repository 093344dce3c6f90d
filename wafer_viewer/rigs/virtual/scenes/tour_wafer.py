"""Wafer of the tour, 3 mm across: nine small dies fit on 3 x 3 fields, with shallow streets between them.

All dies are alike, as printed by one reticle, except for the planted defects: a drop of gel on the middle die, a
scratch over two dies of the row below it, and particles. Dies are numbered by column and row from the lower left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from wafer_viewer.numerics.jit import fast_kernel, fast_part
from wafer_viewer.rigs.virtual.scenes import die as full_size
from wafer_viewer.rigs.virtual.scenes.die import bevel_drop, die
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
from wafer_viewer.rigs.virtual.scenes.wafer import (
    BROAD,
    COARSE,
    DIE_TONE,
    FAR_UM,
    FINE,
    FLOOR,
    GEL_HEIGHT_UM,
    GEL_RADIUS_UM,
    SCRATCH_SKIPS,
    SCRATCH_WIDTH,
    TAPE,
    WANDER,
    crossing_mark,
    dust,
    gel_drop,
    saw_marks,
    wall_shade,
)

SCALE = 0.57
"""Scale of the dies relative to the larger wafer."""
WIDTH_UM, HEIGHT_UM = SCALE * full_size.WIDTH_UM, SCALE * full_size.HEIGHT_UM
PITCH_X_UM, PITCH_Y_UM = 302.0, 231.0
DEPTH_UM = 15.0
CORNER_UM = 8.0
(UNNUMBERED,) = np.full(1, -1)
"""A numpy integer: numba would compile the die anew for a literal one."""
LEAST_RADIANCE, LEAST_CONTRAST = 0.10, 0.06
"""Least values on a die, so that bevel, rim and blank block have texture and heights are measured there."""
RADIUS_UM, FLAT_UM, EDGE_EXCLUSION_UM = 1500.0, -1350.0, 30.0
DROP_X_UM, DROP_Y_UM, DROP_RADIUS_UM, DROP_HEIGHT_UM = 46.0, 8.0, 34.0, 8.0
SCRATCH_LEFT_UM, SCRATCH_RIGHT_UM, SCRATCH_LOWER_UM, SCRATCH_SLOPE = -405.0, 95.0, -285.0, 0.2
SCRATCH_HALF_UM, SCRATCH_DEPTH_UM = 1.5, 1.3
PARTICLE_ASPECT = 0.8
"""Particle height relative to the dust on the larger wafer, which is 1.2 radii high."""
PARTICLES = np.array([
    (-352.0, 262.0, 7.0),
    (-215.0, 185.0, 5.6),
    (36.0, 268.0, 6.2),
    (250.0, 205.0, 8.5),
    (390.0, 290.0, 5.2),
    (-330.0, -20.0, 6.2),
    (345.0, 30.0, 6.6),
    (-62.0, -55.0, 5.6),
    (362.0, -262.0, 7.6),
    (60.0, -290.0, 6.0),
    (151.0, 62.0, 6.6),
])  # fmt: skip
"""x, y and radius of each particle, um; the last one is in a street."""


@dataclass(frozen=True, slots=True)
class Planted:
    """Planted defect: class, centre, length (diameter of a drop or particle), height."""

    kind: Literal["residue", "scratch", "particle"]
    x_um: float
    y_um: float
    length_um: float
    height_um: float


def planted() -> tuple[Planted, ...]:
    """Return the defects of the nine dies of the tour. For tests only."""
    middle_um = (SCRATCH_LEFT_UM + SCRATCH_RIGHT_UM) / 2
    run_um = SCRATCH_RIGHT_UM - SCRATCH_LEFT_UM
    return (
        Planted("residue", DROP_X_UM, DROP_Y_UM, 2 * DROP_RADIUS_UM, DROP_HEIGHT_UM),
        Planted("scratch", middle_um, scratch_middle(middle_um), run_um, -SCRATCH_DEPTH_UM),
        *(
            Planted("particle", float(x), float(y), 2 * float(r), 1.2 * PARTICLE_ASPECT * float(r))
            for x, y, r in PARTICLES
        ),
    )


@fast_kernel
def fill(x_um: Points, y_um: Points, footprint_um: float, out: SceneSheets) -> None:
    """Fill the two sheets at the given points: die tops (A) and street floor (B)."""
    for r in range(x_um.shape[0]):
        for c in range(x_um.shape[1]):
            values = wafer(x_um[r, c], y_um[r, c], footprint_um)
            out.height_a[r, c], out.radiance_a[r, c], out.height_b[r, c], out.radiance_b[r, c], out.cover[r, c] = values


@fast_part
def wafer(x: float, y: float, footprint: float) -> tuple[float, float, float, float, float]:
    """Return (height A, radiance A, height B, radiance B, cover of A) at one point."""
    column, row = math.floor(x / PITCH_X_UM + 0.5), math.floor(y / PITCH_Y_UM + 0.5)
    across, along = x - column * PITCH_X_UM, y - row * PITCH_Y_UM
    base = 1.2e-3 * x - 0.7e-3 * y - 0.3e-6 * (x * x + y * y)
    inset = -FAR_UM
    if whole_die(column, row):
        inset = die_inset(across, along)
        if -2.0 < inset < 9.0:
            inset -= 0.25 * grain(x / 2.6, y / 2.6, WANDER)
    cover = inside(inset, footprint)
    speck, speck_um, speck_radiance = particle(x, y, footprint)
    drop = bevel_drop(inset / SCALE) * SCALE
    height_a, radiance_a = base + DEPTH_UM - drop, 0.022
    height_b, radiance_b = base, 0.0
    if cover > 0.0:
        radiance, rise_um = die_top(x, y, across, along, column, row, inset, footprint)
        height_a = base + DEPTH_UM + rise_um + speck * speck_um
        radiance_a = blend(radiance, speck_radiance, speck)
    if cover < 1.0:
        ground = floor(x, y, across, along, -inset, footprint)
        height_b = base + speck * speck_um + 0.08 * grain(x / 1.5, y / 1.5, FINE)
        radiance_b = blend(ground, speck_radiance, speck)
    return height_a, radiance_a, height_b, radiance_b, cover


def is_whole_die(column: int, row: int) -> bool:
    """Return whether a die is inside the wafer's edge exclusion; partial dies are not printed."""
    x = abs(column) * PITCH_X_UM + WIDTH_UM / 2
    y = abs(row) * PITCH_Y_UM + HEIGHT_UM / 2
    lower = row * PITCH_Y_UM - HEIGHT_UM / 2
    return x * x + y * y < (RADIUS_UM - EDGE_EXCLUSION_UM) ** 2 and lower > FLAT_UM + EDGE_EXCLUSION_UM


whole_die = fast_part(is_whole_die)


@fast_part
def die_inset(across: float, along: float) -> float:
    """Return the distance inside the die's rounded outline, negative outside; (across, along) from the die centre."""
    x = abs(across) - WIDTH_UM / 2 + CORNER_UM
    y = abs(along) - HEIGHT_UM / 2 + CORNER_UM
    beyond = math.sqrt(max(x, 0.0) ** 2 + max(y, 0.0) ** 2)
    return CORNER_UM - beyond - min(max(x, y), 0.0)


@fast_part
def die_top(
    x: float, y: float, across: float, along: float, column: int, row: int, inset: float, footprint: float
) -> tuple[float, float]:
    """Return (radiance, height over the die's top) of a die with its defects and grain."""
    u, v = (across + WIDTH_UM / 2) / SCALE, (along + HEIGHT_UM / 2) / SCALE
    radiance, rise_um, contrast = die(u, v, UNNUMBERED, UNNUMBERED, inset / SCALE, footprint / SCALE)
    radiance, contrast = max(radiance, LEAST_RADIANCE), max(contrast, LEAST_CONTRAST)
    gel, gel_um, gel_radiance, gel_contrast = drop(x, y, radiance, footprint)
    radiance, rise_um = blend(radiance, gel_radiance, gel), blend(rise_um, gel_um, gel)
    contrast = blend(contrast, gel_contrast, gel)
    if contrast > 0.0 and SCRATCH_LEFT_UM < x < SCRATCH_RIGHT_UM:
        groove, lip = scratch(x, y, footprint)
        radiance = radiance * (1.0 - 0.7 * groove) + 0.30 * lip
        rise_um += 0.25 * lip - SCRATCH_DEPTH_UM * groove
        contrast += 0.1 * groove
    fine, coarse = grain(x / 1.5, y / 1.5, FINE), grain(x / 3.1, y / 3.1, COARSE)
    shade = 0.05 * grain(x / 170.0, y / 170.0, BROAD) + 0.03 * (chance(column, row, DIE_TONE) - 0.5)
    relief_um = 0.05 * coarse if contrast > 0.01 else 0.0
    return radiance * (1.0 + contrast * (0.8 * fine + 0.6 * coarse) + shade), rise_um + relief_um


@fast_part
def drop(x: float, y: float, under: float, footprint: float) -> tuple[float, float, float, float]:
    """Return (share, height_um, radiance, contrast) of the gel drop, a scaled version of the larger wafer's."""
    smaller = GEL_RADIUS_UM / DROP_RADIUS_UM
    across, along = (x - DROP_X_UM) * smaller, (y - DROP_Y_UM) * smaller
    share, height_um, radiance, contrast = gel_drop(across, along, under, footprint * smaller)
    return share, height_um * DROP_HEIGHT_UM / GEL_HEIGHT_UM, radiance, contrast


@fast_kernel
def scratch_middle(x: float) -> float:
    """Return the y of the scratch at x."""
    return SCRATCH_LOWER_UM + SCRATCH_SLOPE * (x - SCRATCH_LEFT_UM) + 6.0 * math.sin(x / 60.0)


@fast_part
def scratch(x: float, y: float, footprint: float) -> tuple[float, float]:
    """Return (groove, lip): coverage of a bent scratch that fades at both ends, with occasional interruptions."""
    away = abs(y - scratch_middle(x)) * 0.97
    if away > 6.0:
        return 0.0, 0.0
    fade = min(1.0, (x - SCRATCH_LEFT_UM) / 60.0, (SCRATCH_RIGHT_UM - x) / 60.0)
    half_width = SCRATCH_HALF_UM * (1.0 + 0.3 * grain(x / 14.0, 0.5, SCRATCH_WIDTH)) * fade
    touching = inside((grain(x / 22.0, 0.7, SCRATCH_SKIPS) + 2.4) * 8.0, footprint)
    groove = inside(half_width - away, footprint)
    lip = inside(half_width + 1.1 - away, footprint) - groove
    return groove * touching, lip * touching


@fast_part
def particle(x: float, y: float, footprint: float) -> tuple[float, float, float]:
    """Return (share, height_um, radiance) of the particle at a point, zeros without one."""
    for k in range(PARTICLES.shape[0]):
        across, along, radius = x - PARTICLES[k, 0], y - PARTICLES[k, 1], PARTICLES[k, 2]
        if abs(across) < 1.6 * radius and abs(along) < 1.6 * radius:
            share, height_um, radiance = dust(x, y, across, along, radius, footprint)
            grained = (0.08 + radiance) * (1.0 + 0.25 * grain(x / 1.5, y / 1.5, FINE))
            return share, height_um * PARTICLE_ASPECT, grained
    return 0.0, 0.0, 0.0


@fast_part
def floor(x: float, y: float, across: float, along: float, from_wall: float, footprint: float) -> float:
    """Return the radiance of the street floor and of the tape beyond the wafer's edge."""
    edge = min(RADIUS_UM - math.sqrt(x * x + y * y), y - FLAT_UM)
    fine = grain(x / 1.5, y / 1.5, FINE)
    broad = grain(x / 170.0, y / 170.0, BROAD)
    upright, level = abs(across) > WIDTH_UM / 2, abs(along) > HEIGHT_UM / 2
    ground = FLOOR * (1.0 + 0.10 * fine + 0.05 * saw_marks(x, y, upright, level) + 0.03 * broad)
    ground *= (1.0 - 0.72 * printed(x, y, upright and not level, footprint)) * wall_shade(from_wall, DEPTH_UM)
    tape = TAPE * (1.0 + 0.12 * fine + 0.2 * broad)
    return blend(tape, ground, inside(edge, footprint))


@fast_part
def printed(x: float, y: float, upright: bool, footprint: float) -> float:
    """Return the coverage by print in the streets.

    There are crosses at their intersections and barred test squares along the columns.
    """
    across, along = wrapped(x, PITCH_X_UM) - PITCH_X_UM / 2, wrapped(y, PITCH_Y_UM) - PITCH_Y_UM / 2
    squares = 0.0
    if upright:
        square = rectangle(abs(across), wrapped(along - 14.0, 38.5), -1.0, 8.0, 0.0, 15.0, footprint)
        slits = bars(along + PITCH_Y_UM / 2, 5.5, 0.5, footprint) * bar(abs(across), -1.0, 6.0, footprint)
        squares = 0.8 * square * (1.0 - 0.75 * slits)
    return max(crossing_mark(across, along, 12.0, footprint), squares)
