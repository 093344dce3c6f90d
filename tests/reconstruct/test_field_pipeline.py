"""From a stack to a height map, as a person uses it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from wafer_viewer import __version__
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.model.surface.height_map import HeightMap, Origin
from wafer_viewer.model.surface.recipe import Levy, Recipe
from wafer_viewer.reconstruct.field_pipeline import SEARCH_SHARE, reconstruct, settled_recipe, warm_up
from wafer_viewer.reconstruct.focus.log_laplacian import log_laplacian_block
from wafer_viewer.reconstruct.focus.peak_search import STRIPE_ROWS

MakeStack = Callable[..., FieldStack]
KERNEL: Any = log_laplacian_block


@pytest.fixture(scope="module")
def plane_map(plane_stack: FieldStack) -> HeightMap:
    return reconstruct(plane_stack)


def test_a_plane_comes_out_as_it_is(plane_map: HeightMap, plane_um: NDArray) -> None:
    assert plane_map.measured.mean() > 0.97
    assert np.sqrt(np.nanmean((plane_map.z_raw_um - plane_um) ** 2)) < 0.5
    assert abs(np.nanmean(plane_map.z_raw_um - plane_um)) < 0.05


def test_the_surface_keeps_the_stage_position_of_its_field(make_stack: MakeStack, plane_um: NDArray) -> None:
    from wafer_viewer.model.acquisition.plan import Field

    field = Field(number=3, row=0, col=2, x_um=1000.0, y_um=-500.0, z_start_um=0.0)
    height = reconstruct(make_stack(plane_um, np.arange(20.0, 104.0, 4.0), field=field))
    assert height.x_um.mean() == pytest.approx(1000.0)
    assert height.y_um.mean() == pytest.approx(-500.0)


def test_the_result_says_how_it_was_made(make_stack: MakeStack, plane_um: NDArray) -> None:
    stack = make_stack(plane_um, np.arange(20.0, 104.0, 4.0), simulated=True, checksum="abc", positions_assumed=True)
    made = reconstruct(stack).provenance
    assert not made.recipe.heights_have_auto
    assert made.recipe == settled_recipe(stack)
    assert made.simulated
    assert made.positions_assumed
    assert (made.input_checksum, made.software_version, made.z_step_um) == ("abc", __version__, 4.0)


def test_a_settled_recipe_gives_the_same_map(plane_stack: FieldStack, plane_map: HeightMap) -> None:
    again = reconstruct(plane_stack, plane_map.provenance.recipe)
    np.testing.assert_array_equal(again.z_um, plane_map.z_um)
    np.testing.assert_array_equal(again.origin, plane_map.origin)


@pytest.mark.parametrize("measure", focus_measures())
def test_a_step_keeps_its_height(make_stack: MakeStack, measure: str) -> None:
    truth = np.full((96, 160), 20.0)
    truth[:, 80:] = 60.0
    height = reconstruct(make_stack(truth, np.arange(0.0, 84.0, 4.0)), Recipe(focus_measure=measure))
    left, right = height.z_raw_um[:, 10:60], height.z_raw_um[:, 100:150]
    assert np.nanmedian(right) - np.nanmedian(left) == pytest.approx(40, abs=0.2)
    between = height.z_um[(height.z_um > 26) & (height.z_um < 54)]
    assert between.size < 0.01 * truth.size


def test_a_cone_comes_out_round(make_stack: MakeStack) -> None:
    rows, cols = np.indices((120, 120))
    truth = 70 - 0.8 * np.hypot(rows - 60, cols - 60)
    height = reconstruct(make_stack(truth, np.arange(0.0, 84.0, 4.0)))
    assert np.nanmedian(np.abs(height.z_raw_um - truth)) < 0.5
    top = np.unravel_index(np.nanargmax(height.z_um), truth.shape)
    assert np.hypot(top[0] - 60, top[1] - 60) < 8


def test_layers_agree_with_each_other(plane_map: HeightMap) -> None:
    unmeasured, filled = plane_map.origin >= 10, plane_map.origin == Origin.FILLED
    np.testing.assert_array_equal(np.isnan(plane_map.z_um), unmeasured)
    np.testing.assert_array_equal(np.isnan(plane_map.z_raw_um), unmeasured | filled)
    assert plane_map.confidence.min() >= 0
    assert plane_map.confidence.max() <= 1


def test_every_refused_peak_is_kept_with_its_height_and_its_reason(make_stack: MakeStack, plane_um: NDArray) -> None:
    contrast = np.ones(plane_um.shape)
    contrast[:, 40:80] = 0.0
    z_um = np.arange(20.0, 104.0, 4.0)
    height = reconstruct(make_stack(plane_um, z_um, contrast=contrast))
    refused = height.refused
    assert refused is not None
    np.testing.assert_array_equal(refused.at, np.flatnonzero(height.origin != Origin.MEASURED))
    assert len(refused) > 96 * 10
    assert (refused.z_um >= z_um[0]).all()
    assert (refused.z_um <= z_um[-1]).all()
    own = height.origin.ravel()[refused.at]
    np.testing.assert_array_equal(refused.reason[own != Origin.FILLED], own[own != Origin.FILLED])
    assert not np.isin(refused.reason, (Origin.MEASURED, Origin.FILLED, Origin.NOT_COVERED)).any()
    assert height.crop(slice(0, 10), slice(0, 10)).refused is None


def test_16_bit_grey_gives_the_map_of_8_bit_grey(make_stack: MakeStack, plane_um: NDArray) -> None:
    z_um = np.arange(20.0, 104.0, 4.0)
    deep = reconstruct(make_stack(plane_um, z_um, dtype=np.uint16))
    assert deep.all_in_focus.dtype == np.uint16
    assert np.sqrt(np.nanmean((deep.z_raw_um - plane_um) ** 2)) < 0.5


def test_threads_do_not_change_the_map(plane_stack: FieldStack, plane_map: HeightMap) -> None:
    for threads in (1, 2):
        np.testing.assert_array_equal(reconstruct(plane_stack, threads=threads).z_um, plane_map.z_um)


def test_progress_rises_to_one_and_can_stop_the_work(plane_stack: FieldStack) -> None:
    observed: list[float] = []
    reconstruct(plane_stack, progress=observed.append)
    assert observed == sorted(observed)
    assert observed[-1] == 1

    def stop(share: float) -> None:
        raise ComputeError("stopped")

    with pytest.raises(ComputeError, match="stopped"):
        reconstruct(plane_stack, progress=stop)


def test_work_can_be_stopped_after_the_peaks_too(plane_stack: FieldStack) -> None:
    def stop(share: float) -> None:
        if share > SEARCH_SHARE:
            raise ComputeError("stopped")

    with pytest.raises(ComputeError, match="stopped"):
        reconstruct(plane_stack, progress=stop)


def test_smoothing_touches_only_the_smoothed_layer(plane_stack: FieldStack, plane_map: HeightMap) -> None:
    rough = reconstruct(plane_stack, Recipe(levy=Levy(mode="none")))
    both = rough.measured & plane_map.measured
    np.testing.assert_array_equal(rough.z_raw_um[both], plane_map.z_raw_um[both])
    assert (plane_map.z_um[both] != plane_map.z_raw_um[both]).any()


def test_a_small_window_is_enough_for_rich_texture_and_more_is_taken_for_poor(
    make_stack: MakeStack, plane_um: NDArray
) -> None:
    z_um = np.arange(20.0, 104.0, 4.0)
    rich = settled_recipe(make_stack(plane_um, z_um, noise_counts=0.3))
    poor = settled_recipe(make_stack(plane_um, z_um, noise_counts=2.5, contrast=0.12))
    assert rich.window == 9
    assert poor.window > 9


def test_three_frames_give_a_map(make_stack: MakeStack) -> None:
    height = reconstruct(make_stack(np.full((64, 64), 4.3), np.array([0.0, 4.0, 8.0])))
    assert height.shape == (64, 64)
    assert np.nanmedian(np.abs(height.z_raw_um - 4.3)) < 0.5


@pytest.mark.parametrize("shape", [(9, 200), (200, 9), (30, 31)])
def test_small_and_odd_frames_are_welcome(make_stack: MakeStack, shape: tuple[int, int]) -> None:
    assert reconstruct(make_stack(np.full(shape, 21.0), np.arange(0.0, 44.0, 4.0))).shape == shape


def test_warming_up_compiles_what_a_reconstruction_needs(plane_stack: FieldStack) -> None:
    warm_up()
    compiled = len(KERNEL.signatures)
    reconstruct(plane_stack)
    assert len(KERNEL.signatures) == compiled


def test_fields_of_one_stripe_and_of_several_take_the_same_kernels(plane_stack: FieldStack) -> None:
    reconstruct(plane_stack)
    reconstruct(plane_stack.part(slice(0, STRIPE_ROWS), slice(0, 128)))
    of_images = [images for images, *_ in KERNEL.signatures]
    assert len(set(of_images)) == len(of_images)
