"""One surface from many maps: the ramps of eq. 15-16, wherever the fields lie and whatever they did not see."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.support.campaigns import examples
from wafer_viewer.model.errors import ComputeError, MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.field_poses import Form, Poses, no_seams, no_shifts
from wafer_viewer.model.surface.height_map import HeightMap, Origin, Provenance
from wafer_viewer.model.surface.recipe import Recipe, Stitching
from wafer_viewer.reconstruct.blending.mosaic_layout import MARGIN_PX, layout, planned_lattice
from wafer_viewer.reconstruct.blending.stitched_mosaic import StitchedMosaic, blend_window, mosaic_provenance
from wafer_viewer.reconstruct.blending.window_blend import BLENDS

MakeMap = Callable[..., HeightMap]
ROWS, COLS, STEP_R, STEP_C = 60, 80, 48, 64


def stitched(maps: list[HeightMap], blend: str = "ramp", poses: Poses | None = None) -> StitchedMosaic:
    recipe = Recipe(stitching=Stitching(poses="stage", blend=blend))
    return StitchedMosaic(maps, layout(maps, poses), mosaic_provenance([m.provenance for m in maps], recipe))


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
    full = strips[0].T
    for strip in strips[1:]:
        full = append(full, strip.T, ROWS - STEP_R)
    return full.T


def test_a_regular_grid_is_blended_as_the_paper_says(grid_of_maps: Any) -> None:
    maps = grid_of_maps(3, 4, noise_um=5.0)
    np.testing.assert_allclose(stitched(maps).window().z_um, _progressive(maps, 3, 4), atol=2e-4)


@pytest.mark.parametrize("blend", BLENDS)
def test_the_order_of_the_fields_does_not_matter(grid_of_maps: Any, blend: str) -> None:
    maps = grid_of_maps(2, 3, jitter_um=1.0, noise_um=1.0)
    forward, back = stitched(maps, blend).window(), stitched(maps[::-1], blend).window()
    for name in ("z_um", "z_raw_um", "confidence", "overlap_um"):
        np.testing.assert_allclose(getattr(forward, name), getattr(back, name), atol=1e-4, err_msg=name)
    np.testing.assert_array_equal(forward.origin, back.origin)


@settings(max_examples=examples(15))
@given(
    seed=st.integers(0, 1000), jitter_um=st.floats(0, 2), lost=st.integers(0, 8), blend=st.sampled_from(sorted(BLENDS))
)
def test_weights_add_up_to_one_wherever_the_fields_lie(
    grid_of_maps: Any, seed: int, jitter_um: float, lost: int, blend: str
) -> None:
    maps = grid_of_maps(3, 3, jitter_um=jitter_um, seed=seed)
    del maps[lost]
    full = stitched(maps, blend).window()
    covered = full.origin == Origin.MEASURED
    np.testing.assert_allclose(full.z_um[covered], _plane(full)[covered], atol=1e-4)
    assert (full.origin[~covered] == Origin.NOT_COVERED).all()
    assert np.isnan(full.z_um[~covered]).all()
    assert covered.mean() > 0.75


def test_a_mosaic_of_one_map_is_that_map(make_map: MakeMap) -> None:
    z = np.random.default_rng(1).normal(0, 1, (40, 50))
    z[10:15, 20:30] = np.nan
    one = make_map(z, 7.0, 9.0)
    full = stitched([one]).window()
    np.testing.assert_array_equal(full.z_um, one.z_um)
    np.testing.assert_array_equal(full.origin, one.origin)
    np.testing.assert_array_equal(full.all_in_focus, one.all_in_focus)
    assert (full.x0_um, full.y0_um) == (7.0, 9.0)


def test_gaps_of_one_field_are_filled_by_the_other(make_map: MakeMap) -> None:
    left, right = np.full((40, 60), 1.0), np.full((40, 60), 2.0)
    left[10:20, 45:] = np.nan
    full = stitched([make_map(left), make_map(right, x0_um=20.0)]).window()
    np.testing.assert_array_equal(full.z_um[10:20, 45:60], 2.0)
    assert full.z_um[30, 50] == pytest.approx(1 + (50 - 40) / 19)
    assert np.isfinite(full.z_um).all()


def test_a_measured_height_beats_a_filled_one_in_either_order(make_map: MakeMap) -> None:
    filled = make_map(np.full((20, 20), 5.0), origin=np.full((20, 20), Origin.FILLED, np.uint8))
    filled = dataclasses.replace(filled, z_raw_um=np.full((20, 20), np.nan, np.float32))
    measured = make_map(np.full((20, 20), 1.0))
    for maps, blend in itertools.product(([filled, measured], [measured, filled]), BLENDS):
        full = stitched(maps, blend).window()
        np.testing.assert_array_equal(full.z_um, 1.0)
        np.testing.assert_array_equal(full.z_raw_um, 1.0)
        assert (full.origin == Origin.MEASURED).all()
    alone = stitched([filled, filled]).window()
    assert np.isnan(alone.z_raw_um).all()
    np.testing.assert_array_equal(alone.z_um, 5.0)
    assert (alone.origin == Origin.FILLED).all()


def test_between_pixels_nothing_is_mixed_across_nan_or_a_step(make_map: MakeMap) -> None:
    z = np.zeros((40, 60))
    z[:, 30:] = 50
    z[20:25, 10:20] = np.nan
    full = stitched([make_map(z), make_map(z, x0_um=10.2, y0_um=-0.1)]).window()
    only_second = full.z_um[:, 62:]
    heights = only_second[np.isfinite(only_second)]
    assert heights.size > 100
    assert np.minimum(np.abs(heights), np.abs(heights - 50)).max() < 1e-4


def test_a_window_is_the_same_part_of_the_whole(grid_of_maps: Any) -> None:
    mosaic = stitched(grid_of_maps(3, 3, jitter_um=1.0, noise_um=1.0))
    full = mosaic.window()
    part = mosaic.window(Region.rectangle(20.0, -20.0, 60.0, -50.0))
    row, col = round((full.y0_um - part.y0_um) / 0.5), round((part.x0_um - full.x0_um) / 0.5)
    same = full.z_um[row : row + part.shape[0], col : col + part.shape[1]]
    np.testing.assert_array_equal(part.z_um, same)
    assert part.x0_um <= 20.0 + 0.25
    assert part.bounds_um[2] >= 60.0 - 0.25


def test_shards_put_together_are_the_whole(grid_of_maps: Any) -> None:
    maps = grid_of_maps(2, 2, jitter_um=1.0)
    lattice = layout(maps)
    full = stitched(maps, "confidence").window()
    rows, cols = lattice.shape
    for r in range(0, rows, 50):
        for c in range(0, cols, 50):
            part = slice(r, min(r + 50, rows)), slice(c, min(c + 50, cols))
            np.testing.assert_array_equal(blend_window(maps, *part).z_um, full.z_um[part])


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
    mosaic = stitched(maps)
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
    full = mosaic.window(level=2)
    row, col = round((full.y0_um - part.y0_um) / 2), round((part.x0_um - full.x0_um) / 2)
    np.testing.assert_array_equal(part.z_um, full.z_um[row : row + part.shape[0], col : col + part.shape[1]])


def test_a_mosaic_of_a_simulated_field_is_simulated(make_map: MakeMap) -> None:
    real = make_map(np.zeros((20, 20)))
    virtual = make_map(np.zeros((20, 20)), x0_um=8.0, provenance=Provenance(simulated=True, z_step_um=4.0))
    assert stitched([real, virtual]).provenance.simulated
    assert stitched([real, virtual]).window().provenance.simulated
    assert not stitched([real, real]).provenance.simulated


def test_what_cannot_be_stitched_is_reported(make_map: MakeMap) -> None:
    with pytest.raises(ComputeError, match="no field to stitch"):
        stitched([])
    with pytest.raises(ComputeError, match=r"0\.5 and of 0\.6 um per pixel"):
        stitched([make_map(np.zeros((9, 9))), make_map(np.zeros((9, 9)), pixel_um=0.6)])
    mosaic = stitched([make_map(np.zeros((9, 9)))])
    with pytest.raises(MeasureError, match="level 7"):
        mosaic.window(level=7)
    with pytest.raises(MeasureError, match="outside"):
        mosaic.window(Region.rectangle(500.0, 500.0, 600.0, 600.0))


# ---------------------------------------------------------------------------------------------- solved poses


def solved(maps: list[HeightMap], **changes: Any) -> Poses:
    """Poses of maps, where they are by their own word but for some changes."""
    n = len(maps)
    x_um = np.array([m.x_um.mean() for m in maps])
    y_um = np.array([m.y_um.mean() for m in maps])
    zero = np.zeros(n)
    at: dict[str, Any] = {"stage_x_um": x_um, "stage_y_um": y_um, "x_um": x_um, "y_um": y_um}
    at |= dict.fromkeys(("z_um", "tilt_x", "tilt_y", "u_x_um", "u_y_um", "u_z_um"), zero)
    at |= {"numbers": np.arange(1, n + 1, dtype=np.int32), "marks": np.zeros(n, np.int64)}
    at |= {"group": np.zeros(n, np.int32), "left_out": np.zeros(n, bool)}
    return Poses(**{**at, "shifts": no_shifts(), "seams": no_seams(), **changes})


@pytest.mark.parametrize("blend", BLENDS)
def test_fields_are_drawn_where_they_lie_and_upright(grid_of_maps: Any, blend: str) -> None:
    rng = np.random.default_rng(4)
    maps = grid_of_maps(3, 3, jitter_um=1.0)
    form = Form(field_form_um=(0.7, -0.3, 0.4), field_size_um=(COLS * 0.5, ROWS * 0.5))
    true = solved(
        maps, z_um=rng.normal(0, 2, 9), tilt_x=rng.normal(0, 0.01, 9), tilt_y=rng.normal(0, 0.01, 9), form=form
    )
    observed = [lying(m, true, n) for n, m in enumerate(maps)]
    moved = [dataclasses.replace(m, x0_um=m.x0_um + 3.3, y0_um=m.y0_um - 1.7) for m in observed]
    full = stitched(moved, blend, true).window()
    covered = full.origin == Origin.MEASURED
    assert covered.mean() > 0.9
    np.testing.assert_allclose(full.z_um[covered], _plane(full)[covered], atol=1e-3)
    np.testing.assert_allclose(full.z_raw_um[covered], _plane(full)[covered], atol=1e-3)
    assert np.nanmax(full.overlap_um) < 2e-3


def lying(height: HeightMap, poses: Poses, n: int) -> HeightMap:
    """The map as a field that leans sees it."""
    dx, dy = height.x_um[None, :] - poses.x_um[n], height.y_um[:, None] - poses.y_um[n]
    off = poses.z_um[n] + poses.tilt_x[n] * dx + poses.tilt_y[n] * dy + poses.form.sag_um(dx, dy)
    z = (height.z_um + off).astype(np.float32)
    return dataclasses.replace(height, z_um=z, z_raw_um=z.copy())


def test_a_field_that_is_left_out_is_not_there(grid_of_maps: Any) -> None:
    maps = grid_of_maps(1, 3)
    out = np.array([False, False, True])
    mosaic = stitched(maps, poses=solved(maps, left_out=out))
    assert mosaic.shape == (ROWS, STEP_C + COLS)
    assert mosaic.layout.place(2) is None
    assert mosaic.layout.window_of(2) is None
    assert mosaic.layout.window_of(1) == (slice(0, ROWS), slice(STEP_C, STEP_C + COLS))
    with pytest.raises(ComputeError, match="All fields are left out"):
        layout(maps, solved(maps, left_out=~(out & ~out)))
    with pytest.raises(ComputeError, match="2 fields and 3 poses"):
        layout(maps[:2], solved(maps))


def test_a_planned_lattice_has_room_and_does_not_move(grid_of_maps: Any) -> None:
    maps = grid_of_maps(2, 2)
    lattice = planned_lattice(maps)
    assert lattice.shape == (ROWS + STEP_R + 2 * MARGIN_PX, COLS + STEP_C + 2 * MARGIN_PX)
    away = solved(maps[:3], x_um=solved(maps[:3]).x_um - 15.0)
    placed = layout(maps[:3], away, lattice)
    assert placed.lattice == lattice
    full = StitchedMosaic(maps[:3], placed, maps[0].provenance).window()
    assert np.flatnonzero((full.origin == Origin.MEASURED).any(axis=0))[0] == 2
    beyond = layout(maps[:3], solved(maps[:3], x_um=away.x_um - 5.0), lattice)
    assert beyond.window_of(0)[1].start == 0


def test_where_nothing_is_covered_the_picture_is_of_the_same_kind(make_map: MakeMap) -> None:
    deep = make_map(np.zeros((20, 20)), all_in_focus=np.full((20, 20), 3000, np.uint16))
    full = StitchedMosaic([deep], layout([deep], None, planned_lattice([deep])), deep.provenance)
    corner = full.window(Region.rectangle(full.x0_um, full.y0_um, full.x0_um, full.y0_um))
    assert (corner.all_in_focus.dtype, corner.origin.item()) == (np.uint16, Origin.NOT_COVERED)
    assert full.window().all_in_focus.max() == 3000


# ---------------------------------------------------------------------------------------------- overlaps


def pair(make_map: MakeMap, left: NDArray, right: NDArray, **changes: Any) -> list[HeightMap]:
    """Two maps, the second 20 pixels further right."""
    return [make_map(left, **changes), make_map(right, x0_um=10.0, **changes)]


def test_the_better_measured_height_wins(make_map: MakeMap) -> None:
    sure, unsure = pair(make_map, np.full((40, 60), 1.0), np.full((40, 60), 2.0))
    unsure = dataclasses.replace(unsure, confidence=np.full((40, 60), 0.1, np.float32))
    believed = stitched([sure, unsure], "confidence").window().z_um[:, 20:60]
    by_ramp = stitched([sure, unsure]).window().z_um[:, 20:60]
    assert believed[:, 5:25].max() < 1.05
    assert by_ramp[0, 20] == pytest.approx(1.5, abs=0.05)


def test_no_step_is_seen_where_fields_begin_and_end(make_map: MakeMap) -> None:
    for blend in BLENDS:
        full = stitched(pair(make_map, np.full((40, 60), 1.0), np.full((40, 60), 2.0)), blend).window()
        assert np.abs(np.diff(full.z_um, axis=1)).max() < 0.15
        assert (full.z_um[:, 20] < 1.001).all()
        assert (full.z_um[:, 59] > 1.999).all()


def test_of_two_heights_far_apart_one_is_taken_not_the_middle(make_map: MakeMap) -> None:
    right = np.zeros((40, 60))
    right[:, 15:] = 50  # it has the edge of the step five pixels too far left
    left = np.zeros((40, 60))
    left[:, 40:] = 50
    z = stitched(pair(make_map, left, right), "confidence").window().z_um
    assert np.minimum(np.abs(z), np.abs(z - 50)).max() < 1e-3
    mixed = stitched(pair(make_map, left, right)).window().z_um[:, 35:40]
    assert (np.abs(mixed - 25) < 15).all()


def test_an_isolated_false_height_gets_little_weight(make_map: MakeMap) -> None:
    rng = np.random.default_rng(3)
    left, right = np.zeros((40, 60)), np.zeros((40, 60))
    for z in (left, right):
        z[rng.integers(2, 38, 8), rng.integers(24, 36, 8)] = 30.0
    left[:, :20], right[:, 40:] = 0, 0
    z = stitched(pair(make_map, left, right), "confidence").window().z_um
    assert np.abs(z[:, 24:56]).max() < 0.5


def test_differences_of_overlaps_are_those_of_what_was_measured(make_map: MakeMap) -> None:
    rng = np.random.default_rng(5)
    maps = [make_map(rng.normal(0, 1, (40, 60)), x, y) for x, y in ((0.0, 0.0), (10.0, 0.0), (0.0, -5.0), (10.0, -5.0))]
    maps[1].z_raw_um[5:8, 3:9] = np.nan
    maps[1].origin[5:8, 3:9] = Origin.FILLED
    raw = np.full((4, 50, 80), np.nan, np.float32)
    for n, (row, col) in enumerate(((0, 0), (0, 20), (10, 0), (10, 20))):
        raw[n, row : row + 40, col : col + 60] = maps[n].z_raw_um
    for blend in BLENDS:
        found = stitched(maps, blend).window().overlap_um
        observed = np.isfinite(raw).sum(axis=0)
        assert (np.isfinite(found) == (observed >= 2)).all()
        span = np.nanmax(raw[:, observed >= 2], axis=0) - np.nanmin(raw[:, observed >= 2], axis=0)
        np.testing.assert_allclose(found[observed >= 2], span, atol=1e-6)


def test_uncertainties_are_averaged_with_the_weights_of_their_heights(make_map: MakeMap) -> None:
    maps = [make_map(np.full((40, 60), z), x, u_um=np.full((40, 60), u, np.float32)) for z, x, u in
            ((1.0, 0.0, 0.1), (2.0, 10.0, 0.5))]  # fmt: skip
    for blend in BLENDS:
        window = stitched(maps, blend).window()
        share = window.z_raw_um - 1
        assert ((share > 0.1) & (share < 0.9)).any()
        np.testing.assert_allclose(window.u_um, 0.1 + 0.4 * share, atol=1e-5)


def test_a_field_without_uncertainties_leaves_them_unknown(make_map: MakeMap) -> None:
    known = make_map(np.zeros((40, 60)), 0.0, u_um=np.full((40, 60), 0.1, np.float32))
    known.z_raw_um[5, 5] = np.nan
    found = stitched([known, make_map(np.zeros((40, 60)), 10.0)]).window().u_um
    assert found is not None
    assert np.isnan(found[:, 21:]).all()
    assert np.isfinite(np.delete(found[:, :19].ravel(), 5 * 19 + 5)).all()
    assert np.isnan(found[5, 5]), "no height, no uncertainty"


def test_brightness_changes_without_a_line(make_map: MakeMap) -> None:
    dark, light = (
        make_map(np.zeros((40, 90)), x, all_in_focus=np.full((40, 90), g, np.uint8))
        for x, g in ((0.0, 90), (15.0, 120))
    )
    grey = stitched([dark, light], "confidence").window().all_in_focus.astype(int)
    assert np.abs(np.diff(grey, axis=1)).max() <= 1
    assert (grey[:, 0].max(), grey[:, -1].min()) == (90, 120)


def test_fields_that_lie_like_bricks_have_no_hard_seam(make_map: MakeMap) -> None:
    above, left, right = (
        make_map(np.full((60, 80), z), x, y) for z, x, y in ((0.0, 0.0, 0.0), (1.0, -21.0, -24.0), (1.0, 15.0, -24.0))
    )
    z = stitched([above, left, right], "confidence").window().z_um
    assert np.nanmax(np.abs(np.diff(z, axis=0))) < 0.4
