"""Fields that changed places among equal dies are named by the stage's small errors; other fields never are."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.bench.bench_grids import swap_nats
from tests.truth.drawn_grids import PIXEL_UM, DrawnGrid, MadeGrid, drawn, made
from wafer_viewer.reconstruct.registration.swap_search import StageDeviations
from wafer_viewer.reconstruct.stitching import stitch

A, B = 6, 13
SWAPPED = ((A, "swapped"), (B, "swapped"))


def dies(stage_px: float, misfits: tuple[tuple[int, str], ...] = ()) -> DrawnGrid:
    grid = dataclasses.replace(drawn(409), rows=4, cols=5, shape=(130, 160), overlap=0.2, pitch_px=(23.0, 23.0))
    quiet = dataclasses.replace(grid, stage_px=stage_px, backlash_px=0.0, drift_px=0.0, turn=0.0, scale=0.0)
    return dataclasses.replace(quiet, missing=(), misfits=misfits, blank=0.0, dust=0.0, noise=2.0)


def left_out(grid: MadeGrid) -> set[int]:
    return set(np.flatnonzero(stitch(grid.heights).poses.left_out).tolist())


@pytest.mark.slow
def test_swapped_fields_among_equal_dies_are_named():
    grid = made(dies(1.0, SWAPPED))
    assert swap_nats(grid) > 30
    poses = stitch(grid.heights).poses
    assert set(np.flatnonzero(poses.left_out).tolist()) == {A, B}
    assert any(f"Fields {A + 1} and {B + 1} are swapped" in note for note in poses.notes)


def test_nobody_is_accused_where_the_stage_errs_by_a_fifth_of_the_pitch():
    grid = made(dies(4.2, SWAPPED))
    assert swap_nats(grid) < 10
    assert left_out(grid) == set()


@pytest.mark.parametrize("off_px", [(8.0, 0.0), (-7.0, 9.0)], ids=str)
def test_fields_that_the_stage_has_far_off_are_not_swapped(off_px: tuple[float, float]):
    """Two fields far off, each alone: neither fits where the other lies."""
    grid = made(dies(1.0))
    moved = list(grid.heights)
    for n, sign in ((A, 1.0), (B, 0.4)):
        x_um, y_um = (sign * off * PIXEL_UM for off in off_px)
        moved[n] = dataclasses.replace(moved[n], x0_um=moved[n].x0_um + x_um, y0_um=moved[n].y0_um + y_um)
    assert left_out(dataclasses.replace(grid, heights=tuple(moved))) == set()


def test_a_scatter_known_from_few_fields_makes_a_deviation_less_odd():
    def of(n_fields: int) -> StageDeviations:
        nothing = np.zeros((n_fields, 2))
        return StageDeviations(nothing, nothing, np.array([2.0, 4.0]), np.ones(n_fields, bool))

    many = of(400)
    assert many.chi2(3, np.array([[6.0, 0.0], [0.0, 4.0]])) == pytest.approx([9.0, 1.0])
    assert many.cost_nats(np.array([9.0]))[0] == pytest.approx(4.5, rel=0.03)
    assert of(12).cost_nats(np.array([30.0]))[0] < 0.6 * many.cost_nats(np.array([30.0]))[0]
