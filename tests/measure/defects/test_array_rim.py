"""The rim of an array: beyond the wafer's edge and in its outer streets nothing is a defect, and chips stay."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.support.noisy_wafer import PIXEL_UM, Planted, Wafer, wafer
from wafer_viewer.measure.defects.array_rim import beyond_wafer, lies_in_outer_street, open_sides
from wafer_viewer.measure.defects.inspection import inspect
from wafer_viewer.measure.dies.die_cells import CellGrid
from wafer_viewer.model.inspection.defect import DefectRecipe, Inspection

DEEP_UM = 60.0
RECIPE = DefectRecipe(sensitivity=0.25)


def without_corner(made: Wafer, corner_px: int = 90) -> Wafer:
    """The wafer ends across its upper left die, and the ground beyond lies far below."""
    surface = made.surface
    rows, cols = np.indices(surface.z_um.shape)
    beyond = rows + cols < corner_px
    z_um = np.where(beyond, surface.z_um - np.float32(DEEP_UM), surface.z_um)
    picture = np.where(beyond, np.uint8(60), surface.all_in_focus)
    return dataclasses.replace(
        made, surface=dataclasses.replace(surface, z_um=z_um, z_raw_um=z_um, all_in_focus=picture)
    )


def inspected(made: Wafer) -> Inspection:
    return inspect(made.surface, made.grid, RECIPE)


@pytest.fixture(scope="module")
def whole() -> Wafer:
    return wafer(3, (3, 3), (120, 140), (Planted("bump", 250.0, 392.0, 30, 8),))


@pytest.mark.slow
def test_ground_beyond_the_wafer_is_not_inspected(whole: Wafer):
    sound, cut = inspected(whole), inspected(without_corner(whole))
    assert [d.die for d in cut.found] == [d.die for d in sound.found]
    missing_mm2 = cut.unmeasured_mm2 - sound.unmeasured_mm2
    triangle_mm2 = 90**2 / 2 * (PIXEL_UM / 1000) ** 2
    assert missing_mm2 == pytest.approx(triangle_mm2, rel=0.5), "it counts as not inspected"


def test_a_hole_within_the_array_and_a_chip_at_its_rim_stay():
    golden = np.zeros((60, 80), np.float32)
    chipped, sides = golden.copy(), frozenset({(-1, 0), (-1, 1), (0, 1)})
    chipped[10:25, 12:30] = -DEEP_UM  # the street around the die is whole
    assert beyond_wafer(chipped, golden, sides) is None
    cut = golden.copy()
    cut[:20, :20] = -DEEP_UM
    beyond = beyond_wafer(cut, golden, sides)
    assert beyond is not None
    assert beyond[:20, :20].all()
    assert beyond.mean() < 0.2
    assert beyond_wafer(cut, golden, frozenset()) is None, "dies follow at all sides"
    assert beyond_wafer(cut, golden, frozenset({(1, 0)})) is None, "it does not reach the open side"
    assert beyond_wafer(cut / 10, golden, sides) is None, "a step of 6 um is no edge of a wafer"


def test_streets_that_border_no_die_are_told_from_others(whole: Wafer):
    grid = whole.grid
    cells, corner = CellGrid.of(grid, PIXEL_UM), (grid.first_col, grid.first_row)
    sides = open_sides(cells, corner)
    assert (-1, 0) in sides
    assert (1, 0) not in sides
    assert (1, 0) in open_sides(cells, corner, frozenset({(corner[0] + 1, corner[1])}))
    u_um = {"left": -1.0, "right": grid.width_um + 1.0, "on": 5.0}
    places = {name: grid.to_stage(*corner, np.full(9, u), np.full(9, 5.0)) for name, u in u_um.items()}
    told = {name: lies_in_outer_street(grid, corner, sides, *at) for name, at in places.items()}
    assert told == {"left": True, "right": False, "on": False}
