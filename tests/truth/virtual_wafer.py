"""What there is on the virtual rig's wafer, from the scene's own functions: what a search for defects should find.

Besides the gel drop, the scratch and dust its dies differ in what the saw chipped off their edges, where the probe
touched their pads, and in the numbers written on them: true differences too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from wafer_viewer.rigs.virtual.scenes import die, wafer
from wafer_viewer.rigs.virtual.scenes.drawing import chance, grain

PIXEL_UM, ROOM_UM = 0.46729, 3.0
EDGE_UM = 9.0


@dataclass(frozen=True)
class Known:
    """Something that is on the wafer: where, how far it reaches, what it lies on."""

    kind: str
    x_um: float
    y_um: float
    radius_um: float
    on: str


def known(x0_um: float, y0_um: float, x1_um: float, y1_um: float) -> list[Known]:
    """Gel drop, pieces of the scratch and particles between two corners."""
    gel_x = wafer.GEL_COLUMN * wafer.PITCH_X_UM + wafer.TRENCH_UM / 2 + wafer.GEL_U_UM
    gel_y = wafer.GEL_ROW * wafer.PITCH_Y_UM + wafer.TRENCH_UM / 2 + wafer.GEL_V_UM
    everything = [Known("gel", gel_x, gel_y, wafer.GEL_RADIUS_UM, "die"), *scratch(), *particles()]
    return [one for one in everything if x0_um < one.x_um < x1_um and y0_um < one.y_um < y1_um]


def particles() -> Iterator[Known]:
    """Every grain of dust that the scene's dice have put on the wafer or beside it."""
    most = math.ceil(wafer.RADIUS_UM * 1.1 / wafer.PARTICLE_CELL_UM)
    for i in range(-most, most):
        for j in range(-most, most):
            if chance(i, j, wafer.PARTICLE) < wafer.PARTICLE_SHARE:
                x_um = (i + 0.1 + 0.8 * chance(i, j, wafer.PARTICLE_X)) * wafer.PARTICLE_CELL_UM
                y_um = (j + 0.1 + 0.8 * chance(i, j, wafer.PARTICLE_Y)) * wafer.PARTICLE_CELL_UM
                radius_um = 1.6 + 4.6 * chance(i, j, wafer.PARTICLE_SIZE) ** 2
                yield Known("particle", x_um, y_um, radius_um, ground(x_um, y_um))


def scratch() -> Iterator[Known]:
    """The scratch where it touches a die, a piece every 4 um."""
    for x_um in np.arange(wafer.SCRATCH_LEFT_UM, wafer.SCRATCH_RIGHT_UM, 4.0):
        along = x_um - wafer.SCRATCH_LEFT_UM
        y_um = 214.0 + 0.31 * along + 13.0 * math.sin(x_um / 190.0)
        groove, _ = wafer.scratch(float(x_um), y_um, PIXEL_UM)
        if groove > 0.5 and ground(float(x_um), y_um) == "die":
            yield Known("scratch", float(x_um), y_um, 4.0, "die")


def ground(x_um: float, y_um: float) -> str:
    """What lies at a place: a die, its edge (within 8 um), a trench, or the tape beyond the wafer."""
    column, row = math.floor(x_um / wafer.PITCH_X_UM), math.floor(y_um / wafer.PITCH_Y_UM)
    if math.hypot(x_um, y_um) > wafer.RADIUS_UM or y_um < wafer.FLAT_UM:
        return "tape"
    if not wafer.is_whole_die(column, row):
        return "no die"
    half = wafer.TRENCH_UM / 2
    inset = wafer.die_inset(x_um - column * wafer.PITCH_X_UM - half, y_um - row * wafer.PITCH_Y_UM - half)
    return "die" if inset > 8 else "die's edge" if inset > -8 else "trench"


def own_to_the_die(x_um: float, y_um: float) -> str:
    """Why dies truly differ at a place: a chip, the mark of a probe, the number that is written there; "" if not."""
    column, row = math.floor(x_um / wafer.PITCH_X_UM), math.floor(y_um / wafer.PITCH_Y_UM)
    if not wafer.is_whole_die(column, row):
        return ""
    u, v = x_um - column * wafer.PITCH_X_UM - wafer.TRENCH_UM / 2, y_um - row * wafer.PITCH_Y_UM - wafer.TRENCH_UM / 2
    if chip_um(x_um, y_um) > PIXEL_UM:
        return "chip"
    if 0 < u < die.WIDTH_UM and 0 <= min(v, die.HEIGHT_UM - v) - die.PAD_ROW_UM <= die.PAD_UM:
        return "probe mark"
    across, up = u - die.CORE_LEFT_UM - die.BLOCK_WIDTH_UM, v - die.CORE_BOTTOM_UM - die.BLOCK_HEIGHT_UM
    return "number" if 0 < across < die.BLOCK_WIDTH_UM and 0 < up < die.BLOCK_HEIGHT_UM else ""


def chip_um(x_um: float, y_um: float) -> float:
    """How deep the saw chipped the edge of a die within ROOM_UM of a place, um."""
    steps = np.linspace(-ROOM_UM, ROOM_UM, 9)
    return max(
        (_chipped_um(x_um + dx, y_um + dy) for dx in steps for dy in steps if math.hypot(dx, dy) <= ROOM_UM),
        default=0.0,
    )


def _chipped_um(x_um: float, y_um: float) -> float:
    column, row = math.floor(x_um / wafer.PITCH_X_UM), math.floor(y_um / wafer.PITCH_Y_UM)
    half = wafer.TRENCH_UM / 2
    inset = wafer.die_inset(x_um - column * wafer.PITCH_X_UM - half, y_um - row * wafer.PITCH_Y_UM - half)
    chip_um = 5.0 * max(0.0, grain(x_um / 9.0, y_um / 9.0, wafer.CHIPS) - 0.9)
    depth_um = chip_um + 0.45 * grain(x_um / 2.6, y_um / 2.6, wafer.WANDER) if chip_um else 0.0
    return depth_um if 0 <= inset <= min(depth_um, EDGE_UM) else 0.0


def chipped_share(column: int, row: int) -> float:
    """Of the outline of a die, how much lies within ROOM_UM of a chip."""
    left, low = (n * pitch + wafer.TRENCH_UM / 2 for n, pitch in ((column, wafer.PITCH_X_UM), (row, wafer.PITCH_Y_UM)))
    along = [(left + u, low) for u in np.arange(20, die.WIDTH_UM - 20, 4.0)]
    along += [(left, low + v) for v in np.arange(20, die.HEIGHT_UM - 20, 4.0)]
    return float(np.mean([chip_um(*place) > PIXEL_UM for place in along]))
