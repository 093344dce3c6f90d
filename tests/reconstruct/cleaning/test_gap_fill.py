"""Small gaps are filled smoothly and marked; nothing is filled across a step."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.model.surface.recipe import Fill
from wafer_viewer.reconstruct.cleaning.clean import fill, mark_filled


def _wave() -> NDArray[np.float32]:
    rows, cols = np.indices((90, 110))
    return (6 * np.sin(cols / 11) + 4 * np.cos(rows / 13)).astype(np.float32)


def test_small_holes_of_a_smooth_surface_are_filled_closely() -> None:
    holed = _wave()
    for r, c in ((20, 30), (50, 70), (70, 12)):
        holed[r : r + 8, c : c + 8] = np.nan
    filled = fill(holed, Fill(), 4.0)
    assert np.isfinite(filled).all()
    assert np.abs(filled - _wave()).max() < 0.25


def test_larger_holes_stay() -> None:
    holed = _wave()
    holed[20:40, 30:50] = np.nan
    np.testing.assert_array_equal(np.isnan(fill(holed, Fill(max_gap_px=9), 4.0)), np.isnan(holed))
    assert np.isfinite(fill(holed, Fill(mode="all"), 4.0)).all()


def test_nothing_is_filled_across_a_step() -> None:
    z = np.zeros((60, 60), np.float32)
    z[:, 30:] = 40
    z[:, 27:33] = np.nan
    filled = fill(z, Fill(max_gap_px=9), 4.0)
    assert np.isnan(filled[:, 27:33]).all()


def test_a_spline_does_not_feel_the_step_next_to_its_gap() -> None:
    z = np.zeros((60, 60), np.float32)
    z[:, 30:] = 40
    z[10:14, 22:26] = np.nan
    np.testing.assert_allclose(fill(z, Fill(), 4.0)[10:14, 22:26], 0, atol=1e-6)


def test_what_was_measured_is_not_moved() -> None:
    holed = _wave()
    holed[5:9, 5:9] = np.nan
    measured = np.isfinite(holed)
    np.testing.assert_array_equal(fill(holed, Fill(), 4.0)[measured], holed[measured])


def test_filled_pixels_are_marked_and_empty_ones_keep_their_reason() -> None:
    origin = np.array([[0, Origin.AMBIGUOUS, Origin.CLIPPED]], np.uint8)
    marked = mark_filled(origin, np.array([[1.0, 2.0, np.nan]], np.float32))
    assert marked.tolist() == [[Origin.MEASURED, Origin.FILLED, Origin.CLIPPED]]


def test_no_filling_is_a_choice() -> None:
    holed = _wave()
    holed[5, 5] = np.nan
    assert np.isnan(fill(holed, Fill(mode="none"), 4.0)[5, 5])


def _halves(seed: int) -> NDArray[np.float32]:
    """Noise with a hole at each border, in each corner and in the middle."""
    z = np.random.default_rng(seed).normal(0, 0.1, (60, 70)).astype(np.float32)
    for rows, cols in ((0, 30), (56, 30), (25, 0), (25, 66), (0, 0), (56, 66), (30, 30)):
        z[rows : rows + 4, cols : cols + 4] = np.nan
    return z


@pytest.mark.parametrize("mode", ["small_gaps", "all"])
def test_nothing_is_made_up_beyond_what_is_measured_on_both_sides(mode: str) -> None:
    filled = fill(_halves(1), Fill(mode=mode), 4.0)
    corners = filled[[0, 0, -1, -1], [0, 3, -1, -4]]
    assert np.isnan(corners).all()
    assert np.isfinite(filled[30:34, 30:34]).all()
    assert np.isfinite(filled[0:4, 30:34]).all()
    assert np.nanmax(np.abs(filled)) < 1.0


def test_the_paper_s_way_fills_whatever_has_measured_sides_and_leaves_the_rest() -> None:
    z = np.full((40, 50), np.nan, np.float32)
    z[10:30:19, 5:45] = 7.0
    filled = fill(z, Fill(mode="all"), 4.0)
    inside = np.zeros(z.shape, bool)
    inside[10:30, 5:45] = True
    np.testing.assert_array_equal(np.isfinite(filled), inside)
    np.testing.assert_allclose(filled[inside], 7.0)


def test_filling_rows_first_is_not_seen_in_the_result() -> None:
    holed = _wave()
    holed[np.random.default_rng(2).random(holed.shape) < 0.3] = np.nan
    np.testing.assert_allclose(fill(holed, Fill(), 4.0), fill(holed.T, Fill(), 4.0).T, rtol=1e-5)
