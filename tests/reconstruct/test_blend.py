"""One surface from many maps: the ramps of eq. 15-16, wherever the fields lie and whatever they did not see."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from wafer_viewer.model.errors import ComputeError, MeasureError
from wafer_viewer.model.plan import FieldGrid
from wafer_viewer.model.recipe import Recipe
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface import HeightMap, Origin, Provenance
from wafer_viewer.reconstruct.blend import blend_window, stitch
from wafer_viewer.reconstruct.place import layout

MakeMap = Callable[..., HeightMap]
ROWS, COLS, STEP_R, STEP_C = 60, 80, 48, 64


def _plane(height: HeightMap) -> NDArray:
    return 3 + 0.02 * height.x_um[None, :] - 0.05 * height.y_um[:, None]


@pytest.fixture(scope="module")
def grid_of_maps(make_map: MakeMap) -> Callable[..., list[HeightMap]]:
    def make(rows: int, cols: int, jitter_um: float = 0.0, seed: int = 0, noise_um: float = 0.0) -> list[HeightMap]:
        rng = np.random.default_rng(seed)
        maps = []
        for r in range(rows):
            for c in range(cols):
                x, y = np.array([c * STEP_C, -r * STEP_R]) * 0.5 + rng.normal(0, jitter_um, 2)
                blank = make_map(np.zeros((ROWS, COLS)), x, y)
                maps.append(make_map(_plane(blank) + rng.normal(0, noise_um, (ROWS, COLS)), x, y))
        return maps

    return make


def _progressive(maps: list[HeightMap], rows: int, cols: int) -> NDArray:
    """Eq. 15 and 16 word for word: each row of fields along X, then the strips along Y."""

    def append(a: NDArray, b: NDArray, overlap: int) -> NDArray:
        w = np.linspace(1, 0, overlap)
        return np.concatenate([a[:, :-overlap], w * a[:, -overlap:] + (1 - w) * b[:, :overlap], b[:, overlap:]], axis=1)

    strips = []
    for r in range(rows):
        strip = maps[r * cols].z_um.astype(float)
        for c in range(1, cols):
            strip = append(strip, maps[r * cols + c].z_um, COLS - STEP_C)
        strips.append(strip)
    whole = strips[0].T
    for strip in strips[1:]:
        whole = append(whole, strip.T, ROWS - STEP_R)
    return whole.T


def test_a_regular_grid_is_blended_as_the_paper_says(grid_of_maps: Any) -> None:
    maps = grid_of_maps(3, 4, noise_um=5.0)
    np.testing.assert_allclose(stitch(maps).window().z_um, _progressive(maps, 3, 4), atol=2e-4)


def test_the_order_of_the_fields_does_not_matter(grid_of_maps: Any) -> None:
    maps = grid_of_maps(2, 3, jitter_um=1.0, noise_um=1.0)
    forward, back = stitch(maps).window(), stitch(maps[::-1]).window()
    np.testing.assert_allclose(forward.z_um, back.z_um, atol=1e-4)
    np.testing.assert_array_equal(forward.origin, back.origin)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 1000), jitter_um=st.floats(0, 2), lost=st.integers(0, 8))
def test_weights_add_up_to_one_wherever_the_fields_lie(
    grid_of_maps: Any, seed: int, jitter_um: float, lost: int
) -> None:
    maps = grid_of_maps(3, 3, jitter_um=jitter_um, seed=seed)
    del maps[lost]
    whole = stitch(maps).window()
    covered = whole.origin == Origin.MEASURED
    np.testing.assert_allclose(whole.z_um[covered], _plane(whole)[covered], atol=1e-4)
    assert (whole.origin[~covered] == Origin.NOT_COVERED).all()
    assert np.isnan(whole.z_um[~covered]).all()
    assert covered.mean() > 0.8


def test_a_mosaic_of_one_map_is_that_map(make_map: MakeMap) -> None:
    z = np.random.default_rng(1).normal(0, 1, (40, 50))
    z[10:15, 20:30] = np.nan
    one = make_map(z, 7.0, 9.0)
    whole = stitch([one]).window()
    np.testing.assert_array_equal(whole.z_um, one.z_um)
    np.testing.assert_array_equal(whole.origin, one.origin)
    np.testing.assert_array_equal(whole.all_in_focus, one.all_in_focus)
    assert (whole.x0_um, whole.y0_um) == (7.0, 9.0)


def test_what_one_field_did_not_see_comes_from_the_other(make_map: MakeMap) -> None:
    left, right = np.full((40, 60), 1.0), np.full((40, 60), 2.0)
    left[10:20, 45:] = np.nan
    whole = stitch([make_map(left), make_map(right, x0_um=20.0)]).window()
    np.testing.assert_array_equal(whole.z_um[10:20, 45:60], 2.0)
    assert whole.z_um[30, 50] == pytest.approx(1 + (50 - 40) / 19)
    assert np.isfinite(whole.z_um).all()


def test_a_measured_height_beats_a_filled_one_in_either_order(make_map: MakeMap) -> None:
    filled = make_map(np.full((20, 20), 5.0), origin=np.full((20, 20), Origin.FILLED, np.uint8))
    filled = dataclasses.replace(filled, z_raw_um=np.full((20, 20), np.nan, np.float32))
    measured = make_map(np.full((20, 20), 1.0))
    for maps in ([filled, measured], [measured, filled]):
        whole = stitch(maps).window()
        np.testing.assert_array_equal(whole.z_um, 1.0)
        np.testing.assert_array_equal(whole.z_raw_um, 1.0)
        assert (whole.origin == Origin.MEASURED).all()
    alone = stitch([filled, filled]).window()
    assert np.isnan(alone.z_raw_um).all()
    np.testing.assert_array_equal(alone.z_um, 5.0)
    assert (alone.origin == Origin.FILLED).all()


def test_between_pixels_nothing_is_mixed_across_nan_or_a_step(make_map: MakeMap) -> None:
    z = np.zeros((40, 60))
    z[:, 30:] = 50
    z[20:25, 10:20] = np.nan
    whole = stitch([make_map(z), make_map(z, x0_um=10.2, y0_um=-0.1)]).window()
    only_second = whole.z_um[:, 62:]
    heights = only_second[np.isfinite(only_second)]
    assert heights.size > 100
    assert np.minimum(np.abs(heights), np.abs(heights - 50)).max() < 1e-4


def test_a_window_is_the_same_part_of_the_whole(grid_of_maps: Any) -> None:
    mosaic = stitch(grid_of_maps(3, 3, jitter_um=1.0, noise_um=1.0))
    whole = mosaic.window()
    part = mosaic.window(Region.rectangle(20.0, -20.0, 60.0, -50.0))
    row, col = round((whole.y0_um - part.y0_um) / 0.5), round((part.x0_um - whole.x0_um) / 0.5)
    same = whole.z_um[row : row + part.shape[0], col : col + part.shape[1]]
    np.testing.assert_array_equal(part.z_um, same)
    assert part.x0_um <= 20.0 + 0.25
    assert part.bounds_um[2] >= 60.0 - 0.25


def test_shards_put_together_are_the_whole(grid_of_maps: Any) -> None:
    maps = grid_of_maps(2, 2, jitter_um=1.0)
    lattice = layout(maps)
    whole = stitch(maps).window()
    rows, cols = lattice.shape
    for r in range(0, rows, 50):
        for c in range(0, cols, 50):
            part = slice(r, min(r + 50, rows)), slice(c, min(c + 50, cols))
            np.testing.assert_array_equal(blend_window(maps, *part).z_um, whole.z_um[part])


def test_a_window_looks_only_at_the_fields_it_touches(grid_of_maps: Any) -> None:
    maps = grid_of_maps(2, 4)
    lattice, looked_at = layout(maps), set()

    class Watched(list[HeightMap]):
        def __getitem__(self, n: Any) -> Any:
            looked_at.add(n)
            return super().__getitem__(n)

    blend_window(Watched(maps), slice(0, 30), slice(0, 40), lattice)
    assert looked_at == {0}


def test_a_coarser_level_is_the_mean_of_what_was_measured(make_map: MakeMap, grid_of_maps: Any) -> None:
    maps = [make_map(np.random.default_rng(n).normal(0, 1, (400, 500)), n * 200.0, 0.0) for n in range(3)]
    mosaic = stitch(maps)
    assert mosaic.levels == 3
    fine, coarse = mosaic.window(), mosaic.window(level=1)
    rows, cols = coarse.shape
    np.testing.assert_allclose(
        coarse.z_um, fine.z_um[: 2 * rows, : 2 * cols].reshape(rows, 2, cols, 2).mean(axis=(1, 3)), atol=1e-5
    )
    assert coarse.pixel_um == 1.0
    assert coarse.x0_um == fine.x0_um + 0.25
    region = Region.rectangle(100.0, -20.0, 300.0, -80.0)
    part = mosaic.window(region, level=2)
    whole = mosaic.window(level=2)
    row, col = round((whole.y0_um - part.y0_um) / 2), round((part.x0_um - whole.x0_um) / 2)
    np.testing.assert_array_equal(part.z_um, whole.z_um[row : row + part.shape[0], col : col + part.shape[1]])


def test_fields_say_where_the_maps_lie(make_map: MakeMap) -> None:
    grid = FieldGrid(rows=1, cols=2, field_width_um=30.0, field_height_um=20.0, overlap_x_fraction=0.2)
    maps = [make_map(np.full((40, 60), float(n)), x0_um=999.0) for n in range(2)]
    mosaic = stitch(maps, grid.fields())
    assert mosaic.shape == (40, 60 + 48)
    assert mosaic.window().x_um[:60].mean() == pytest.approx(0.0)
    with pytest.raises(ComputeError, match="2 height maps and 1 fields"):
        stitch(maps, grid.fields()[:1])


def test_a_mosaic_of_a_simulated_field_is_simulated(make_map: MakeMap) -> None:
    real = make_map(np.zeros((20, 20)))
    virtual = make_map(np.zeros((20, 20)), x0_um=8.0, provenance=Provenance(simulated=True, z_step_um=4.0))
    assert stitch([real, virtual]).provenance.simulated
    assert stitch([real, virtual]).window().provenance.simulated
    assert not stitch([real, real]).provenance.simulated


def test_what_cannot_be_stitched_is_said(make_map: MakeMap) -> None:
    with pytest.raises(ComputeError, match="no field to stitch"):
        stitch([], recipe=Recipe())
    with pytest.raises(ComputeError, match=r"0\.5 and of 0\.6 um a pixel"):
        stitch([make_map(np.zeros((9, 9))), make_map(np.zeros((9, 9)), pixel_um=0.6)])
    mosaic = stitch([make_map(np.zeros((9, 9)))])
    with pytest.raises(MeasureError, match="level 7"):
        mosaic.window(level=7)
    with pytest.raises(MeasureError, match="outside"):
        mosaic.window(Region.rectangle(500.0, 500.0, 600.0, 600.0))
