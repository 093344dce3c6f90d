"""Rim of an array of dies: streets that border no die, and ground beyond the edge of the wafer."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.dies.die_cells import CellGrid, Place, Plane
from wafer_viewer.model.inspection.die_grid import DieGrid

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class RimParameters:
    """Limits of the ground beyond a wafer.

    Parameters
    ----------
    deep_um : float, um
        Least depth under the die; the edge of a wafer is far deeper than its pattern.
    of_pattern : float
        Least depth relative to the range of heights of the typical die.
    level_percentile : float
        Percentile of the deviations of a cell that is taken as the level of its die.
    least_px : int, px
        Smallest area.
    ramp_px : int, px
        Width of the slope that the focus window leaves at the edge.

    Notes
    -----
    Set on `tests/bench/bench_die_states.py`, seeds 7200 to 7221.
    """

    deep_um: float = 10.0
    of_pattern: float = 3.0
    level_percentile: float = 75.0
    least_px: int = 20
    ramp_px: int = 8


RIM = RimParameters()

_AROUND = [(col, row) for col in (-1, 0, 1) for row in (-1, 0, 1) if (col, row) != (0, 0)]
"""Directions (col, row) of the eight neighbours of a die."""


@lru_cache(maxsize=4)
def _held(grid: DieGrid) -> frozenset[Place]:
    return frozenset(grid.places)


def open_sides(cells: CellGrid, place: Place, missing: frozenset[Place] = frozenset()) -> frozenset[Place]:
    """Return the directions (col, row) in which no die follows, of the eight around a die."""
    held, (col, row) = _held(cells.grid), place
    around = {side: (col + side[0], row + side[1]) for side in _AROUND}
    return frozenset(side for side, other in around.items() if other not in held or other in missing)


def outer_street(cells: CellGrid, sides: frozenset[Place]) -> Mask:
    """Return the pixels of a cell's streets that border no other die.

    Their surroundings are not those of the streets between dies, of which the reference is made.
    """
    mask = np.zeros(cells.shape, bool)
    rows, cols = cells.die
    for side, part in (
        ((-1, 0), np.s_[:, : cols.start]),
        ((1, 0), np.s_[:, cols.stop :]),
        ((0, 1), np.s_[: rows.start, :]),
        ((0, -1), np.s_[rows.stop :, :]),
    ):
        mask[part] |= side in sides
    return mask


def lies_in_outer_street(
    grid: DieGrid, place: Place, sides: frozenset[Place], x_um: NDArray[np.float64], y_um: NDArray[np.float64]
) -> bool:
    """Return whether most of these stage positions are in a street of a die that borders no other die."""
    col, row, u_um, v_um = grid.to_die(x_um, y_um)
    u_um = u_um + (col - place[0]) * grid.pitch_x_um
    v_um = v_um + (row - place[1]) * grid.pitch_y_um
    outside = np.zeros(len(x_um), bool)
    for side, beyond in (
        ((-1, 0), u_um < 0),
        ((1, 0), u_um > grid.width_um),
        ((0, 1), v_um > grid.height_um),
        ((0, -1), v_um < 0),
    ):
        outside |= beyond & (side in sides)
    return bool(outside.mean() > 0.5)


def beyond_wafer(z_um: Plane, golden_um: Plane, sides: frozenset[Place]) -> Mask | None:
    """Return the pixels of a cell at the rim that lie beyond the edge of the wafer; None without any.

    They are far below the die, and reach the border of the cell towards a place without a die: a chip of the die does
    not, as the street lies between.
    """
    from scipy.ndimage import binary_dilation, label

    difference = z_um - golden_um
    finite = np.isfinite(difference)
    if not sides or not finite.any():
        return None
    low, high = np.nanpercentile(golden_um, (1, 99))
    depth_um = max(RIM.deep_um, RIM.of_pattern * float(high - low))
    level = np.percentile(difference[finite], RIM.level_percentile)
    with np.errstate(invalid="ignore"):
        deep = np.less(difference, level - depth_um)
    if np.count_nonzero(deep) < RIM.least_px:
        return None
    parts = np.zeros(deep.shape, np.int32)
    label(deep, np.ones((3, 3), int), output=parts)
    reaching = np.setdiff1d(np.unique(np.concatenate([parts[edge].ravel() for edge in _edges(sides)])), [0])
    mask: Mask = np.isin(parts, reaching)
    if np.count_nonzero(mask) < RIM.least_px:
        return None
    return np.asarray(binary_dilation(mask, np.ones((3, 3)), RIM.ramp_px), np.bool_)


def _edges(sides: frozenset[Place]) -> list[tuple[slice | int, slice | int]]:
    """Return the border pixels of a cell towards these directions; a corner has its two edges."""
    everything = slice(None)
    edges: list[tuple[slice | int, slice | int]] = []
    edges += [(everything, 0)] if any(col < 0 for col, _ in sides) else []
    edges += [(everything, -1)] if any(col > 0 for col, _ in sides) else []
    edges += [(0, everything)] if any(row > 0 for _, row in sides) else []
    edges += [(-1, everything)] if any(row < 0 for _, row in sides) else []
    return edges
