"""Which rectangles meet a window and each other, against looking at all of them."""

from __future__ import annotations

import itertools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.campaigns import examples
from wafer_viewer.reconstruct.blending.mosaic_layout import Rectangles


def scattered(n: int, seed: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    top, left = rng.uniform(-300, 300, (2, n))
    height, width = rng.uniform(1, 120, (2, n))
    top[rng.random(n) < 0.1] = np.nan
    return top, top + height, left, left + width


@settings(max_examples=examples(60))
@given(n=st.integers(0, 40), seed=st.integers(0, 9999), at=st.tuples(*[st.floats(-400, 400)] * 2))
def test_a_window_meets_what_shares_a_point_with_it(n: int, seed: int, at: tuple[float, float]) -> None:
    top, bottom, left, right = scattered(n, seed)
    row, col, end_row, end_col = *at, at[0] + 70, at[1] + 150
    with np.errstate(invalid="ignore"):
        meets = (top <= end_row) & (bottom >= row) & (left <= end_col) & (right >= col)
    assert (
        Rectangles.of(top, bottom, left, right).intersecting(row, end_row, col, end_col)
        == np.flatnonzero(meets).tolist()
    )


@settings(max_examples=examples(60))
@given(n=st.integers(0, 40), seed=st.integers(0, 9999))
def test_each_pair_that_shares_a_point_is_found_once(n: int, seed: int) -> None:
    top, bottom, left, right = scattered(n, seed)
    first, second = Rectangles.of(top, bottom, left, right).pairs()
    found = [tuple(sorted(pair)) for pair in zip(first.tolist(), second.tolist(), strict=True)]
    assert len(set(found)) == len(found)
    assert set(found) == {
        (a, b)
        for a, b in itertools.combinations(range(n), 2)
        if top[a] <= bottom[b] and top[b] <= bottom[a] and left[a] <= right[b] and left[b] <= right[a]
    }


def test_many_are_not_looked_at_one_by_one() -> None:
    rows, cols = np.divmod(np.arange(250_000), 500)
    fields = Rectangles.of(rows * 90.0, rows * 90.0 + 99, cols * 90.0, cols * 90.0 + 99)
    assert fields.intersecting(900.0, 980.0, 1800.0, 1880.0) == [
        9 * 500 + 19,
        9 * 500 + 20,
        10 * 500 + 19,
        10 * 500 + 20,
    ]
    first, _ = fields.pairs()
    assert len(first) == 2 * 499 * 500 + 2 * 499**2
