"""The silhouette map is its definition, fits together from stripes, and finds outlines that no frame shows sharp."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from wafer_viewer.reconstruct.silhouette import (
    SilhouetteRows,
    half_size,
    silhouette_block,
)
from wafer_viewer.reconstruct.volume import Source

DARK_COUNTS = 6.0


def by_kernel(images: NDArray, every: int = 1, top: int = 0, bottom: int | None = None) -> NDArray:
    """The map of some of the rows of images; beyond their border the border pixels repeat."""
    k, n_rows, n_cols = images.shape
    contrast = np.zeros((half_size((bottom or n_rows) - top), half_size(n_cols)), np.float32)
    source = Source.of(images, np.arange(k), top, 0, 250)
    silhouette_block(source, every, DARK_COUNTS, SilhouetteRows.make(n_cols, images.dtype), contrast)
    return contrast


def by_definition(images: NDArray) -> NDArray:
    """The map from sliding means of 6 x 6 pixels; an odd picture is filled up to an even one."""
    even = np.pad(images, ((0, 0), (0, images.shape[1] % 2), (0, images.shape[2] % 2)), mode="edge")
    padded = np.pad(even.astype(np.float64), ((0, 0), (6, 6), (6, 6)), mode="edge")
    means = np.lib.stride_tricks.sliding_window_view(padded, (6, 6), axis=(1, 2)).mean(axis=(3, 4))[:, ::2, ::2]
    b = np.log(means + DARK_COUNTS)
    down = np.abs(b[:, 3:, 2:-2] - b[:, :-3, 2:-2])
    along = np.abs(b[:, 2:-2, 3:] - b[:, 2:-2, :-3])
    pairs = down[:, 1:], down[:, :-1], along[:, :, 1:], along[:, :, :-1]
    return np.max(pairs, axis=(0, 1))


@settings(max_examples=20, deadline=None)
@given(
    rows=st.integers(1, 30),
    cols=st.integers(1, 45),
    dtype=st.sampled_from([np.uint8, np.uint16]),
    every=st.integers(1, 3),
)
def test_the_map_is_its_definition(rows: int, cols: int, dtype: type, every: int) -> None:
    rng = np.random.default_rng(rows * 100 + cols)
    images = (rng.random((4, rows, cols)) ** 3 * np.iinfo(dtype).max).astype(dtype)
    np.testing.assert_allclose(by_kernel(images, every), by_definition(images[::every]), atol=3e-4)


def test_stripes_fit_together() -> None:
    images = np.random.default_rng(2).integers(0, 256, (3, 50, 40), np.uint8)
    whole = by_kernel(images)
    for top, bottom in ((0, 18), (18, 50)):
        part = by_kernel(images, 1, top, bottom)
        np.testing.assert_array_equal(part, whole[top // 2 : half_size(bottom)])


def test_an_edge_of_contrast_c_has_a_map_of_its_logarithm() -> None:
    image = np.where(np.arange(60) < 30, 34, 194) * np.ones((40, 1))
    contrast = by_kernel(image.astype(np.uint8)[None])
    assert contrast[:, 14:16].min() == pytest.approx(np.log(200 / 40), abs=1e-3)
    assert contrast[:, :11].max() == contrast[:, 19:].max() == 0


def test_a_blurred_edge_counts_by_its_sharpest_frame() -> None:
    edge = np.where(np.arange(80) < 40, 40.0, 160.0) * np.ones((40, 1))
    frames = [gaussian_filter(edge, s) for s in (9, 1, 9)]
    images = np.array(frames, np.uint8)
    blurred, sharp, _ = (by_kernel(image[None]) for image in images)
    np.testing.assert_array_equal(by_kernel(images), np.maximum(blurred, sharp))
    assert sharp.max() > 2 * blurred.max()
