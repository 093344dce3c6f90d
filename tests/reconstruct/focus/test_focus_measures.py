"""The focus measures are the equations, whatever the window and the depth of the grey."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import convolve, uniform_filter

from tests.support.campaigns import examples
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.reconstruct.focus import peak_search as search_module
from wafer_viewer.reconstruct.focus.peak_search import Search, search_field
from wafer_viewer.reconstruct.focus.sml_tenengrad_glv import PAPER_MEASURES, focus_image
from wafer_viewer.reconstruct.preprocess.frames import prepare

_SOBEL = np.array([[-1, 0, 1], [-2, 0, 2], [-1, 0, 1]], float)
_SECOND = np.array([[1, -2, 1]], float)


def _window_sum(values: NDArray, window: int) -> NDArray:
    return uniform_filter(values, window, mode="constant") * window**2


def by_the_equation(image: NDArray, measure: str, window: int) -> NDArray:
    margin = window // 2 + 1
    padded = np.pad(image.astype(np.float64), margin, mode="edge")
    if measure == "sml":
        total = _window_sum(convolve(padded, _SECOND) ** 2 + convolve(padded, _SECOND.T) ** 2, window)
    elif measure == "tenengrad":
        total = _window_sum(convolve(padded, _SOBEL) ** 2 + convolve(padded, _SOBEL.T) ** 2, window)
    else:
        views = np.lib.stride_tricks.sliding_window_view(padded[1:-1, 1:-1], (window, window))
        return views.var(axis=(2, 3))
    return total[margin:-margin, margin:-margin]


@pytest.mark.slow
@pytest.mark.parametrize("measure", PAPER_MEASURES)
@settings(max_examples=examples(12))
@given(half=st.integers(1, 12), dtype=st.sampled_from([np.uint8, np.uint16]), seed=st.integers(0, 99))
def test_a_measure_is_its_equation(measure: str, half: int, dtype: type, seed: int) -> None:
    image = np.random.default_rng(seed).integers(0, np.iinfo(dtype).max, (31, 38), dtype, endpoint=True)
    window = 2 * half + 1
    expected = by_the_equation(image, measure, window)
    np.testing.assert_allclose(focus_image(image, measure, window), expected, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("measure", PAPER_MEASURES)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_the_hardest_contrast_does_not_overflow(measure: str, dtype: type) -> None:
    rows, cols = np.indices((60, 60))
    image = ((rows // 2 + cols // 2) % 2 * np.iinfo(dtype).max).astype(dtype)
    expected = by_the_equation(image, measure, 25)
    np.testing.assert_allclose(focus_image(image, measure, 25), expected, rtol=1e-6)


@pytest.mark.parametrize("measure", PAPER_MEASURES)
def test_the_sharpest_frame_is_that_of_a_float64_focus_volume(measure: str, plane_stack: FieldStack) -> None:
    frames = prepare(plane_stack)
    peaks = search_field(frames, Search(measure, 9, "argmax", 4), threads=1)
    volume = np.stack([by_the_equation(image, measure, 9) for image in plane_stack.images])
    same = peaks.z_um == plane_stack.z_um[volume.argmax(axis=0)].astype(np.float32)
    assert same.mean() > 0.999


def test_stripes_leave_no_seam(plane_stack: FieldStack, monkeypatch: pytest.MonkeyPatch) -> None:
    frames, search = prepare(plane_stack), Search("tenengrad", 9, "tent", 4)
    full = search_field(frames, search, threads=2)
    monkeypatch.setattr(search_module, "STRIPE_ROWS", 20)
    striped = search_field(frames, search, threads=1)
    for name in ("z_um", "lead", "fall", "contrast", "clipped", "all_in_focus", "coarse"):
        np.testing.assert_array_equal(getattr(full, name), getattr(striped, name))
