"""What the rules of classes go by, from pixels: how deep, how long in the picture, at the edge or not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from wafer_viewer.measure.defects.defect_builder import classify
from wafer_viewer.measure.defects.features import Gathered, height_of, outline_of, shape_of
from wafer_viewer.measure.defects.segmentation import DefectPiece
from wafer_viewer.measure.dies.die_cells import CellGrid
from wafer_viewer.model.inspection.defect import DefectRecipe
from wafer_viewer.model.inspection.defect_classes import DefectShape
from wafer_viewer.model.inspection.die_grid import DieGrid

Floats = NDArray[np.float64]
GRID = DieGrid(
    pitch_x_um=120.0, pitch_y_um=120.0, width_um=100.0, height_um=100.0, x0_um=0.0, y0_um=0.0, rows=3, cols=3
)
CELLS = CellGrid.of(GRID, 1.0)
NOISE_UM = 0.2


def gathered(u: Floats, v: Floats, z_um: Floats, clear: Floats, peaks: dict[str, float]) -> Gathered:
    """Of one piece on die 1,1, its heights taken as smooth."""
    x_um, y_um = (np.asarray(a, float) for a in GRID.to_stage(1, 1, u, v))
    flat = np.zeros(len(u))
    piece = DefectPiece(
        x_um, y_um, u, v, z_um, z_um, flat, clear, (1, 1), np.zeros(len(u), bool), peaks, 0.0, noise_um=NOISE_UM
    )  # fmt: skip
    return Gathered.of([piece])


def shaped(full: Gathered) -> DefectShape:
    height_um, inside = height_of(full, 1.0)
    outline = outline_of(full.x_um[inside], full.y_um[inside], 1.0)
    return shape_of(full, inside, outline, height_um, CELLS, DefectRecipe(), True)


def disc(u: float, v: float, radius: float) -> tuple[Floats, Floats, Floats]:
    """Places and distances from the middle."""
    at = np.arange(-int(radius), int(radius) + 1) + 0.5
    du, dv = (a.astype(float).ravel() for a in np.meshgrid(at, at))
    away = np.hypot(du, dv)
    return u + du[away < radius], v + dv[away < radius], away[away < radius]


def test_a_dark_pit_whose_rim_reads_as_high_as_it_is_deep_is_a_pit():
    u, v, away = disc(50.0, 50.0, 15.0)
    z_um = np.where(away < 10, -0.5 * (1 - (away / 10) ** 2), 0.0)
    z_um[(away > 12) & (u < 45)] = 0.6
    full = gathered(u, v, z_um, np.where(away < 10, 4.0, 0.0), {"height": 3.5, "picture": 9.0})
    assert shaped(full).height_um == pytest.approx(-0.5, abs=0.01)
    assert classify(shaped(full)).kind == "pit"


def test_what_is_plainly_higher_than_deep_is_high():
    u, v, away = disc(50.0, 50.0, 15.0)
    z_um = np.where(away < 4, 3.0, -0.3)
    full = gathered(u, v, z_um, np.full(len(u), 4.0), {"height": 12.0, "picture": 9.0})
    assert shaped(full).height_um == 3.0


def test_a_groove_whose_heights_are_blurred_wide_is_a_scratch_by_its_picture():
    rows, cols = (a.ravel().astype(float) for a in np.mgrid[36:56, 30:54])
    z_um = -0.5 * np.exp(-(((rows - 46) / 9) ** 2))
    full = gathered(cols, rows, z_um, np.where(np.abs(rows - 46) < 2, 5.0, 0.0), {"height": 4.0, "picture": 7.0})
    shape = shaped(full)
    assert shape.major_um / shape.minor_um < 2.5
    assert shape.ratio == pytest.approx(8.0, rel=0.1)
    assert classify(shape).kind == "scratch"


def test_what_the_picture_shows_beside_an_error_of_heights_is_not_lost() -> None:
    u, v, _ = disc(30.0, 50.0, 6.0)
    rows, cols = (a.ravel().astype(float) for a in np.mgrid[30:70, 48:51])
    edge, scratch = np.full(len(u), 1.0), np.full(len(rows), 0.0)
    z_um, clear = np.concatenate([edge, scratch]), np.concatenate([0 * edge, scratch + 5.0])
    both = np.concatenate([u, cols]), np.concatenate([v, rows])
    _, inside = height_of(gathered(*both, z_um, clear, {"height": 6.0, "sharp": 9.0}), 1.0)
    assert inside.all()
    near = np.concatenate([u, cols - 18]), both[1]
    _, inside = height_of(gathered(*near, z_um, clear, {"height": 6.0, "sharp": 9.0}), 1.0)
    assert inside.sum() == len(u)
    _, inside = height_of(gathered(*both, z_um, clear, {"height": 6.0, "sharp": 4.0}), 1.0)
    assert inside.sum() == len(u)


def test_the_heights_tell_how_long_it_is_where_they_show_it_more_clearly():
    u, v, away = disc(50.0, 50.0, 10.0)
    streak = np.where(np.abs(v - 50) < 1, 1.0, 0.0)
    full = gathered(u, v, 2.0 - away / 10, streak, {"height": 9.0, "picture": 4.0})
    assert shaped(full).picture_ratio > 2.5
    assert shaped(full).ratio < 1.2


@pytest.mark.parametrize("v_um", [0.0, 100.0])
def test_a_chip_without_a_single_height_is_one_by_the_edge_it_lies_on(v_um: float):
    u, v, _ = disc(40.0, v_um, 5.0)
    on_die = (v > 0) & (v < 100)
    u, v = u[on_die], v[on_die]
    nothing, clear = np.full(len(u), np.nan), np.full(len(u), 3.0)
    shape = shaped(gathered(u, v, nothing, clear, {"height": 1.9, "picture": 8.0}))
    assert shape.on_edge_fraction > 0.2
    observed = classify(replace(shape, unmeasured_fraction=0.0))
    assert observed.kind == "edge chip"
    assert observed.reasons[0] == "no height was measured here"


def test_points_across_or_off_the_edge_are_excluded():
    clear_of, across = disc(40.0, 20.0, 5.0), disc(40.0, 0.0, 12.0)
    for u, v, _ in (clear_of, across):
        full = gathered(u, v, np.full(len(u), -2.0), np.full(len(u), 3.0), {"height": 9.0, "picture": 9.0})
        assert shaped(full).on_edge_fraction == 0.0
        assert classify(shaped(full)).kind == "pit"
