"""Standard uncertainty of each height: from noise, frames and the form under the window."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.bench.bench_phase import Measured
from tests.bench.bench_pixel_u import Honesty, plane_honesty
from tests.truth.phase import Tilted, errors_of, phase_error, stairs
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.model.surface.frame_health import FrameHealth
from wafer_viewer.model.surface.height_map import HeightMap, Origin
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.field_pipeline import reconstruct, settled_recipe
from wafer_viewer.reconstruct.focus.peak import level_noise
from wafer_viewer.reconstruct.height_uncertainty import TEXTURE_SHARE, uncertainty_um, window_variance_px2
from wafer_viewer.reconstruct.live_field import LiveField
from wafer_viewer.reconstruct.preprocess.camera_noise import CameraNoise

MakeStack = Callable[..., FieldStack]
Z_UM = np.arange(20.0, 104.0, 4.0)
STILL = FrameHealth()


def of_form(z_um: NDArray, window: int = 9) -> NDArray:
    """The uncertainty of heights without noise and with perfect frames."""
    z = np.asarray(z_um, np.float32)
    return uncertainty_um(np.zeros_like(z), z, window, 2, STILL)


@pytest.mark.parametrize("measure", focus_measures())
def test_it_covers_the_errors_of_a_noisy_plane(measure: str) -> None:
    scene = Tilted(step_dof=0.45, contrast=0.25, full_well_e=6e3, shape=(96, 256), seed=7)
    found = plane_honesty(scene, measure)
    assert found is not None
    assert 0.9 < found.within <= 1.0
    assert 0.75 < found.median < 1.25


@pytest.mark.parametrize(("lens", "step_dof"), [("waves", 0.75), ("rays", 0.45), ("rays", 0.6), ("rays", 0.75)])
def test_it_covers_what_coarse_steps_leave_of_either_lens(lens: Literal["waves", "rays"], step_dof: float) -> None:
    seen = stairs(Tilted(lens=lens, step_dof=step_dof, na=0.38, seed=7))
    measured = Measured.of(seen, "log_laplacian")
    measured.find("centred")
    found = phase_error(*errors_of(seen, measured.peaks.z_um.astype(np.float64)))
    assert found.rms < 1.3 * measured.carried
    assert measured.carried < 0.125


def test_every_measured_height_of_a_centred_peak_has_one_and_nothing_else(make_stack: MakeStack, plane_um: NDArray):
    contrast = np.where(np.arange(128)[None, :] < 80, 1.0, 0.0) * np.ones((96, 1))
    surface = reconstruct(make_stack(plane_um, Z_UM, contrast=contrast))
    assert surface.u_um is not None
    assert surface.u_um.dtype == np.float32
    assert (np.isfinite(surface.u_um) <= np.isfinite(surface.z_raw_um)).all()
    assert np.isfinite(surface.u_um[surface.measured]).mean() > 0.99
    assert np.isnan(surface.u_um[surface.origin == Origin.FILLED]).all()
    assert np.isnan(surface.u_um[:, 110:]).all()


def test_more_noise_makes_heights_less_certain(make_stack: MakeStack) -> None:
    level_um, fine_um, recipe = np.full((96, 128), 61.0), np.arange(40.0, 82.0, 1.5), Recipe(window=9)
    quiet, loud = (reconstruct(make_stack(level_um, fine_um, noise_counts=n), recipe).u_um for n in (1.0, 4.0))
    assert quiet is not None
    assert loud is not None
    assert np.nanmedian(loud) > 1.5 * np.nanmedian(quiet)  # these blurs change with a kink, which is like jitter


@pytest.mark.parametrize("peak", ["argmax", "gaussian", "tent", "blur_law"])
def test_a_peak_that_noise_is_not_propagated_through_has_none(make_stack: MakeStack, plane_um: NDArray, peak: str):
    assert reconstruct(make_stack(plane_um, Z_UM), Recipe(peak=peak)).u_um is None


def test_a_live_field_has_the_same(make_stack: MakeStack, plane_um: NDArray) -> None:
    stack = make_stack(plane_um, Z_UM)
    recipe = settled_recipe(stack)
    live = LiveField(stack.images, 4.0, recipe)
    live.take_new(np.ones(len(Z_UM), bool))
    np.testing.assert_array_equal(live.surface(stack).u_um, reconstruct(stack, recipe).u_um)


def test_a_slope_adds_a_share_of_the_window() -> None:
    rows, cols = np.indices((60, 70))
    u_um = of_form(0.3 * cols - 0.4 * rows)
    np.testing.assert_allclose(u_um, TEXTURE_SHARE * 9 * 0.5, rtol=1e-4)


def test_a_summit_adds_what_the_window_takes_off() -> None:
    rows, cols = np.indices((61, 71))
    bowl_um = 0.002 * ((rows - 30) ** 2 + (cols - 35) ** 2)
    assert of_form(bowl_um)[30, 35] == pytest.approx(2 * 0.002 * window_variance_px2(9, 2), rel=1e-3)


def test_gaps_and_borders_leave_terms_out_and_are_not_filled() -> None:
    z_um = np.zeros((40, 50), np.float32)
    z_um[10:14, 20:30] = np.nan
    u_um = of_form(z_um)
    assert np.isnan(u_um[10:14, 20:30]).all()
    assert (u_um[np.isfinite(z_um)] == 0).all()


def test_what_frames_cause_is_in_every_height() -> None:
    z_um = np.zeros((20, 20), np.float32)
    health = FrameHealth(u_jitter_um=0.3, u_flicker_um=0.4)
    u_um = uncertainty_um(np.full_like(z_um, 1.2), z_um, 9, 1, health)
    np.testing.assert_allclose(u_um, 1.3, rtol=1e-6)


@pytest.mark.parametrize("measure", ["log_laplacian", "tenengrad"])
def test_noise_of_levels_falls_with_the_texture_and_with_the_window(measure: str) -> None:
    camera, grey = CameraNoise(0.02, 0.2), np.dtype(np.uint8)
    small, large = (level_noise(measure, window, camera, grey).octaves for window in (9, 17))
    assert (small[20:] > 1.5 * large[20:]).all()
    assert small[0] > 5 * small[40] > 0
    assert small[-1] == pytest.approx(small[-9] / 2, rel=0.01), "two octaves of energy halve it"


def test_noise_of_an_energy_follows_the_grey() -> None:
    of_noise = level_noise("sml", 9, CameraNoise(0.1, 0.0001), np.dtype(np.uint8)).of_noise
    assert of_noise[200] - of_noise[50] == pytest.approx(2.0, abs=0.01)
    stabilised = level_noise("log_laplacian", 9, CameraNoise(0.1, 0.0001), np.dtype(np.uint8)).of_noise
    assert np.ptp(stabilised) == 0


def test_a_layer_of_another_shape_is_refused(make_map: Callable[..., HeightMap]) -> None:
    with pytest.raises(MeasureError, match="must be one shape"):
        make_map(np.zeros((4, 5)), u_um=np.zeros((4, 4), np.float32))


def test_a_part_of_a_map_has_its_part(make_map: Callable[..., HeightMap]) -> None:
    u_um = np.arange(20, dtype=np.float32).reshape(4, 5)
    part = make_map(np.zeros((4, 5)), u_um=u_um).crop(slice(1, 3), slice(2, 5))
    np.testing.assert_array_equal(part.u_um, u_um[1:3, 2:5])


def test_the_benchmark_judges_only_pixels_with_an_uncertainty(make_map: Callable[..., HeightMap]) -> None:
    error = np.random.default_rng(3).normal(0, 0.2, (80, 80)).astype(np.float32)
    everywhere = np.ones(error.shape, bool)
    assert Honesty.of(make_map(error), np.zeros(error.shape), everywhere) is None
    found = Honesty.of(make_map(error, u_um=np.full_like(error, 0.2)), np.zeros(error.shape), everywhere)
    assert found is not None
    assert (found.rms, found.median, found.within) == pytest.approx((1.0, 1.0, 0.954), abs=0.05)
