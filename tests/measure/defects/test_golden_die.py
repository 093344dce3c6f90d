"""The typical die: what dies differ in as a whole is no spread of theirs, and few that see a place do not decide it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.support.noisy_wafer import PIXEL_UM, SIGMA_UM, Wafer, wafer
from wafer_viewer.measure.defects.golden_die import ReferenceDie, golden_of
from wafer_viewer.measure.dies.die_cells import CellGrid, source_of

DIES = (4, 4)


def made() -> Wafer:
    return wafer(4, DIES, (120, 140))


def golden(of: Wafer) -> ReferenceDie:
    cells = CellGrid.of(of.grid, PIXEL_UM)
    return golden_of(source_of(of.surface, "unsmoothed", 2), cells, of.grid.places)


def with_heights(of: Wafer, z_um: np.ndarray) -> Wafer:
    return dataclasses.replace(of, surface=dataclasses.replace(of.surface, z_um=z_um, z_raw_um=z_um))


def cells_of(of: Wafer):
    """Rows and columns of the surface that each die with its street fills."""
    down, right = of.grid.pitch_y_um / PIXEL_UM, of.grid.pitch_x_um / PIXEL_UM
    for r in range(DIES[0]):
        for c in range(DIES[1]):
            yield slice(round(r * down), round((r + 1) * down)), slice(round(c * right), round((c + 1) * right))


@pytest.mark.slow
def test_individually_tilted_dies_are_levelled() -> None:
    of, dice = made(), np.random.default_rng(5)
    z_um = of.surface.z_raw_um.copy()
    for rows, cols in cells_of(of):
        part = z_um[rows, cols]
        down, right = dice.uniform(-1, 1, 2)
        part += down * np.linspace(-1, 1, part.shape[0], dtype=np.float32)[:, None]
        part += right * np.linspace(-1, 1, part.shape[1], dtype=np.float32)[None, :]
    level, tilted = golden(of), golden(with_heights(of, z_um))
    assert float(np.nanmedian(level.z_spread_um)) == pytest.approx(SIGMA_UM, rel=0.4)
    assert float(np.nanmedian(tilted.z_spread_um)) == pytest.approx(float(np.nanmedian(level.z_spread_um)), rel=0.1)


def test_a_place_that_only_few_dies_know_is_not_known() -> None:
    of = made()
    z_um = of.surface.z_raw_um.copy()
    for k, (rows, cols) in enumerate(cells_of(of)):
        z_um[rows, cols][60:80, 60:90] = 30.0 if k < 6 else np.nan
    found = golden(with_heights(of, z_um))
    assert np.isnan(found.z_um[64:76, 64:86]).all()
    assert np.isfinite(found.picture[64:76, 64:86]).all()


@pytest.mark.slow
def test_a_structure_that_begins_at_the_middle_of_the_street_is_not_trusted_on_its_other_side_either() -> None:
    """There few dies, far off their places, show it, and a robust spread does not tell."""
    of = made()
    picture = of.surface.all_in_focus.copy()
    for rows, cols in cells_of(of):
        picture[rows, cols.start + 1 : cols.start + 5] = 20
    lined = dataclasses.replace(of, surface=dataclasses.replace(of.surface, all_in_focus=picture))
    spread, plain = (golden(one).picture_spread[20:-20] for one in (lined, of))
    assert float(np.median(spread[:, -1])) > 5 * float(np.median(plain[:, -1]))
    assert float(np.median(spread[:, 40:-40])) == pytest.approx(float(np.median(plain[:, 40:-40])), rel=0.1)
