"""Pieces of windows, and how far fields fade out, wherever they lie."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.campaigns import examples
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.reconstruct.blending.mosaic_layout import MosaicLayout, layout
from wafer_viewer.reconstruct.blending.stitched_mosaic import blend_window
from wafer_viewer.reconstruct.blending.window_blend import pieces

MakeMap = Callable[..., HeightMap]
ROWS, COLS = 60, 80
RUN = st.tuples(st.integers(-20, 60), st.integers(1, 50)).map(lambda run: slice(run[0], run[0] + run[1]))


@settings(max_examples=examples(80))
@given(window=st.tuples(RUN, RUN), parts=st.lists(st.tuples(RUN, RUN), max_size=6))
def test_pieces_are_the_window_and_each_is_covered_alike_all_over(
    window: tuple[slice, slice], parts: list[tuple[slice, slice]]
) -> None:
    cover = np.full((len(parts) + 1, 140, 140), -1)
    for (rows, cols), numbers in pieces(window, parts):
        here = np.s_[rows.start + 20 : rows.stop + 20, cols.start + 20 : cols.stop + 20]
        assert (cover[-1][here] == -1).all()
        cover[-1][here] = 0
        for n in range(len(parts)):
            cover[n][here] = n in numbers
    rows, cols = (range(run.start, run.stop) for run in window)
    for r in rows:
        for c in cols:
            assert cover[-1, r + 20, c + 20] == 0
            for n, (of_rows, of_cols) in enumerate(parts):
                inside = of_rows.start <= r < of_rows.stop and of_cols.start <= c < of_cols.stop
                assert cover[n, r + 20, c + 20] == inside
    assert (cover[-1] == 0).sum() == len(rows) * len(cols)


def placed(make_map: MakeMap, *corners: tuple[float, float]) -> MosaicLayout:
    """Fields whose first pixels lie at (row, col) of the mosaic."""
    return layout([make_map(np.zeros((ROWS, COLS)), col * 0.5, -row * 0.5) for row, col in corners])


def ramps_px(arranged: MosaicLayout, n: int) -> tuple[float, ...]:
    place = arranged.place(n)
    assert place is not None
    return place.ramps_px


def test_a_ramp_is_as_long_as_the_overlap_with_the_neighbour_there(make_map: MakeMap) -> None:
    arranged = placed(make_map, (0, 0), (0, 64), (48, 0), (48, 64))
    assert ramps_px(arranged, 0) == (0, 11, 0, 15)
    assert ramps_px(arranged, 3) == (11, 0, 15, 0)


@pytest.mark.parametrize("drift", [-9, 0, 9])
def test_a_neighbour_below_that_lies_a_little_aside_is_not_one_beside(make_map: MakeMap, drift: int) -> None:
    arranged = placed(make_map, (0, 20), (48, 20 + drift))
    assert ramps_px(arranged, 0) == (0, 11, 0, 0)
    assert ramps_px(arranged, 1) == (11, 0, 0, 0)


def test_fields_like_bricks_fade_into_those_above(make_map: MakeMap) -> None:
    arranged = placed(make_map, (0, 40), (48, 0), (48, 64))
    assert ramps_px(arranged, 0) == (0, 11, 0, 0)
    assert ramps_px(arranged, 1) == (11, 0, 0, 15)


def test_an_island_does_not_fade(make_map: MakeMap) -> None:
    arranged = placed(make_map, (0, 0), (0, 500))
    assert ramps_px(arranged, 0) == ramps_px(arranged, 1) == (0, 0, 0, 0)
    assert arranged.touching(slice(0, 10), slice(100, 400)) == []
    assert arranged.touching(slice(0, 10), slice(79, 501)) == [0, 1]


def test_a_fractional_window_covers_the_pixels_inside(make_map: MakeMap) -> None:
    arranged = placed(make_map, (0, 0), (0.4, 64.7))
    assert arranged.window_of(1) == (slice(1, ROWS), slice(65, 64 + COLS))
    assert arranged.window_of(0) == (slice(0, ROWS), slice(0, COLS))


def test_a_line_of_pixels_between_two_of_the_mosaic_is_not_seen(make_map: MakeMap) -> None:
    maps = [make_map(np.zeros((ROWS, COLS))), make_map(np.zeros((1, COLS)), 1.0, -2.2)]
    assert layout(maps).touching(slice(0, 10), slice(0, 10)) == [0, 1]
    assert blend_window(maps, slice(0, ROWS), slice(0, COLS)).measured.all()
