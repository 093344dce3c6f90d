"""Exposure flicker: divided out where it shows, told, and nothing changed where it does not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.reconstruct.conftest import MakeStack, correction, whole_field
from wafer_viewer.measure.base.measurement_context import FLICKER, frame_lines_um
from wafer_viewer.measure.tools.step_height import step_height
from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.acquisition.focus_stack import Bracket, FieldStack
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.frame_health import flicker_u_um
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.field_pipeline import reconstruct, settled_recipe
from wafer_viewer.reconstruct.live_field import LiveField
from wafer_viewer.reconstruct.preprocess.camera_noise import estimate_camera_noise
from wafer_viewer.reconstruct.preprocess.flicker import FlickerGains
from wafer_viewer.reconstruct.preprocess.frames import prepare

Z_UM = 2.0 * np.arange(34)
FACES_UM = (24.3, 41.9)
EXACT = Calibration(pixel_um=0.5, u_pixel_um=0.0, u_z_scale=0.0, made="2026-01-01", due="2099-01-01", against="")
LEAVE = replace(Recipe(), flicker="none")


def two_faces(make_stack: MakeStack, seed: int) -> FieldStack:
    heights = np.ones((96, 1)) * np.where(np.arange(128) < 64, *FACES_UM)
    return make_stack(heights, Z_UM, seed=seed, contrast=0.4, calibration=EXACT)


def lit(stack: FieldStack, gains: NDArray) -> FieldStack:
    counts = np.clip(np.rint(stack.images * gains[:, None, None]), 0, 255).astype(np.uint8)
    return dataclasses.replace(stack, images=counts)


def gains_of(seed: int, sigma: float = 0.05) -> NDArray:
    return 1 + np.random.default_rng(seed).normal(0, sigma, len(Z_UM))


def measured(surface: HeightMap) -> tuple[float, float]:
    """Error and expanded uncertainty of the step between the faces, um."""
    x0, y0, x1, y1 = surface.bounds_um
    lower = Region.rectangle(x0 + 4, y0 + 4, x0 + 22, y1 - 4)
    upper = Region.rectangle(x1 - 22, y0 + 4, x1 - 4, y1 - 4)
    height = step_height(surface, upper, lower).height
    assert height.expanded_um is not None
    return height.value_um - (FACES_UM[1] - FACES_UM[0]), height.expanded_um


@pytest.mark.parametrize("seed", [1, 5])
def test_flicker_is_divided_out_and_told(make_stack: MakeStack, seed: int):
    stack = two_faces(make_stack, seed)
    steady, _ = measured(reconstruct(stack, threads=1))
    flickering = lit(stack, gains_of(seed))
    uncorrected, _ = measured(reconstruct(flickering, LEAVE, threads=1))
    surface = reconstruct(flickering, threads=1)
    corrected, _ = measured(surface)
    assert abs(uncorrected - steady) > 0.06
    assert abs(corrected - steady) < 0.5 * abs(uncorrected - steady)
    assert any(note.startswith("The light flickered by ") for note in surface.provenance.notes)
    assert surface.all_in_focus.dtype == np.uint8


def test_the_picture_of_a_flickering_stack_is_as_bright(make_stack: MakeStack):
    stack = two_faces(make_stack, 1)
    before, after = (reconstruct(s, threads=1).all_in_focus.mean() for s in (stack, lit(stack, gains_of(1))))
    assert abs(after / before - 1) < 0.03


@pytest.mark.parametrize("sigma", [0.0, 0.001])
def test_a_steady_stack_is_read_in_place(make_stack: MakeStack, sigma: float):
    stack = lit(two_faces(make_stack, 1), gains_of(3, sigma))
    frames = prepare(stack)
    assert frames.as_stored
    assert frames.notes == ()
    assert frames.dtype == np.uint8
    left = reconstruct(stack, LEAVE, threads=1)
    np.testing.assert_array_equal(reconstruct(stack, threads=1).z_raw_um, left.z_raw_um)


def test_light_that_changes_slowly_is_left_alone(make_stack: MakeStack):
    assert prepare(lit(two_faces(make_stack, 1), np.linspace(1.1, 0.8, len(Z_UM)))).as_stored


def test_the_paper_does_not_correct_flicker(make_stack: MakeStack):
    frames = prepare(lit(two_faces(make_stack, 1), gains_of(1)), replace(Recipe.paper(), drift="correct"))
    assert correction(frames, FlickerGains) is None


def test_noise_is_told_in_counts_of_the_camera(make_stack: MakeStack):
    stack = two_faces(make_stack, 2)
    steady = settled_recipe(stack).noise
    flickering = lit(stack, gains_of(2))
    corrected = settled_recipe(flickering).noise
    assert corrected.floor_counts2 == pytest.approx(steady.floor_counts2, rel=0.5)
    frames = prepare(flickering)
    assert estimate_camera_noise(frames).floor_counts2 > 100 * float(corrected.floor_counts2)


def test_fused_exposures_flicker_each_by_itself(make_stack: MakeStack):
    stack = two_faces(make_stack, 4)
    longer = lit(stack, np.full(len(Z_UM), 1.6))
    gains = gains_of(6), gains_of(7)
    bracketed, steady = (
        dataclasses.replace(a, brackets=(Bracket(b.images, b.present, 1.6),), exposure_us=1.0)
        for a, b in ((lit(stack, gains[0]), lit(longer, gains[1])), (stack, longer))
    )

    def scatter(one: FieldStack, recipe: Recipe) -> float:
        mean = np.log(whole_field(prepare(one, recipe)).mean(axis=(1, 2)))
        return float(np.std(np.diff(mean, 2)))

    assert scatter(bracketed, Recipe()) < 0.1 * scatter(bracketed, LEAVE)
    assert scatter(steady, Recipe()) == scatter(steady, LEAVE)
    error, expanded = measured(reconstruct(bracketed, threads=1))
    assert abs(error) < max(expanded, 0.05)


def test_a_live_field_that_flickers_is_searched_again(make_stack: MakeStack):
    stack = lit(two_faces(make_stack, 1), gains_of(1))
    recipe = settled_recipe(two_faces(make_stack, 1))
    live = LiveField(stack.images, 2.0, recipe)
    live.take(0, len(Z_UM))
    found, whole = live.surface(stack), reconstruct(stack, recipe, threads=1)
    np.testing.assert_array_equal(found.z_raw_um, whole.z_raw_um)
    assert any("flickered" in note for note in found.provenance.notes)


def test_flicker_that_is_left_alone_is_in_the_budget(make_stack: MakeStack):
    flickering = lit(two_faces(make_stack, 5), gains_of(5))
    corrected, left = (reconstruct(flickering, recipe, threads=1).provenance for recipe in (Recipe(), LEAVE))
    depth_um = float(left.recipe.focus_width_um) / 1.2
    expected_um = flicker_u_um(float(np.std(gains_of(5))), 2.0, depth_um)
    assert left.frame_health.u_flicker_um == pytest.approx(expected_um, rel=0.3)
    assert left.frame_health.u_flicker_um > 5 * corrected.frame_health.u_flicker_um
    assert frame_lines_um(left)[FLICKER] == pytest.approx(2**0.5 * left.frame_health.u_flicker_um)
