"""The simulated grid against its own word: what it makes is what stitching is judged by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import shift

from tests.truth.endless_wafer import Lattice, Wafer, look
from tests.truth.field_grid import PIXEL_UM, SMALL, Grid, make, simulated, truth_of
from wafer_viewer.model.surface.height_map import HeightMap, Origin

ONE = replace(SMALL, rows=1, cols=2, noise_um=0.0, false_fraction=0.0, gap_fraction=0.0, shiver_px=0.0)


def field(grid: Grid, n: int) -> HeightMap:
    return simulated(truth_of(grid), grid.plan.fields()[n], n)


def true_surface(grid: Grid, n: int) -> np.ndarray:
    """What a field should see, of the wafer alone."""
    truth = truth_of(grid)
    up, left = (grid.field_rows - 1) / 2 * PIXEL_UM, (grid.field_cols - 1) / 2 * PIXEL_UM
    first = float(truth.x_um[n] - left), float(truth.y_um[n] + up)
    return look(truth.wafer, Lattice((grid.field_rows, grid.field_cols), first, (PIXEL_UM, 0.0), (0.0, -PIXEL_UM)))[0]


@pytest.fixture(scope="module")
def made():
    grid = make(SMALL)
    yield grid
    grid.remove()


def test_a_field_without_noise_is_the_wafer_at_its_true_place_leaning_as_told():
    grid = replace(ONE, bow_um=3.0)
    truth = truth_of(grid)
    lean = field(grid, 1).z_um - true_surface(grid, 1)
    across = (grid.field_cols - 1) / 2 * PIXEL_UM
    assert lean.mean() == pytest.approx(truth.z_um[1], abs=1e-4)
    assert (lean[:, -1] - lean[:, 0]).mean() == pytest.approx(2 * truth.tilt_x[1] * across, abs=1e-4)
    assert lean.std() < 0.05


def test_the_surface_between_pixels_is_the_surface_on_a_finer_lattice():
    coarse, fine = (
        look(Wafer(), Lattice((rows, 40), (3.0, 5.0), (0.4, 0.0), (0.0, down)))
        for rows, down in ((20, -0.4), (39, -0.2))
    )
    for one, other in zip(coarse, fine, strict=True):
        np.testing.assert_allclose(one, other[::2], rtol=1e-5, atol=1e-5)


def test_the_camera_turns_the_way_it_says():
    grid = replace(ONE, camera_turn=0.01, stage_error_px=0.0, tilt_error=0.0, z_error_um=0.0)
    right = look(Wafer(), Lattice((1, 1), _place(grid, 0, 179.5, 0.5), (1.0, 0.0), (0.0, 1.0)))[0]
    assert field(grid, 0).z_um[134, -1] == pytest.approx(float(right[0, 0]), abs=1e-3)


def _place(grid: Grid, n: int, right_px: float, up_px: float) -> tuple[float, float]:
    """Where a point of a field lies whose camera is turned anticlockwise."""
    at, turn = grid.plan.fields()[n], grid.camera_turn
    right, up = right_px * PIXEL_UM, up_px * PIXEL_UM
    return at.x_um + right * np.cos(turn) - up * np.sin(turn), at.y_um + right * np.sin(turn) + up * np.cos(turn)


def test_neighbours_agree_where_they_overlap():
    grid = replace(ONE, stage_error_px=0.0)
    first, second = field(grid, 0), field(grid, 1)
    cols = (second.x0_um - first.x0_um) / PIXEL_UM
    part = int(np.ceil(cols))
    moved = shift(second.all_in_focus.astype(float), (0, cols - part), order=3)
    a, b = first.all_in_focus[5:-5, part + 5 :].astype(float), moved[5:-5, 5 : 360 - part]
    assert np.corrcoef(a.ravel(), b.ravel())[0, 1] > 0.9


def test_noise_gaps_and_confidence_are_those_requested(made):
    heights, known = made.heights[4], made.known
    error = heights.z_um - true_surface(SMALL, 4) - known.z_um[4]
    sure, unsure = heights.confidence > 0.6, heights.measured & (heights.confidence < 0.2)
    assert np.nanmedian(np.abs(error[unsure])) > 3 * np.nanmedian(np.abs(error[sure & heights.measured]))
    assert np.isnan(heights.z_raw_um).mean() == pytest.approx(SMALL.gap_fraction, abs=0.02)
    np.testing.assert_array_equal(np.isnan(heights.z_um), heights.origin >= Origin.NOT_COVERED)
    assert heights.confidence[[0, -1]].mean() < 0.7 * heights.confidence[100:-100, 100:-100].mean()
    assert heights.confidence.min() > 0
    assert heights.confidence.max() <= 1


def test_what_is_kept_is_what_is_made(made):
    again = field(SMALL, 7)
    for name in ("z_um", "z_raw_um", "confidence", "all_in_focus", "origin"):
        np.testing.assert_array_equal(getattr(again, name), getattr(made.heights[7], name))
    assert (again.x0_um, again.y0_um) == (made.heights[7].x0_um, made.heights[7].y0_um)
    assert len(make(SMALL).fields) == 12


def test_the_truth_is_the_surface_the_fields_saw(made):
    at = made.truth(-30.0, 20.0, (50, 60))
    assert at.shape == (50, 60)
    assert float(at[0, 0]) == pytest.approx(float(made.truth(-30.0, 20.0, (1, 1))[0, 0]), abs=1e-5)


def test_stage_errors_are_as_wide_as_requested():
    truth = truth_of(Grid())
    stage = Grid().plan.fields()
    off = np.concatenate([truth.x_um - [f.x_um for f in stage], truth.y_um - [f.y_um for f in stage]]) / PIXEL_UM
    assert off.std() == pytest.approx(6.0, rel=0.1)
    assert len(Grid().edges) == 387


def test_blank_and_wrong_overlaps():
    grid = replace(SMALL, blank_fraction=0.2, wrong_fraction=0.1)
    truth = truth_of(grid)
    assert (truth.blank.sum(), truth.wrong.sum()) == (4, 2)
    first, second = grid.edges[truth.blank][0]
    neighbour = second == first + 1
    strip = (
        field(grid, int(first)).all_in_focus[60:-60, -40:] if neighbour else field(grid, int(first)).all_in_focus[-30:]
    )
    assert strip[:, 60:-60].std() < 4 if not neighbour else strip.std() < 4
    wrong = int(grid.edges[truth.wrong][0, 1])
    plain = replace(grid, wrong_fraction=0.0)
    assert np.mean(field(grid, wrong).all_in_focus != field(plain, wrong).all_in_focus) > 0.05


def test_odd_fields():
    grid = replace(SMALL, turned=(0,), mirrored=(1,), foreign=(2,), empty=(3,))
    np.testing.assert_array_equal(field(grid, 0).z_um, field(SMALL, 0).z_um[::-1, ::-1])
    np.testing.assert_array_equal(field(grid, 1).all_in_focus, field(SMALL, 1).all_in_focus[:, ::-1])
    assert np.corrcoef(field(grid, 2).all_in_focus.ravel(), field(SMALL, 2).all_in_focus.ravel())[0, 1] < 0.9
    assert np.isnan(field(grid, 3).z_um).all()
