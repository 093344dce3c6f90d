"""The stabilised log-Laplacian is its definition in float64, at any window and depth of grey."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import convolve, uniform_filter

from tests.support.campaigns import examples
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.surface.recipe import Noise, Recipe
from wafer_viewer.reconstruct.auto_tuning import tune_recipe
from wafer_viewer.reconstruct.focus.focus_volume import Volume
from wafer_viewer.reconstruct.focus.log_laplacian import (
    LEVEL_BITS,
    LEVEL_OFFSET,
    NOISE_ENERGY,
    LogRows,
    Stabiliser,
    log_laplacian_block,
    log_margin_px,
)
from wafer_viewer.reconstruct.focus.peak_search import Search, noise_scores, search_field
from wafer_viewer.reconstruct.frame_blocks import StackSource
from wafer_viewer.reconstruct.preprocess.camera_noise import CameraNoise
from wafer_viewer.reconstruct.preprocess.frames import prepare

DTYPES = [np.uint8, np.uint16]
_CAMERA = CameraNoise(gain_counts=0.02, floor_counts2=0.2)
_BINOMIAL = np.outer([1, 2, 1], [1, 2, 1]) / 16


def stabilised(images: NDArray, camera: CameraNoise, lag: int = 0) -> NDArray:
    """Grey in units of its noise; with a lag, minus the mean of the frames before and after, at unit noise again."""
    v = 2 / camera.gain_counts * np.sqrt(camera.gain_counts * images.astype(np.float64) + camera.floor_counts2)
    if lag == 0:
        return v
    high = np.empty_like(v)
    high[lag:-lag] = np.sqrt(2 / 3) * (v[lag:-lag] - (v[: -2 * lag] + v[2 * lag :]) / 2)
    high[:lag] = np.sqrt(1 / 2) * (v[:lag] - v[lag : 2 * lag])
    high[-lag:] = np.sqrt(1 / 2) * (v[-lag:] - v[-2 * lag : -lag])
    return high


def laplacian(v: NDArray) -> NDArray:
    smooth = convolve(v, _BINOMIAL)
    return 3 * (uniform_filter(smooth, 3) - smooth)


def by_definition(image: NDArray, window: int) -> NDArray:
    """log2 of the measure of one stabilised image, without the margin that its border spoils."""
    log = np.log2(NOISE_ENERGY + uniform_filter(laplacian(image) ** 2, 3))
    margin = log_margin_px(window)
    return uniform_filter(uniform_filter(log, window), window)[margin:-margin, margin:-margin]


def by_kernel(
    images: NDArray, window: int, camera: CameraNoise = _CAMERA, lag: int = 0, clipped_counts: int = 250
) -> tuple[NDArray, Volume]:
    """Log focus [k, row, col] without the margin, and the volume it is from."""
    margin = log_margin_px(window)
    k, n_rows, n_cols = images.shape
    shape = n_rows - 2 * margin, n_cols - 2 * margin
    levels, coarse = np.empty((k, *shape), np.uint16), np.empty((0, 1, 1), np.uint16)
    best, peak, clipped = (np.empty(shape, np.uint16) for _ in range(3))
    volume = Volume(levels, best, peak, clipped, coarse)
    source = StackSource.of(images, np.arange(k), margin, margin, clipped_counts)
    log_laplacian_block(
        source, window, Stabiliser.of(camera), lag, LogRows.make(shape[1], window, images.dtype), volume
    )
    return levels / 2.0**LEVEL_BITS - LEVEL_OFFSET, volume


def random_stack(shape: tuple[int, ...], dtype: type, seed: int) -> NDArray:
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)


@settings(max_examples=examples(25))
@given(
    half=st.integers(1, 12), dtype=st.sampled_from([np.uint8, np.uint16]), lag=st.integers(0, 2), seed=st.integers(0)
)
def test_the_measure_is_its_definition(half: int, dtype: type, lag: int, seed: int) -> None:
    window = 2 * half + 1
    side = 2 * log_margin_px(window)
    images = random_stack((5, side + 12, side + 21), dtype, seed)
    expected = [by_definition(v, window) for v in stabilised(images, _CAMERA, lag)]
    np.testing.assert_allclose(by_kernel(images, window, lag=lag)[0], expected, atol=0.001)


def test_noise_of_a_camera_has_the_energy_that_is_added() -> None:
    """The camera's noise becomes noise of one unit, and 19/64 of that is left by the Laplacian."""
    rng = np.random.default_rng(5)
    grey = np.linspace(400, 3500, 1600) * np.ones((500, 1))
    camera = CameraNoise(gain_counts=0.4, floor_counts2=30.0)
    image = rng.normal(grey, np.sqrt(0.4 * grey + 30)).round().astype(np.uint16)
    v = stabilised(image, camera)
    energy = laplacian(v)[5:-5, 5:-5] ** 2
    assert energy.mean() == pytest.approx(NOISE_ENERGY, rel=0.02)
    assert energy[:, :400].mean() == pytest.approx(energy[:, -400:].mean(), rel=0.03)


def test_the_sharpest_frame_is_that_of_a_float64_focus_volume(plane_stack: FieldStack) -> None:
    images = plane_stack.images
    volume = np.stack([by_definition(v, 9) for v in stabilised(images, _CAMERA)])
    _, found = by_kernel(images, 9)
    assert (found.peak == volume.argmax(axis=0)).mean() > 0.999


@pytest.mark.parametrize("window", [3, 9, 13, 15, 25])
def test_neither_the_hardest_contrast_nor_the_least_noise_overflows(window: int) -> None:
    side = 2 * log_margin_px(window) + 8
    rows, cols = np.indices((side, side))
    image = ((rows // 2 + cols // 2) % 2 * 65535).astype(np.uint16)
    noiseless = CameraNoise(gain_counts=1e-6, floor_counts2=1 / 12)
    log, volume = by_kernel(np.stack([image, image // 2]), window, noiseless)
    assert (log > 28).all()
    np.testing.assert_array_equal(volume.best, (log.max(axis=0) + LEVEL_OFFSET) * 2**LEVEL_BITS)


def test_best_level_frame_and_clipped_count_go_with_the_levels() -> None:
    images = random_stack((7, 40, 45), np.uint8, seed=3)
    log, volume = by_kernel(images, 5, clipped_counts=240)
    margin = log_margin_px(5)
    np.testing.assert_array_equal(volume.peak, log.argmax(axis=0))
    np.testing.assert_array_equal(volume.best / 2.0**LEVEL_BITS - LEVEL_OFFSET, log.max(axis=0))
    np.testing.assert_array_equal(volume.clipped, (images >= 240).sum(axis=0)[margin:-margin, margin:-margin])


def test_what_changes_slowly_along_z_does_not_pass_the_high_pass() -> None:
    """A sharp pattern that stands in every frame, as the light that bleeds from far, has the energy of nothing."""
    rng = np.random.default_rng(0)
    images = np.repeat(rng.integers(60, 200, (1, 48, 48)), 9, axis=0).astype(np.uint8)
    assert by_kernel(images, 9)[0].min() > 6
    np.testing.assert_allclose(by_kernel(images, 9, lag=3)[0], np.log2(NOISE_ENERGY), atol=0.001)


@pytest.mark.parametrize(("window", "lead"), [(5, 0.306), (9, 0.174), (13, 0.114), (17, 0.089)])
def test_noise_leads_as_much_as_independent_simulations_say(window: int, lead: float) -> None:
    """The 99th percentile over 300 000 pixels of noise of other seeds, 101 frames."""
    found = noise_scores(Search("log_laplacian", window, "tent", 4), 101)
    assert found.lead == pytest.approx(lead, rel=0.15)


def test_the_camera_that_the_recipe_names_is_the_one_that_is_used(plane_stack: FieldStack) -> None:
    """A camera that is said to be noisy hides the weak texture of frames out of focus."""

    def contrast(gain_counts: float) -> float:
        recipe = Recipe(focus_measure="log_laplacian", window=9, noise=Noise(gain_counts=gain_counts))
        frames = prepare(plane_stack)
        return float(np.median(search_field(frames, tune_recipe(frames, recipe).search, 1).contrast))

    assert contrast(0.02) > contrast(1.0) + 1
    assert contrast(1.0) > contrast(50.0) + 1


def test_a_tilted_plane_is_found_to_a_thirtieth_of_a_step(plane_stack: FieldStack, plane_um: NDArray) -> None:
    z_um = search_field(prepare(plane_stack), Search("log_laplacian", 9, "blur_law", 4), 1).z_um
    assert np.sqrt(np.mean((z_um - plane_um)[12:-12, 12:-12] ** 2)) < 0.15
