"""Strips of cells: what is read at once holds every cell that is read from it, and stays small."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.noisy_wafer import wafer
from wafer_viewer.measure.dies import die_cells
from wafer_viewer.measure.dies.die_cells import CellGrid, source_of
from wafer_viewer.model.inspection.die_grid import DieGrid


def lattice(angle_rad: float = 0.0) -> DieGrid:
    sizes = {"pitch_x_um": 100.0, "pitch_y_um": 80.0, "width_um": 90.0, "height_um": 70.0}
    return DieGrid(**sizes, x0_um=0.0, y0_um=0.0, rows=3, cols=7, angle_rad=angle_rad, left_out=("2,1",))


@pytest.mark.parametrize("angle_rad", [0.0, 0.05, -0.08])
@pytest.mark.parametrize("most_px", [100, 30_000, 10**9])
def test_strips_are_parts_of_rows_and_as_large_as_memory_allows(monkeypatch, angle_rad, most_px):
    monkeypatch.setattr(die_cells, "STRIP_PIXELS", most_px)
    cells = CellGrid.of(lattice(angle_rad), 1.0)
    strips = cells.side_by_side(cells.grid.places)
    assert [place for strip in strips for place in strip] == list(cells.grid.places)
    assert all(len({row for _, row in strip}) == 1 for strip in strips)
    assert len(strips) == (20 if most_px == 100 else 3 if most_px == 10**9 else len(strips))
    for strip in strips:
        x0, y0, x1, y1 = cells.around_all(strip).bounds_um
        assert len(strip) == 1 or (x1 - x0 - 20) * (y1 - y0 - 20) <= 1.3 * most_px


def test_a_cell_of_a_strip_is_what_is_read_of_it_alone():
    made = wafer(1, (2, 3), (60, 80))
    source, cells = source_of(made.surface, "unsmoothed", 2), CellGrid.of(made.grid, made.surface.pixel_um)
    strip = source.strip(cells.around_all(((0, 1), (1, 1), (2, 1))))
    assert strip is not None
    full = slice(0, cells.shape[0]), slice(0, cells.shape[1])
    for shift in ((0.0, 0.0), (1.4, -2.7)):
        alone, held = (one.read(cells, (1, 1), *full, shift) for one in (source, strip))
        for a, b in zip(alone, held, strict=True):
            np.testing.assert_array_equal(np.isnan(a), np.isnan(b))
            np.testing.assert_allclose(a, b, atol=1e-4)
