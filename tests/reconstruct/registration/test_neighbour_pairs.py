"""Which fields are compared: those beside each other, wherever they lie."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.campaigns import examples
from wafer_viewer.reconstruct.registration.overlap_strips import LEAST_WIDTH_PX, neighbours


@dataclass(frozen=True)
class Frame:
    x0_um: float
    y0_um: float
    shape: tuple[int, int] = (100, 140)
    pixel_um: float = 0.5


def grid(rows: int, cols: int, overlap: float = 0.12, jitter_um: float = 0.0) -> list[Frame]:
    rng = np.random.default_rng(1)
    pitch_x, pitch_y = 70 * (1 - overlap), 50 * (1 - overlap)
    off = rng.normal(0, jitter_um, (rows, cols, 2))
    return [Frame(c * pitch_x + off[r, c, 0], -r * pitch_y + off[r, c, 1]) for r in range(rows) for c in range(cols)]


def as_set(pairs: np.ndarray) -> set[tuple[int, int]]:
    return {(int(a), int(b)) for a, b in pairs}


def test_grid_neighbours_are_beside_and_below_not_diagonal():
    number = np.arange(20).reshape(4, 5)
    neighbour = zip(number[:, :-1].ravel(), number[:, 1:].ravel(), strict=True)
    below = zip(number[:-1].ravel(), number[1:].ravel(), strict=True)
    assert as_set(neighbours(grid(4, 5, 0.3))) == {(int(a), int(b)) for a, b in (*neighbour, *below)}


def test_they_are_sorted_whole_numbers_and_first_is_lower():
    pairs = neighbours(grid(3, 3))
    assert pairs.dtype == np.int32
    assert (pairs[:, 0] < pairs[:, 1]).all()
    assert pairs.tolist() == sorted(pairs.tolist())


def test_a_wide_overlap_also_joins_those_two_apart():
    assert as_set(neighbours(grid(1, 4, 0.6))) == {(0, 1), (1, 2), (2, 3), (0, 2), (1, 3)}


def test_fields_that_do_not_overlap_or_hardly_are_not_compared():
    narrow = (140 - LEAST_WIDTH_PX + 1) * 0.5
    assert len(neighbours([Frame(0, 0), Frame(narrow, 0), Frame(0, 500)])) == 0
    assert as_set(neighbours([Frame(0, 0), Frame(narrow - 1.5, 0)])) == {(0, 1)}


def test_none_one_and_several_at_one_place():
    assert neighbours([]).shape == (0, 2)
    assert neighbours([Frame(0, 0)]).shape == (0, 2)
    assert as_set(neighbours([Frame(0, 0)] * 3)) == {(0, 1), (0, 2), (1, 2)}


def test_a_small_field_within_a_large_one_is_compared():
    assert as_set(neighbours([Frame(0, 0), Frame(20, -20, (30, 40))])) == {(0, 1)}


@settings(max_examples=examples(30))
@given(st.lists(st.tuples(st.floats(-100, 100), st.floats(-100, 100)), max_size=25))
def test_as_when_all_are_compared_with_all(corners: list[tuple[float, float]]):
    frames = [Frame(x, y) for x, y in corners]

    def shared(a: Frame, b: Frame) -> tuple[float, float]:
        return 140 - abs(a.x0_um - b.x0_um) / 0.5, 100 - abs(a.y0_um - b.y0_um) / 0.5

    expected = {
        (i, j)
        for j in range(len(frames))
        for i in range(j)
        for wide, high in [shared(frames[i], frames[j])]
        if min(wide, high) >= LEAST_WIDTH_PX + 1e-6 and (wide >= 70 or high >= 50)
    }
    found = as_set(neighbours(frames))
    assert expected <= found
    assert all(min(shared(frames[i], frames[j])) > LEAST_WIDTH_PX - 1e-6 for i, j in found)
