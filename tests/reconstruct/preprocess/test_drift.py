"""Frames that shift or grow through a stack are found, put right, and left alone where nothing moves."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import affine_transform

from tests.reconstruct.conftest import correction, whole_field
from tests.support.campaigns import drawn_after
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.surface.height_map import HeightMap, Origin
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.reconstruct.frame_blocks import StackWindow, read_part
from wafer_viewer.reconstruct.preprocess.drift import Drift
from wafer_viewer.reconstruct.preprocess.frames import prepare

MARGIN = 25
STILL, LEFT_ALONE = np.zeros(25), Recipe(drift="none")
EVENLY = np.linspace(-0.5, 0.5, 25)


@pytest.fixture(scope="module")
def wide_um() -> NDArray:
    rows, cols = np.indices((290, 390))
    return 42 + 0.012 * cols + 0.008 * rows


@pytest.fixture(scope="module")
def wide_stack(make_stack: Callable[..., FieldStack], wide_um: NDArray) -> FieldStack:
    return make_stack(wide_um, 40 + 0.6 * np.arange(25), noise_counts=1.0)


@pytest.fixture(scope="module")
def truth_um(wide_um: NDArray) -> NDArray:
    return wide_um[MARGIN:-MARGIN, MARGIN:-MARGIN]


def moved(stack: FieldStack, rows_px: NDArray, cols_px: NDArray, growth: NDArray = STILL) -> FieldStack:
    """What a camera sees that looks elsewhere in every frame: the inner part of each picture, shifted and grown."""
    n_rows, n_cols = (n - 2 * MARGIN for n in stack.images.shape[1:])
    middle = np.array([(n_rows - 1) / 2, (n_cols - 1) / 2])
    out = np.empty((stack.n_frames, n_rows, n_cols), np.uint8)
    for k, image in enumerate(stack.images):
        scale = 1 / (1 + growth[k])
        offset = MARGIN + middle - scale * (middle + np.array([rows_px[k], cols_px[k]]))
        observed = affine_transform(image.astype(np.float32), [scale, scale], offset, (n_rows, n_cols), order=3)
        out[k] = np.clip(np.rint(observed), 0, 255)
    return dataclasses.replace(stack, images=out)


def rmse_um(height: HeightMap, truth_um: NDArray) -> float:
    error = (height.z_raw_um - truth_um)[height.measured]
    return float(np.sqrt(np.mean((error - np.median(error)) ** 2)))


def jumps() -> NDArray:
    return np.cumsum(np.where(np.isin(np.arange(25), (7, 12, 16)), [3.3], 0.0)) - 4


@pytest.mark.slow
@pytest.mark.parametrize("rows_px", [STILL, 0.3 * EVENLY], ids=["still", "0.3 px"])
def test_what_stays_under_half_a_pixel_is_left_alone(wide_stack: FieldStack, rows_px: NDArray) -> None:
    frames = prepare(moved(wide_stack, rows_px, -rows_px))
    assert correction(frames, Drift) is None
    assert frames.as_stored
    assert frames.notes == ()


@pytest.mark.parametrize(
    ("rows_px", "cols_px"),
    [(EVENLY, -0.5 * EVENLY), (3 * EVENLY, STILL), (-20 * EVENLY, 10 * EVENLY), (jumps(), -0.5 * jumps())],
    ids=["1 px", "3 px", "20 px", "jumps"],
)
def test_a_shift_is_found_within_a_fifth_of_a_pixel(wide_stack: FieldStack, rows_px: NDArray, cols_px: NDArray) -> None:
    drift = correction(prepare(moved(wide_stack, rows_px, cols_px)), Drift)
    assert drift is not None
    off = drift.shift_px - np.stack([rows_px, cols_px], axis=1)
    assert np.abs(off - off.mean(axis=0)).max() < 0.2
    assert not drift.growth.any()


@pytest.mark.parametrize("growth", [0.01, -0.02])
def test_a_change_of_magnification_is_found(wide_stack: FieldStack, growth: float) -> None:
    drift = correction(prepare(moved(wide_stack, STILL, STILL, growth * EVENLY)), Drift)
    assert drift is not None
    corner_px = np.hypot(*drift.shape) / 2
    off = drift.growth - growth * EVENLY
    assert np.abs(off - off.mean()).max() * corner_px < 0.25
    assert np.abs(drift.shift_px).max() < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("kind", drawn_after(1, ["jumps", "20 px", "1 %"]))
def test_heights_are_nearly_as_good_as_without_drift(wide_stack: FieldStack, truth_um: NDArray, kind: str) -> None:
    drifts = {"20 px": (20 * EVENLY, STILL), "jumps": (jumps(), STILL), "1 %": (STILL, 0.01 * EVENLY)}
    rows_px, growth = drifts[kind]
    still = rmse_um(reconstruct(moved(wide_stack, STILL, STILL)), truth_um)
    stack = moved(wide_stack, rows_px, STILL, growth)
    height = reconstruct(stack)
    assert rmse_um(height, truth_um) < 1.25 * still + 0.02
    assert rmse_um(height, truth_um) < rmse_um(reconstruct(stack, LEFT_ALONE), truth_um)
    assert "put right" in height.provenance.notes[0]


def test_one_displaced_frame_is_found(wide_stack: FieldStack) -> None:
    aside = np.where(np.arange(25) == 12, 20.0, 0.0)
    drift = correction(prepare(moved(wide_stack, aside, STILL)), Drift)
    assert drift is not None
    off = drift.shift_px[:, 0] - aside
    assert np.abs(off - np.median(off)).max() < 0.2


@pytest.mark.slow
def test_what_not_every_frame_shows_is_unmeasured(wide_stack: FieldStack) -> None:
    height = reconstruct(moved(wide_stack, 20 * EVENLY, STILL))
    assert (height.origin[[0, -1]] == Origin.TOO_FEW_FRAMES).all()
    assert (height.origin[120] != Origin.TOO_FEW_FRAMES).all()
    assert 0.05 < np.mean(height.origin == Origin.TOO_FEW_FRAMES) < 0.2
    assert np.isnan(height.z_um[height.origin == Origin.TOO_FEW_FRAMES]).all()


def test_the_pixels_are_touched_only_when_requested(wide_stack: FieldStack) -> None:
    stack = moved(wide_stack, 3 * EVENLY, STILL)
    assert prepare(stack, LEFT_ALONE).as_stored
    assert not prepare(stack).as_stored


def test_blocks_and_parts_are_read_as_the_whole(wide_stack: FieldStack) -> None:
    frames = prepare(moved(wide_stack, 20 * EVENLY, 5 * EVENLY, 0.004 * EVENLY))
    full = whole_field(frames)
    rows, cols = slice(96, 144), slice(40, 300)
    np.testing.assert_array_equal(read_part(frames, StackWindow(rows, cols), 5), full[:, 91:149, 35:305])
    inner = read_part(frames.part(rows, cols), StackWindow(slice(20, 28), slice(30, 230)))
    np.testing.assert_array_equal(inner, full[:, 116:124, 70:270])


def test_a_field_too_small_for_tiles_is_left_alone(plane_stack: FieldStack) -> None:
    images = np.stack([np.roll(image, k, axis=1) for k, image in enumerate(plane_stack.images)])
    assert correction(prepare(dataclasses.replace(plane_stack, images=images)), Drift) is None
