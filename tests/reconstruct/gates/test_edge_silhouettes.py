"""The silhouette map is its definition, fits together from stripes, and finds outlines that no frame shows sharp."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from tests.support.campaigns import examples
from wafer_viewer.reconstruct.frame_blocks import StackSource
from wafer_viewer.reconstruct.gates.silhouettes import STANDING_CONTRAST, Silhouette, SilhouetteRows, silhouette_block

DARK_COUNTS = 6.0


def by_kernel(images: NDArray, every: int = 1, top: int = 0, bottom: int | None = None) -> Silhouette:
    """The maps of some of the rows of images; beyond their border the border pixels repeat."""
    k, n_rows, n_cols = images.shape
    found = Silhouette.empty(((bottom or n_rows) - top, n_cols))
    source = StackSource.of(images, np.arange(k), top, 0, 250)
    silhouette_block(source, 0, every, DARK_COUNTS, SilhouetteRows.make(n_cols, images.dtype), found)
    return found


def by_definition(images: NDArray) -> NDArray:
    """D of each frame from sliding means of 6 x 6 pixels; an odd picture is filled up to an even one."""
    even = np.pad(images, ((0, 0), (0, images.shape[1] % 2), (0, images.shape[2] % 2)), mode="edge")
    padded = np.pad(even.astype(np.float64), ((0, 0), (6, 6), (6, 6)), mode="edge")
    means = np.lib.stride_tricks.sliding_window_view(padded, (6, 6), axis=(1, 2)).mean(axis=(3, 4))[:, ::2, ::2]
    b = np.log(means + DARK_COUNTS)
    down = np.abs(b[:, 3:, 2:-2] - b[:, :-3, 2:-2])
    along = np.abs(b[:, 2:-2, 3:] - b[:, 2:-2, :-3])
    pairs = down[:, 1:], down[:, :-1], along[:, :, 1:], along[:, :, :-1]
    return np.max(pairs, axis=0)


@pytest.mark.slow
@settings(max_examples=examples(20))
@given(
    rows=st.integers(1, 30),
    cols=st.integers(1, 45),
    dtype=st.sampled_from([np.uint8, np.uint16]),
    every=st.integers(1, 3),
)
def test_the_map_is_its_definition(rows: int, cols: int, dtype: type, every: int) -> None:
    rng = np.random.default_rng(rows * 100 + cols)
    images = (rng.random((4, rows, cols)) ** 3 * np.iinfo(dtype).max).astype(dtype)
    found, changes = by_kernel(images, every), by_definition(images[::every])
    np.testing.assert_allclose(found.contrast, changes.max(axis=0), atol=3e-4)
    at_frame = np.take_along_axis(changes, found.frame[None] // every, axis=0)[0]
    np.testing.assert_allclose(at_frame, found.contrast, atol=3e-4)
    clear = (np.abs(changes - STANDING_CONTRAST) > 1e-3).all(axis=0)
    standing = every * np.count_nonzero(changes >= STANDING_CONTRAST, axis=0)
    np.testing.assert_array_equal(found.standing[clear], standing[clear])


def test_stripes_fit_together() -> None:
    images = np.random.default_rng(2).integers(0, 256, (3, 50, 40), np.uint8)
    full = by_kernel(images)
    for top, bottom in ((0, 18), (18, 50)):
        for part, same in zip(by_kernel(images, 1, top, bottom), full.rows(slice(top, bottom)), strict=True):
            np.testing.assert_array_equal(part, same)


def test_frames_in_two_calls_are_as_in_one() -> None:
    images = (np.random.default_rng(3).random((7, 20, 30)) ** 3 * 255).astype(np.uint8)
    found, rows = Silhouette.empty((20, 30)), SilhouetteRows.make(30, images.dtype)
    for first, frames in ((0, np.arange(4)), (4, np.arange(4, 7))):
        silhouette_block(StackSource.of(images, frames, 0, 0, 250), first, 2, DARK_COUNTS, rows, found)
    for part, same in zip(found, by_kernel(images, 2), strict=True):
        np.testing.assert_array_equal(part, same)


def test_an_edge_of_contrast_c_has_a_map_of_its_logarithm() -> None:
    image = np.where(np.arange(60) < 30, 34, 194) * np.ones((40, 1))
    contrast = by_kernel(image.astype(np.uint8)[None]).contrast
    assert contrast[:, 14:16].min() == pytest.approx(np.log(200 / 40), abs=1e-3)
    assert contrast[:, :11].max() == contrast[:, 19:].max() == 0


def test_a_pattern_is_a_silhouette_in_focus_only_and_a_wall_at_every_focus() -> None:
    edge = np.where(np.arange(80) < 40, 40.0, 160.0) * np.ones((40, 1))
    pattern = np.array([gaussian_filter(edge, s) for s in (20, 9, 1, 9, 20)], np.uint8)
    wall = np.array([gaussian_filter(edge, s) for s in (2, 1, 2, 1, 2)], np.uint8)
    flat, standing = by_kernel(pattern), by_kernel(wall)
    assert flat.frame[:, 18:22].tolist() == np.full((20, 4), 2).tolist()
    assert flat.contrast.max() == pytest.approx(standing.contrast.max(), rel=1e-3)
    assert flat.standing.max() == 1
    assert standing.standing.max() == 5
