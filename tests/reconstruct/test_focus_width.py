"""The automatic focus width beside bleeding light, on scenes drawn by seed, and what is said where it is not known."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
import tifffile

from tests.support.campaigns import drawn_after
from tests.truth.bleeding import PIXEL_UM, Bleeding, Seen, drawn, seen
from tests.truth.smooth_scenes import Optics, stack_of
from wafer_viewer.model.acquisition.calibration import Calibration, OpticalSetup, depth_of_field_um
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.recipe import Noise, Recipe
from wafer_viewer.reconstruct.auto_tuning import TOO_WIDE, focus_width, tune_recipe
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.reconstruct.preprocess.frames import prepare
from wafer_viewer.store.dataset.stack_import import open_stack

SEEDS = (4, 11, 13, 17, 1002, 1003)
"""Where an unbounded width was 1.2 to 2.7 depths of field, and 0.7 to 33 % of the heights false, 8.9 % on average."""


@cache
def scene(seed: int) -> Seen:
    return seen(drawn(seed))


def valid(one: Seen) -> FieldStack:
    """The stack of a scene with the depth of field of its optics."""
    return dataclasses.replace(one.stack, depth_of_field_um=depth_of_field_um(one.scene.na, PIXEL_UM))


def width_um(stack: FieldStack) -> float:
    return float(tune_recipe(prepare(stack), Recipe()).recipe.focus_width_um)


@pytest.mark.slow
@pytest.mark.parametrize("seed", drawn_after(2, SEEDS))
def test_the_width_stays_within_what_optics_allow(seed: int):
    one = scene(seed)
    depth_um = one.scene.depth_of_field_um
    assert 0.5 * depth_um < width_um(valid(one)) <= depth_of_field_um(one.scene.na, PIXEL_UM)
    assert 0.5 * depth_um < width_um(one.stack) < 2.1 * depth_um


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.parametrize("depth", ["known", "unknown"])
def test_a_bounded_width_keeps_false_heights_away(depth: str):
    shares = []
    for one in map(scene, SEEDS):
        stack = valid(one) if depth == "known" else one.stack
        shares.append(one.false_share(reconstruct(stack, threads=1).z_raw_um))
    assert np.mean(shares) < 0.002
    assert max(shares) < 0.006


@pytest.mark.slow
def test_the_width_at_the_peak_hardly_depends_on_where_the_frames_lie():
    optics = Optics(na=0.28, step_dof=0.55, contrast=0.2, full_well_e=40e3, lens="rays")
    stacks = [stack_of(np.zeros((96, 160)), optics, np.random.default_rng(seed), PIXEL_UM) for seed in range(100, 112)]
    widths = [
        focus_width(prepare(stack), Recipe(window=9, noise=Noise(gain_counts=0.006, floor_counts2=0.3)))
        for stack in stacks
    ]
    by_the_bend, between_crossings = (
        np.ptp(w) / np.mean(w) for w in zip(*((w.peak_um, w.um) for w in widths), strict=True)
    )
    assert by_the_bend < 0.2
    assert between_crossings > 0.3


@pytest.mark.slow
def test_the_aperture_in_the_objectives_name_bounds_the_width_too():
    one = scene(SEEDS[0])
    setup = OpticalSetup(objective=f"20x/{one.scene.na:.2f}")
    calibration = Calibration(
        pixel_um=PIXEL_UM, u_pixel_um=0.001, u_z_scale=0.001, setup=setup, made="2026-01-01", due="2027-01-01",
        against="a grid",
    )  # fmt: skip
    stack = dataclasses.replace(one.stack, calibration=calibration)
    assert stack.optical_depth_um == pytest.approx(depth_of_field_um(round(one.scene.na, 2), PIXEL_UM))
    assert width_um(stack) <= stack.optical_depth_um


def test_the_aperture_given_with_images_bounds_the_width(tmp_path):
    one = scene(SEEDS[0])
    for k, image in enumerate(one.stack.images):
        tifffile.imwrite(tmp_path / f"z{k:03d}.tif", image)
    step_um = one.stack.z_step_um
    stack = open_stack(tmp_path, z_step_um=step_um, pixel_um=PIXEL_UM, numerical_aperture=one.scene.na)
    assert stack.optical_depth_um == valid(one).optical_depth_um
    assert width_um(stack) == pytest.approx(width_um(valid(one)))


@pytest.mark.slow
def test_a_width_that_hides_walls_is_reported():
    one = scene(SEEDS[0])
    stack = valid(one)
    wide = replace(Recipe(), focus_width_um=1.5 * TOO_WIDE * stack.depth_of_field_um)
    reported = [note for note in reconstruct(stack, wide, threads=1).provenance.notes if "could not be tested" in note]
    assert len(reported) == 1
    assert "times the depth of field" in reported[0]
    assert not any("tested" in note for note in reconstruct(stack, threads=1).provenance.notes)


@pytest.mark.slow
def test_a_sweep_too_short_for_walls_is_reported():
    one = scene(SEEDS[0])
    wide = replace(Recipe(), focus_width_um=float(np.ptp(one.stack.z_um)) / 1.5)
    assert any("this one is" in note for note in reconstruct(one.stack, wide, threads=1).provenance.notes)


def test_a_width_that_no_optics_of_the_pixel_has_is_bounded_and_reported():
    flat = Bleeding(
        na=0.1, step_dof=0.2, trench_px=1, pitch_px=200, depth_um=0, ratio=1, die_contrast=0.1, trench_contrast=0.1,
        trench_grain_px=0.8, bare_share=0, sweep_um=400, clipped=0, full_well_e=1e4, lines=True, seed=3,
    )  # fmt: skip
    stack = dataclasses.replace(seen(flat, (96, 128)).stack, pixel_um=0.2)
    found = reconstruct(stack, threads=1).provenance
    assert float(found.recipe.focus_width_um) < 0.5 * flat.depth_of_field_um
    assert any("Name the objective with its aperture" in note for note in found.notes)
