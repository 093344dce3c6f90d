"""The all-in-focus picture: sharp and without seams where heights are known, without patches where they are not."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, uniform_filter

from tests.bench.bench_all_in_focus import errors
from tests.reconstruct.conftest import MakeStack
from tests.truth.families import FamilyScene, boards
from tests.truth.unseen import drawn_scene
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import UNMEASURED_FROM
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.field_pipeline import prepare_field, reconstruct, search_peaks
from wafer_viewer.reconstruct.focus.all_in_focus import FrameFit, membrane
from wafer_viewer.reconstruct.frame_blocks import Frames

Z_UM = 2.0 * np.arange(30)
LIGHT = np.linspace(1.25, 0.75, len(Z_UM))
ROWS, COLS = np.indices((128, 192))
RAMP_UM = 12 + 0.18 * COLS
MIDDLE = (slice(36, 92), slice(64, 128))


def bare_in_the_middle(make_stack: MakeStack, **changes: Any):
    """A ramp in light that fades along z, without texture in the middle."""
    contrast = np.ones(RAMP_UM.shape)
    contrast[16:112, 44:148] = 0.0
    stack = make_stack(RAMP_UM, Z_UM, contrast=contrast, noise_counts=1.0, **changes)
    images = np.clip(np.rint(stack.images * LIGHT[:, None, None]), 0, 255).astype(np.uint8)
    return dataclasses.replace(stack, images=images)


def test_bare_ground_has_no_terraces(make_stack: MakeStack):
    stack = bare_in_the_middle(make_stack)
    surface = reconstruct(stack, threads=1)
    assert (surface.origin[MIDDLE] >= UNMEASURED_FROM).mean() > 0.9
    seen = uniform_filter(surface.all_in_focus.astype(float), 5)[MIDDLE]
    expected = 110 * np.interp(RAMP_UM, Z_UM, LIGHT)[MIDDLE]
    assert float(np.sqrt(np.mean((seen - expected) ** 2))) < 3.0


def test_measured_pixels_are_as_sharp_as_the_sample_and_less_noisy_than_a_frame(make_stack: MakeStack):
    noise_counts = 6.0
    stack = make_stack(RAMP_UM + 10, Z_UM, noise_counts=noise_counts)
    sharp = 110 + gaussian_filter(np.random.default_rng(1).normal(0, 60, RAMP_UM.shape), 0.8)  # as make_stack blurs
    surface = reconstruct(stack, threads=1)
    assert surface.measured.mean() > 0.9
    error = (surface.all_in_focus - sharp)[surface.measured]
    assert float(np.sqrt(np.mean(error**2))) < 0.85 * noise_counts


@pytest.mark.parametrize("focus_width_um", [1.0, 5.0, 50.0])
def test_light_that_bends_along_z_is_read_right_between_frames(focus_width_um: float):
    z_um = np.array([0.0, 2.0, 4.0, 6.0, 8.5, 10.0, 12.0, 14.0, 16.0, 18.0])
    k = np.arange(len(z_um))
    light = 4000 + 300 * k - 40 * k**2
    images = np.broadcast_to(light[:, None, None], (len(k), 1, 200)).astype(np.uint16).copy()
    at_um = np.linspace(z_um[3], z_um[-4], 200, dtype=np.float32)[None]
    frames = Frames.of(images, k, z_um, clipped_counts=65535)
    grey = np.zeros((1, 200), np.uint16)
    FrameFit.of(frames, focus_width_um).read(at_um, np.ones((1, 200), np.bool_), grey)
    place = np.interp(at_um, z_um, k)
    np.testing.assert_allclose(grey, 4000 + 300 * place - 40 * place**2, atol=4)  # a 64th of a step is 4 counts here


@pytest.mark.slow
def test_light_of_a_trench_leaves_no_contours_on_the_dies():
    scene = drawn_scene(102, 128, faults=False)
    surface = reconstruct(scene.stack, threads=1)
    unmeasured = surface.origin >= UNMEASURED_FROM
    field = prepare_field(scene.stack)
    frame = field.frames.as_stored_counts(search_peaks(field, threads=1).all_in_focus)
    errors = [np.mean((picture - scene.sharp_grey)[unmeasured] ** 2) for picture in (surface.all_in_focus, frame)]
    assert errors[0] < 0.1 * errors[1]


def test_an_overexposed_trench_is_white():
    scene = drawn_scene(100, 128, faults=False)
    surface = reconstruct(scene.stack, threads=1)
    trench = scene.truth_um < scene.truth_um.mean()
    assert scene.sharp_grey[trench].mean() > 250
    assert surface.all_in_focus[trench].mean() > 240


@pytest.mark.parametrize("shape", [(40, 60), (37, 1), (5, 9)])
def test_a_membrane_keeps_what_is_known_and_continues_a_plane(shape: tuple[int, int]):
    rows, cols = np.indices(shape)
    plane = (2 + 0.1 * rows + 0.3 * cols).astype(np.float32)
    holed = plane.copy()
    holed[shape[0] // 3 : shape[0] // 2, shape[1] // 3 : 2 * shape[1] // 3] = np.nan
    filled = membrane(holed)
    known = np.isfinite(holed)
    np.testing.assert_array_equal(filled[known], holed[known])
    assert np.abs(filled - plane).max() < 0.25 * np.ptp(plane) + 1e-6


def errors_without_heights(scene: FamilyScene) -> tuple[float, float]:
    """RMS error of grey on the pixels without a height, and that at the depth of those around them."""
    surface, field = reconstruct(scene.stack, threads=1), prepare_field(scene.stack)
    without = surface.origin >= UNMEASURED_FROM
    at_others = np.zeros(surface.shape, field.frames.dtype)
    fit = FrameFit.of(field.frames, float(field.tuned.recipe.focus_width_um))
    fit.read(membrane(surface.z_um), np.ones(surface.shape, np.bool_), at_others)
    pictures = surface.all_in_focus, field.frames.as_stored_counts(at_others)
    return tuple(errors(picture, scene.sharp_grey, without).rms for picture in pictures)


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("seed", [13, 14])
def test_parts_without_heights_are_read_where_they_are_sharp(seed: int):
    """Dark detail too: parts of a board lie at other depths than what is measured around them."""
    error, at_others = errors_without_heights(boards(seed))
    assert error < 0.95 * at_others  # 0.81 and 0.90 of it


@pytest.mark.slow
def test_pixels_that_the_gates_refuse_are_read_where_they_are_sharp():
    """Of the gates alone, because the probability refuses rims of parts that are read as wrongly with a height."""
    scene = boards(2)
    refused = reconstruct(scene.stack, replace(Recipe(), least_probability=0.0), threads=1).origin >= UNMEASURED_FROM
    assert errors(reconstruct(scene.stack, threads=1).all_in_focus, scene.sharp_grey, refused).rms < 4
