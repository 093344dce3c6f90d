"""Surfaces with one row or one column of dies, drawn by seed: solved or refused, never the pitch of pads."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.patterned_surface import Wafer, made
from wafer_viewer.measure.dies.die_lattice import find_dies
from wafer_viewer.model.errors import DiesNotFound

GROUND_UM = 26.0
"""Round the array, of the same kind as the streets."""


def row_of_dies(seed: int) -> tuple[Wafer, object]:
    """A wafer with one row (even seeds) or column of dies with an array of pads, or rows of them along the edges."""
    dice = np.random.default_rng(seed)
    pitch_um, across_um = dice.uniform(170, 240, 2)
    n, pads_um = int(dice.integers(4, 8)), dice.uniform(20, 26)
    street_um, pixel_um = float(dice.uniform(20, 30)), 1.0
    along, across = round(n * pitch_um + GROUND_UM), round(across_um + 2 * GROUND_UM)
    upright = seed % 2 == 1
    width_um, height_um = (across_um, pitch_um - street_um) if upright else (pitch_um - street_um, across_um)
    everywhere = bool(dice.integers(2))

    def printed(u, v):
        x, y = u * width_um, v * height_um
        pads = ((x - 6) % pads_um < pads_um / 2) & ((y - 6) % pads_um < pads_um / 2)
        inner = np.minimum.reduce([x, y, width_um - x, height_um - y])
        block = (u > 0.55) & (u < 0.7) & (v > 0.3) & (v < 0.6)
        return np.where((inner > 6) & (everywhere | (inner < 34)), pads * 1.0, 0.5 * block)

    pitch = (2 * across_um, pitch_um) if upright else (pitch_um, 2 * across_um)
    size = {"rows": along, "cols": across} if upright else {"rows": across, "cols": along}
    wafer = Wafer(
        pixel_um=pixel_um, pitch_x_um=pitch[0], pitch_y_um=pitch[1], width_um=width_um, height_um=height_um,
        x0_um=GROUND_UM, y0_um=GROUND_UM, die_over_street_um=8.0, noise_um=0.2, bow_um=3.0, seed=seed, **size,
    )  # fmt: skip
    return wafer, printed


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("seed", range(7))
def test_one_row_or_column_of_dies_is_solved_or_refused(seed):
    wafer, printed = row_of_dies(seed)
    try:
        grid = find_dies(made(wafer, printed=printed))
    except DiesNotFound:
        return
    along = (grid.pitch_x_um, wafer.pitch_x_um) if wafer.cols > wafer.rows else (grid.pitch_y_um, wafer.pitch_y_um)
    across = (grid.height_um, wafer.height_um) if wafer.cols > wafer.rows else (grid.width_um, wafer.width_um)
    assert along[0] == pytest.approx(along[1], abs=1.0)
    n_dies = round((max(wafer.cols, wafer.rows) * wafer.pixel_um - GROUND_UM) / along[1])
    assert sorted((grid.cols, grid.rows)) == [1, n_dies], "all dies of the row, and none beside it"
    assert across[0] == pytest.approx(across[1], abs=4.0)
