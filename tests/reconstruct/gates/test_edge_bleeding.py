"""Beside walls: what bled over an edge is left out and named, and the rims of dies come out that were drowned."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.bench.recipes import MEASURES
from tests.bench.unseen_scenes import judge_scene
from tests.support.campaigns import drawn_after
from tests.truth.layouts import Layout, Taken, take
from tests.truth.unseen import drawn_scene
from tests.truth.views import Optics
from wafer_viewer.measure.truth_comparison import quality
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.spec import replace as changed
from wafer_viewer.model.surface.height_map import HeightMap, Origin
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.reconstruct.focus.log_laplacian import Stabiliser
from wafer_viewer.reconstruct.focus_evidence import focus_curve
from wafer_viewer.reconstruct.gates.edge_bleeding import BleedingEdges, judge_edges
from wafer_viewer.reconstruct.gates.edge_sides import (
    BAND_REACH_PX,
    EdgeSide,
    Surroundings,
    classify_sides,
    find_band,
    heights_near,
    surroundings,
)
from wafer_viewer.reconstruct.gates.focus_along_walls import (
    Near,
    Tile,
    Wall,
    noise_fall,
    peaks_near,
    side_heights_um,
    tangential_levels,
    tangential_margin_px,
)
from wafer_viewer.reconstruct.gates.silhouettes import Silhouette, silhouette_of
from wafer_viewer.reconstruct.preprocess.camera_noise import CameraNoise
from wafer_viewer.reconstruct.preprocess.frames import prepare

MakeStack = Callable[..., FieldStack]

STEP_UM = 4.0
Z_UM = np.linspace(80.0, 252.0, 44)
SHAPE = (144, 168)
NEAR_WALL_PX = 24.0
DIES = Layout(
    "small",
    Optics(0.28, views=80),
    5,
    settings={"pitch_px": 150.0, "trench_px": 52.0, "bare_share": 0.0, "die_contrast": 0.18},
)
POLISHED = Layout(
    "polished",
    Optics(0.28, views=100),
    7,
    scene="rim",
    settings={"pitch_px": 170.0, "trench_px": 40.0, "bare_share": 0.0, "die_contrast": 0.4},
)
REVERSED = replace(DIES, settings={**DIES.settings, "die_grey": 0.6, "trench_grey": 0.1})
RECIPE = Recipe(focus_measure="log_laplacian", window=9, focus_width_um=8.0)
CAMERA = CameraNoise(0.5, 80.0)


@pytest.fixture(scope="module")
def dies() -> Taken:
    return take(DIES, SHAPE, Z_UM)


@pytest.fixture(scope="module")
def mapped(dies: Taken) -> dict[str, HeightMap]:
    """The map of the dies in every mode; "none" without any evidence but the peaks' own."""
    return {mode: made(dies.stack, mode) for mode in ("band", "rims")} | {"none": by_peaks(dies.stack)}


def made(stack: FieldStack, mode: str, **changes: object) -> HeightMap:
    return reconstruct(stack, changed(RECIPE, edges=mode, **changes), threads=1)


def by_peaks(stack: FieldStack, **changes: object) -> HeightMap:
    """The map by the gates of single peaks alone."""
    return made(stack, "none", least_probability=0.0, **changes)


def kept_and_false(height: HeightMap, taken: Taken, where: NDArray[np.bool_] | None = None) -> tuple[float, float]:
    """The share of pixels that have a measured height, and of these the share that is more than a step off."""
    where = np.ones(height.shape, bool) if where is None else where
    stored = np.isfinite(height.z_raw_um) & where
    false = stored & (np.abs(height.z_raw_um - taken.scene.truth_um) > STEP_UM)
    return float(stored.sum() / where.sum()), float(false.sum() / max(1, stored.sum()))


def rims_of(taken: Taken) -> NDArray[np.bool_]:
    """The textured rims of the dies."""
    return taken.scene.edge & taken.scene.textured & (taken.scene.layer == 1)


@pytest.mark.campaign
def test_hardly_a_kept_height_is_false(dies: Taken, mapped: dict[str, HeightMap]) -> None:
    none, band, rims = (kept_and_false(mapped[mode], dies) for mode in ("none", "band", "rims"))
    assert none[1] > 0.005
    assert band[1] < 0.003
    assert rims[1] < 0.003
    assert rims[0] > band[0] + 0.03


@pytest.mark.slow
def test_the_rims_of_the_dies_come_back(dies: Taken, mapped: dict[str, HeightMap]) -> None:
    rims = rims_of(dies)
    assert kept_and_false(mapped["none"], dies, rims)[1] > 0.05
    assert kept_and_false(mapped["band"], dies, rims)[0] < 0.4
    stored, false = kept_and_false(mapped["rims"], dies, rims)
    assert stored > 0.41
    assert false < 0.01


@pytest.mark.slow
def test_the_floor_of_the_trench_stays(dies: Taken, mapped: dict[str, HeightMap]) -> None:
    stored, false = kept_and_false(mapped["rims"], dies, dies.scene.layer == 0)
    assert stored > 0.8
    assert false < 0.01


@pytest.mark.slow
def test_bleeding_is_a_reason_next_to_walls_only(dies: Taken, mapped: dict[str, HeightMap]) -> None:
    bled = mapped["rims"].origin == Origin.BLEEDING_EDGE
    assert 0.01 < bled.mean() < 0.2
    assert dies.scene.edge_distance_px[bled].max() < NEAR_WALL_PX
    assert not (mapped["none"].origin == Origin.BLEEDING_EDGE).any()


@pytest.mark.slow
def test_beyond_the_band_nothing_changes(dies: Taken, mapped: dict[str, HeightMap]) -> None:
    far = dies.scene.edge_distance_px > NEAR_WALL_PX
    by_edges = made(dies.stack, "rims", least_probability=0.0)
    before, after = (one.z_raw_um[far] for one in (mapped["none"], by_edges))
    alike = np.isclose(before, after, equal_nan=True)
    assert alike.mean() > 0.98  # of islands cut by the band the cleaning sees the other part


@pytest.mark.slow
def test_bright_dies_over_a_dark_trench() -> None:
    taken = take(REVERSED, SHAPE, Z_UM)
    before, after = (kept_and_false(one, taken) for one in (by_peaks(taken.stack), made(taken.stack, "rims")))
    assert before[1] > 0.1
    assert after[1] < 0.03
    assert after[0] > 0.66


@pytest.mark.campaign
def test_the_glow_of_a_polished_rim_is_no_surface() -> None:
    taken = take(POLISHED, SHAPE, Z_UM)
    inside = (taken.scene.layer == 1) & ~taken.scene.edge
    before, after = (kept_and_false(one, taken, inside) for one in (by_peaks(taken.stack), made(taken.stack, "rims")))
    assert before[1] > 0.02
    assert after[1] < 0.002
    assert after[0] > 0.25


def test_sides_are_distinguished_where_the_nearest_wall_is_sharp() -> None:
    found = Silhouette.empty((60, 100))
    for col, contrast, frame in ((20, 1.0, 10), (26, 2.0, 30)):
        found.contrast[:, col], found.frame[:, col], found.standing[:, col] = contrast, frame, 20
    band = find_band(found, 4)
    assert band is not None
    assert (band.frame[:, 18:23] == 10).all()
    assert (band.frame[:, 24:29] == 30).all()
    assert (band.frame[band.inside] > 0).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("measure", "width_um", "false", "kept"), [("sml", 8.0, 0.06, 0.3), ("tenengrad", 14.0, 0.1, 0.0)]
)
def test_it_works_for_other_measures(dies: Taken, measure: str, width_um: float, false: float, kept: float) -> None:
    how = {"focus_measure": measure, "window": 13, "focus_width_um": width_um}
    maps = by_peaks(dies.stack, **how), made(dies.stack, "rims", **how)
    before, after = (kept_and_false(one, dies, dies.scene.edge) for one in maps)
    assert before[1] > false
    assert after[0] * after[1] < 0.2 * before[0] * before[1]
    assert after[0] > kept


def silhouettes(*blocks: tuple[slice, slice, int]) -> Silhouette:
    """A field of 200 x 240 pixels with silhouettes that persist for so many frames."""
    found = Silhouette.empty((200, 240))
    for rows, cols, frames in blocks:
        found.contrast[rows, cols], found.standing[rows, cols] = 1.0, frames
    return found


def test_patches_of_coarse_texture_are_no_walls() -> None:
    patches = [(slice(20 * i, 20 * i + 8), slice(25 * i, 25 * i + 14), 10) for i in range(4)]
    assert find_band(silhouettes(*patches), 5) is None


def test_a_long_silhouette_is_a_wall_and_a_short_one_if_it_persists() -> None:
    long, patch, short = (
        (slice(10, 12), slice(0, 60), 6),
        (slice(50, 58), slice(0, 14), 10),
        (slice(80, 83), slice(100, 110), 16),
    )
    band = find_band(silhouettes(long, patch, short), 5)
    assert band is not None
    assert band.inside[10:12, :60].all()
    assert not band.inside[50:58, :14].any()
    assert band.inside[80:83, 100:110].all()


def around(silhouette: Silhouette, z_um: NDArray[np.float32], mirrored: bool = False) -> Surroundings:
    """What heights say about silhouettes that persist through 2 frames, where walls persist through 5."""
    passed = np.isfinite(z_um)
    heights_um = heights_near(silhouette, 5, z_um, passed)
    symmetric = np.full(heights_um.shape, mirrored)
    return surroundings(silhouette, 5, heights_um, passed, symmetric, 1.0, reach_px=8)


def test_one_surface_around_a_silhouette_makes_it_none_but_at_the_border_of_the_frame() -> None:
    inner, outer = ((slice(10, 90), slice(col, col + 2), 9) for col in (60, 117))
    found, level = silhouettes(inner, outer), np.zeros((200, 240), np.float32)
    band = find_band(found, 5, 8, around(found, level))
    assert band is not None
    assert not band.inside[:, :100].any()
    assert band.inside[10:90, 116:].all()


def test_a_silhouette_amid_symmetric_light_is_print_though_little_is_measured() -> None:
    found, few = silhouettes((slice(10, 90), slice(60, 62), 9)), np.full((200, 240), np.nan, np.float32)
    few[:, 110:130] = 0
    assert find_band(found, 5, 8, around(found, few)) is not None
    assert find_band(found, 5, 8, around(found, few, mirrored=True)) is None


def test_a_faint_silhouette_is_a_wall_where_the_heights_jump_beside_it() -> None:
    faint = silhouettes((slice(0, 100), slice(60, 62), 2))
    step = np.where(np.arange(240) < 122, 20.0, 0.0).astype(np.float32) * np.ones((200, 1), np.float32)
    step[:, 60:80] = np.nan
    level = np.where(np.isnan(step), step, np.float32(0))
    assert find_band(faint, 5, 8, around(faint, level)) is None
    band = find_band(faint, 5, 8, around(faint, step))
    assert band is not None
    assert band.inside[10:90, 60:62].all()
    assert not band.sure.any()
    grey = np.where(np.arange(240) < 122, 40.0, 120.0).astype(np.float32) * np.ones((200, 1), np.float32)
    side = classify_sides(grey, band, 6.0).side
    assert (side[40:160, 116:120] == EdgeSide.DARK).all()
    assert (side[40:160, 124:] == EdgeSide.AWAY).all()


NOWHERE = np.zeros((50, 60), np.bool_)


def dark_heights_um(z_um: NDArray[np.float32], line: slice, level: NDArray[np.bool_] = NOWHERE) -> NDArray[np.float32]:
    """Heights in um expected on both sides of a bright line; z_um: measured, [row, col]; line: its columns."""
    half = slice((line.start - 5) // 2, (line.stop + 5) // 2)
    band = find_band(silhouettes((slice(0, 100), half, 9)), 5, 8)
    assert band is not None
    grey = np.full(z_um.shape, 20.0, np.float32)
    grey[:, line] = 200.0
    sides, passed = classify_sides(grey, band, 6.0), np.isfinite(z_um)
    return side_heights_um(z_um, passed, grey.astype(np.uint8), band, sides, 6.0, 1.0, level)[0]


def die_and_ground(die_um: float, ground_um: float, ground: slice) -> NDArray[np.float32]:
    """Heights in um of a die left of column 100 and of some columns of ground, NaN elsewhere."""
    z_um = np.full((200, 240), np.nan, np.float32)
    z_um[:, :100], z_um[:, ground] = die_um, ground_um
    return z_um


def test_the_height_of_a_die_is_not_expected_beyond_the_bright_line_of_its_rim() -> None:
    dark_um = dark_heights_um(die_and_ground(30.0, 0.0, slice(240, 240)), slice(118, 127))
    assert (dark_um[:, 26:29] == 30.0).all()
    assert np.isnan(dark_um[:, 33:36]).all()


def test_beyond_a_bright_line_the_height_of_the_same_side_is_expected_though_it_is_further_away() -> None:
    dark_um = dark_heights_um(die_and_ground(30.0, 0.0, slice(168, 240)), slice(118, 127))
    assert (dark_um[:, 26:29] == 30.0).all()
    assert (dark_um[:, 33:36] == 0.0).all()


def test_a_bright_line_on_one_measured_surface_parts_no_heights() -> None:
    seal_ring, rim = np.full((200, 240), 30.0, np.float32), die_and_ground(30.0, 0.0, slice(124, 240))
    line = silhouettes((slice(0, 100), slice(57, 66), 9))
    levels = [around(line, z_um).level for z_um in (seal_ring, rim)]
    assert levels[0][:, 28:33].all()
    assert not levels[1][:, 28:33].any()
    die = die_and_ground(30.0, 0.0, slice(240, 240))
    beyond_um = [dark_heights_um(die, slice(118, 127), level)[:, 33:35] for level in levels]
    assert (beyond_um[0] == 30.0).all()
    assert np.isnan(beyond_um[1]).all()


@pytest.mark.slow
@pytest.mark.parametrize("seed", drawn_after(1, [80, 94, 96]))
def test_a_die_without_texture_does_not_get_the_height_of_the_trench_beside_it(seed: int) -> None:
    """The focus window sees the trench up to 16 px away, and silhouettes last for a few coarse frames only."""
    scene = drawn_scene(seed)
    found = quality(reconstruct(scene.stack, threads=1).to_measure(), scene.truth_um, scene.limit_um)
    assert not found.false_fraction > 0.002  # nor where nothing is measured


@pytest.mark.slow
@pytest.mark.parametrize("seed", drawn_after(1, [41, 47, 50, 263, 341, 864, 881, 873]))
def test_few_heights_are_false_where_walls_narrow_the_aperture_or_the_border_hides_them(seed: int) -> None:
    """The slope of a polished rim, a specular floor deep between walls, a wall in the last column of the frame, ground
    beside the foot of a polished rim, dies without texture above ground of which little is measured, a die that shows
    in the last ten columns, walls of dies nearly as bright as the ground, and ground beyond a polished rim in the
    corner of the frame."""
    scene = drawn_scene(seed)
    found = quality(reconstruct(scene.stack, threads=1).to_measure(), scene.truth_um, scene.limit_um)
    assert not found.false_fraction > 0.04  # nor where nothing is measured


def test_below_a_line_no_height_counts() -> None:
    side = np.full((1, 20), EdgeSide.DARK, np.uint8)
    height, origin = np.zeros(side.shape, np.float32), np.full(side.shape, Origin.MEASURED, np.uint8)
    fall, below_line = np.full_like(height, np.nan), np.zeros(side.shape, bool)  # NaN: not searched
    below_line[:, 10:] = True
    edges = BleedingEdges(side, height, height, fall, 1.0, below_line, tolerance_um=3.0)
    _, found = judge_edges(height, origin, edges)
    assert (found[:, :10] == Origin.MEASURED).all()
    assert (found[:, 10:] == Origin.BLEEDING_EDGE).all()


def test_on_the_dark_side_a_height_that_shows_across_the_wall_only_is_its_outlines() -> None:
    side = np.full((1, 30), EdgeSide.DARK, np.uint8)
    side[:, 20:] = EdgeSide.BRIGHT
    height, origin = np.zeros(side.shape, np.float32), np.full(side.shape, Origin.MEASURED, np.uint8)
    fall = np.full_like(height, np.nan)
    fall[:, 10:20] = 0.5
    below_line = np.zeros(side.shape, bool)
    edges = BleedingEdges(side, height, height, fall, 1.0, below_line, tolerance_um=3.0)
    _, found = judge_edges(height, origin, edges)
    assert (found[:, 10:20] == Origin.BLEEDING_EDGE).all()
    assert (found[:, :10] == Origin.MEASURED).all()
    assert (found[:, 20:] == Origin.MEASURED).all()


@pytest.mark.slow
@pytest.mark.campaign
def test_few_heights_are_false_on_scenes_that_nothing_was_tuned_on():
    unseen = [judge_scene(seed, list(MEASURES)).found for seed in range(2000, 2024, 2)]
    for measure in MEASURES:
        found = [scene[measure].whole for scene in unseen]
        kept = sum(one.completeness_fraction for one in found)
        false = sum(one.completeness_fraction * one.false_fraction for one in found if one.completeness_fraction > 0)
        assert kept > 0.05 * len(found), measure
        assert false < 0.01 * kept, measure


def test_a_surface_without_walls_is_left_alone(plane_stack: FieldStack) -> None:
    assert find_band(silhouette_of(prepare(plane_stack)), 4) is None
    none, rims = made(plane_stack, "none"), made(plane_stack, "rims")
    np.testing.assert_array_equal(none.z_raw_um, rims.z_raw_um)
    np.testing.assert_array_equal(none.origin, rims.origin)


@pytest.mark.slow
def test_pictures_that_are_not_as_stored_and_threads_change_nothing(dies: Taken, mapped: dict[str, HeightMap]) -> None:
    turned = dataclasses.replace(dies.stack, images=np.asfortranarray(dies.stack.images))
    again = reconstruct(turned, changed(RECIPE, edges="rims"), threads=2)
    np.testing.assert_array_equal(again.origin, mapped["rims"].origin)
    np.testing.assert_allclose(again.z_raw_um, mapped["rims"].z_raw_um, atol=1e-3)


@pytest.mark.slow
def test_a_short_stack_says_what_is_off(dies: Taken) -> None:
    some = slice(20, 30)
    stack = dataclasses.replace(
        dies.stack, images=dies.stack.images[some], z_um=dies.stack.z_um[some], present=dies.stack.present[some]
    )
    height = made(stack, "rims")
    assert any("edges are not looked for" in note for note in height.provenance.notes)
    assert not np.isin(height.origin, [Origin.BLEEDING_EDGE, Origin.WINDOWS_DISAGREE]).any()


@pytest.mark.slow
def test_a_pixel_that_bled_can_be_asked(dies: Taken, mapped: dict[str, HeightMap]) -> None:
    height = mapped["band"]
    row, col = np.argwhere(height.origin == Origin.BLEEDING_EDGE)[40]
    found = focus_curve(dies.stack, float(height.x_um[col]), float(height.y_um[row]), height.provenance.recipe)
    assert found.origin == "light bleeding over an edge"
    edge = next(v for v in found.verdicts if v.gate == "edge")
    assert not edge.passed
    assert "wall" in edge.note


def levels_of(block: NDArray[np.uint8], window: int = 9) -> NDArray[np.float32]:
    """The levels along a wall that runs down the columns."""
    margin = tangential_margin_px(window)
    shape = block.shape[1] - 2 * margin, block.shape[2] - 2 * margin
    tile = Tile.make(len(block), shape, window)
    down = np.ones((block.shape[1] - 6, block.shape[2] - 6), np.float32)
    tangential_levels(block, window, Stabiliser.of(CAMERA), Wall.along(down, np.zeros_like(down)), tile)
    return tile.levels


def test_what_varies_across_a_wall_is_not_seen() -> None:
    rng = np.random.default_rng(2)
    noise = rng.normal(120, 12, (2, 60, 64))
    stripes = 60 * np.sin(np.arange(64) * 2.1) * np.ones((60, 1))
    across, along = (
        levels_of(np.clip(noise + s, 0, 255).astype(np.uint8))
        for s in (stripes, stripes.T[:60, :60].repeat(2, 1)[:, :64])
    )
    plain = levels_of(noise.astype(np.uint8))
    assert abs(across.mean() - plain.mean()) < 0.2
    assert along.mean() > plain.mean() + 3


@pytest.mark.parametrize("window", [5, 9, 13])
@pytest.mark.parametrize("gap", [4, 6])
def test_noise_shows_a_peak_along_a_wall_once_in_a_hundred_pixels(window: int, gap: int) -> None:
    near, side = Near(window, 3, gap), 120
    frames = 2 * near.frames + 1
    rng = np.random.default_rng(77)
    block = np.clip(rng.normal(128.5, CAMERA.variance_counts2(128) ** 0.5, (frames, side, side)), 0, 255)
    levels = levels_of(block.astype(np.uint8), window)
    height, fall = (np.empty(levels.shape[1:], np.float32) for _ in range(2))
    expected = np.full(levels.shape[1:], near.frames, np.float32)
    peaks_near(levels, 0, np.linspace(0, 4.0 * (frames - 1), frames), expected, near.reach, near.gap, height, fall)
    assert np.mean(fall > noise_fall(near)) < 0.02


def test_a_peak_is_found_near_the_expected_frame_only() -> None:
    k = np.arange(30)
    curve = np.maximum(0, 6 - np.abs(k - 12.3)) + np.maximum(0, 8 - np.abs(k - 24))
    levels = np.broadcast_to(curve[:, None, None], (30, 1, 3)).astype(np.float32).copy()
    height, fall = (np.empty((1, 3), np.float32) for _ in range(2))
    expected = np.array([[12.0, np.nan, 18.0]], np.float32)
    peaks_near(levels, 0, np.linspace(0, 116.0, 30), expected, 3, 4, height, fall)
    assert height[0, 0] == pytest.approx(12.3 * 4, abs=0.5)
    assert fall[0, 0] > 3
    assert np.isnan(height[0, 1])
    assert fall[0, 1] == 0
    assert np.isnan(height[0, 2])


@pytest.mark.parametrize("peak", [1.0, 27.0])
def test_a_peak_at_the_end_of_the_sweep_is_not_taken_for_none(peak: float) -> None:
    levels = np.maximum(0, 6 - np.abs(np.arange(30) - peak))[:, None, None].astype(np.float32)
    height, fall = (np.empty((1, 1), np.float32) for _ in range(2))
    peaks_near(levels, 0, np.linspace(0, 116.0, 30), np.array([[peak]], np.float32), 2, 4, height, fall)
    assert np.isnan(fall).all()
    edges = BleedingEdges(
        np.full((1, 1), EdgeSide.DARK, np.uint8), height, height, fall, 1.0,
        np.zeros((1, 1), np.bool_), 4.0,
    )  # fmt: skip
    assert not edges.unconfirmed.any()
    assert not edges.along.any()


@pytest.mark.slow
def test_the_band_is_as_wide_as_it_says(dies: Taken) -> None:
    band = find_band(silhouette_of(prepare(dies.stack)), 4)
    assert band is not None
    inside = band.inside.repeat(2, axis=0).repeat(2, axis=1)
    distance = dies.scene.edge_distance_px
    assert inside[distance < BAND_REACH_PX - 2].mean() > 0.99
    assert distance[inside].max() < NEAR_WALL_PX
