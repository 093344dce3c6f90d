"""Splines into gaps are natural cubic splines, run by run."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from tests.support.campaigns import examples
from wafer_viewer.numerics.filters.interpolation import fill_gaps, fill_rows


@settings(max_examples=examples(40))
@given(seed=st.integers(0, 500), share=st.floats(0.1, 0.6))
def test_gaps_take_the_values_of_a_natural_cubic_spline(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    z = rng.normal(0, 3, (1, 60)).astype(np.float32)
    z[0, rng.random(60) < share] = np.nan
    valid = np.flatnonzero(np.isfinite(z[0]))
    if valid.size < 3:
        return
    inside = np.arange(valid[0], valid[-1] + 1)
    expected = CubicSpline(valid, z[0, valid].astype(float), bc_type="natural")(inside)
    filled = fill_rows(z, 60, np.inf)
    np.testing.assert_allclose(filled[0, inside], expected, atol=1e-4)
    assert np.isnan(filled[0, : valid[0]]).all()
    assert np.isnan(filled[0, valid[-1] + 1 :]).all()


@settings(max_examples=examples(40))
@given(seed=st.integers(0, 500), max_gap=st.integers(1, 12))
def test_only_gaps_up_to_the_limit_are_filled(seed: int, max_gap: int) -> None:
    rng = np.random.default_rng(seed)
    row = np.zeros(120, np.float32)
    gaps: list[tuple[int, int]] = []
    at = 2
    while at < 100:
        wide = int(rng.integers(1, 16))
        row[at : at + wide] = np.nan
        gaps.append((at, wide))
        at += wide + int(rng.integers(1, 6))
    z = fill_rows(row[None], max_gap, 1.0)
    for at, wide in gaps:
        assert np.isfinite(z[0, at : at + wide]).all() == (wide <= max_gap and at + wide < 120)


def test_empty_and_single_rows_are_left_alone() -> None:
    z = np.full((3, 10), np.nan, np.float32)
    z[1, 4] = 2
    np.testing.assert_array_equal(fill_rows(z, 9, 1.0), z)


@settings(max_examples=examples(30))
@given(seed=st.integers(0, 500), at=st.integers(5, 25), step=st.sampled_from([-40.0, 7.0, 300.0]))
def test_no_run_crosses_a_step_and_each_side_is_filled_by_itself(seed: int, at: int, step: float) -> None:
    rng = np.random.default_rng(seed)
    z = rng.normal(0, 0.5, (1, 30)).astype(np.float32)
    z[0, rng.random(30) < 0.3] = np.nan
    stepped = z.copy()
    stepped[0, at:] += np.float32(step)
    sides = [fill_rows(np.ascontiguousarray(part), 9, 3.0) for part in (stepped[:, :at], stepped[:, at:])]
    np.testing.assert_allclose(fill_rows(stepped, 9, 3.0), np.concatenate(sides, axis=1), rtol=1e-5)


def test_rows_and_columns_count_alike() -> None:
    rng = np.random.default_rng(1)
    z = rng.normal(0, 1, (40, 50)).astype(np.float32)
    z[rng.random(z.shape) < 0.4] = np.nan
    filled = fill_gaps(z, 6, np.inf)
    np.testing.assert_allclose(filled, fill_gaps(z.T, 6, np.inf).T, rtol=1e-6)
    np.testing.assert_array_equal(filled[np.isfinite(z)], z[np.isfinite(z)])


def test_a_gap_too_long_both_ways_stays_even_where_its_corners_are_short() -> None:
    rows, cols = np.indices((40, 40)) - 20
    disc = np.hypot(rows, cols) < 9
    filled = fill_gaps(np.where(disc, np.nan, 0).astype(np.float32), 9, 1.0)
    assert np.isnan(filled[disc & (np.abs(rows) < 5) & (np.abs(cols) < 5)]).all()
