"""The wider window sees the same surface, and something else where the narrow one is misled."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.reconstruct.focus.peak import Peaks
from wafer_viewer.reconstruct.focus.peak_search import (
    Search,
    ThreadScratch,
    search_block,
    search_field,
    wide_cells,
    wide_heights,
)
from wafer_viewer.reconstruct.frame_blocks import developed, stripes
from wafer_viewer.reconstruct.preprocess.frames import prepare


@pytest.fixture(params=[(96, 128), (61, 75)], ids=str)
def stack(request: pytest.FixtureRequest, plane_stack: FieldStack) -> FieldStack:
    rows, cols = request.param
    return plane_stack.__class__(
        images=plane_stack.images[:, :rows, :cols],
        z_um=plane_stack.z_um,
        present=plane_stack.present,
        pixel_um=plane_stack.pixel_um,
        field=plane_stack.field,
    )


def _levels(stack: FieldStack, search: Search) -> NDArray[np.uint16]:
    frames = prepare(stack)
    bench = ThreadScratch.make(frames.n_frames, frames.shape, search, frames.dtype)
    out = Peaks.empty(frames.shape, frames.dtype)
    for _, block in developed(frames, stripes(frames.shape, frames.shape[0]), search.margin_px):
        search_block(block, frames.z_um, search, bench, out)
    return bench.curves.levels


@pytest.mark.parametrize("threads", [1, 2])
def test_the_coarse_volume_is_the_mean_of_4_x_4_levels(stack: FieldStack, threads: int) -> None:
    search = Search("tenengrad", 9, "tent", 4)
    coarse = search_field(prepare(stack), search, threads).coarse
    levels = _levels(stack, search).astype(float)
    _, rows, cols = levels.shape
    padded = np.pad(levels, ((0, 0), (0, -rows % 4), (0, -cols % 4)), mode="edge")
    means = padded.reshape(len(levels), coarse.shape[1], 4, coarse.shape[2], 4).mean(axis=(2, 4))
    assert coarse.shape == (len(stack.z_um), -(-rows // 4), -(-cols // 4))
    np.testing.assert_allclose(coarse, means, atol=0.5001)


@pytest.mark.parametrize("cells", [1, 3, 5])
def test_the_sharpest_frame_is_that_of_averaged_levels(stack: FieldStack, cells: int) -> None:
    search = Search("sml", 9, "argmax", 4)
    peaks = search_field(prepare(stack), search)
    z_um = wide_heights(peaks, stack.z_um, search, cells)
    wide = np.rint(uniform_filter(peaks.coarse.astype(float), (0, cells, cells), mode="nearest"))
    expected = stack.z_um[wide.argmax(axis=0)].repeat(4, 0).repeat(4, 1)[: z_um.shape[0], : z_um.shape[1]]
    assert z_um.shape == peaks.z_um.shape
    assert (z_um == expected).mean() > 0.995


def test_both_windows_see_a_tilted_plane(plane_stack: FieldStack, plane_um: NDArray[np.float64]) -> None:
    search = Search("tenengrad", 9, "blur_law", 4)
    peaks = search_field(prepare(plane_stack), search)
    z_um = wide_heights(peaks, plane_stack.z_um, search)
    inner = slice(16, -16), slice(16, -16)
    assert np.abs(z_um - plane_um)[inner].max() < 2.0
    assert np.abs(z_um - peaks.z_um)[inner].max() < 4.0


def test_the_second_window_is_about_twice_the_first() -> None:
    assert [wide_cells(window) for window in (3, 5, 9, 13, 17, 25)] == [1, 1, 3, 3, 5, 7]
