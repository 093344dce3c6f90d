"""A stack tells how much its camera's grey scatters, textured or plain, and never nonsense."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from tests.reconstruct.conftest import a_field
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.surface.recipe import Noise, Recipe
from wafer_viewer.reconstruct.field_pipeline import settled_recipe
from wafer_viewer.reconstruct.preprocess.camera_noise import QUANTISATION_COUNTS2, CameraNoise, estimate_camera_noise
from wafer_viewer.reconstruct.preprocess.frames import prepare

READ_E = 8.0


def stack_of(images: NDArray) -> FieldStack:
    z_um = np.arange(len(images), dtype=float)
    return FieldStack(a_field(), images, z_um, np.ones(len(images), bool), 0.5)


def noise_of(images: NDArray) -> CameraNoise:
    return estimate_camera_noise(prepare(stack_of(images)))


def taken(well_e: float, white: int, contrast: float, dtype: type, seed: int = 1) -> NDArray:
    """Bright trenches between dark dies, going through focus, counted in electrons."""
    rng = np.random.default_rng(seed)
    shape = 128, 192
    scene = np.where(np.indices(shape)[1] // 32 % 3 == 0, 0.8, 0.15)
    texture = rng.normal(0, contrast, shape)
    images = []
    for k in range(14):
        blur = 0.7 + 0.4 * abs(k - 7)
        electrons = well_e * gaussian_filter(scene, blur) * (1 + gaussian_filter(texture, blur))
        counted = rng.poisson(np.maximum(electrons, 0)) + rng.normal(0, READ_E, shape)
        images.append(np.clip(np.rint(counted / well_e * white), 0, white))
    return np.stack(images).astype(dtype)


@pytest.mark.parametrize("contrast", [0.0, 0.35, 0.7])
@pytest.mark.parametrize(("well_e", "white", "dtype"), [
    (2_000, 255, np.uint8), (15_000, 255, np.uint8), (60_000, 255, np.uint8), (10_000, 4095, np.uint16),
])  # fmt: skip
def test_the_variance_is_known_to_a_factor(well_e: float, white: int, dtype: type, contrast: float) -> None:
    noise = noise_of(taken(well_e, white, contrast, dtype))
    per_electron = white / well_e
    for grey in (0.1 * white, 0.4 * white, 0.8 * white):
        truth = per_electron * grey + (per_electron * READ_E) ** 2 + QUANTISATION_COUNTS2
        assert truth / 1.5 < noise.variance_counts2(grey) < truth * 1.5


def test_the_gain_is_that_of_the_electrons() -> None:
    assert noise_of(taken(10_000, 4095, 0.35, np.uint16)).gain_counts == pytest.approx(0.4095, rel=0.15)


def test_counts_that_were_shifted_up_have_a_coarser_floor() -> None:
    images = taken(10_000, 4095, 0.35, np.uint16)
    low, high = noise_of(images), noise_of(images << 4)
    assert high.gain_counts == pytest.approx(16 * low.gain_counts, rel=0.01)
    assert high.floor_counts2 == pytest.approx(256 * low.floor_counts2, rel=0.01)


def test_clipped_pixels_are_left_out() -> None:
    """Half of the picture white: without noise there, but not because the camera had none."""
    images = taken(4_000, 255, 0.0, np.uint8)
    clipped = images.copy()
    clipped[:, 80:] = 255
    assert noise_of(clipped).variance_counts2(60) == pytest.approx(noise_of(images).variance_counts2(60), rel=0.2)


@pytest.mark.parametrize("images", [
    np.full((5, 60, 70), 130, np.uint8),
    np.zeros((5, 60, 70), np.uint8),
    np.full((5, 60, 70), 65535, np.uint16),
    np.full((3, 3, 4), 9, np.uint8),
    np.indices((4, 90, 300), np.uint8)[2],
    np.random.default_rng(0).integers(0, 256, (3, 5, 7)).astype(np.uint8),
])  # fmt: skip
def test_a_stack_that_says_nothing_still_gets_a_possible_camera(images: NDArray) -> None:
    noise = noise_of(images)
    assert 0 < noise.gain_counts < np.inf
    assert QUANTISATION_COUNTS2 <= noise.floor_counts2 < np.inf


def test_a_stack_without_noise_gets_the_rounding_of_its_counts() -> None:
    images = np.stack([gaussian_filter(np.indices((80, 400))[1] % 80 * 2.0 + 20, 2 + k) for k in range(9)])
    noise = noise_of(images.astype(np.uint8))
    assert noise.floor_counts2 == pytest.approx(QUANTISATION_COUNTS2, rel=0.01)
    assert noise.gain_counts < 255 / 500_000


def test_what_the_stack_says_is_written_into_the_recipe_and_what_is_given_stays(plane_stack: FieldStack) -> None:
    found = noise_of(plane_stack.images)
    settled = settled_recipe(plane_stack).noise
    assert settled == Noise(gain_counts=found.gain_counts, floor_counts2=found.floor_counts2)
    given = settled_recipe(plane_stack, Recipe(noise=Noise(gain_counts=0.5))).noise
    assert given == Noise(gain_counts=0.5, floor_counts2=found.floor_counts2)
