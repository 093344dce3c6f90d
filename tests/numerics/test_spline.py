"""Splines into gaps are natural cubic splines, run by run."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from wafer_viewer.numerics.spline import fill_rows


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 500), share=st.floats(0.1, 0.6))
def test_gaps_take_the_values_of_a_natural_cubic_spline(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    z = rng.normal(0, 3, (1, 60)).astype(np.float32)
    z[0, rng.random(60) < share] = np.nan
    known = np.flatnonzero(np.isfinite(z[0]))
    if known.size < 3:
        return
    inside = np.arange(known[0], known[-1] + 1)
    expected = CubicSpline(known, z[0, known].astype(float), bc_type="natural")(inside)
    filled = z.copy()
    fill_rows(filled, 60, np.inf)
    np.testing.assert_allclose(filled[0, inside], expected, atol=1e-4)
    assert np.isnan(filled[0, : known[0]]).all()
    assert np.isnan(filled[0, known[-1] + 1 :]).all()


@settings(max_examples=40, deadline=None)
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
    z = row[None].copy()
    fill_rows(z, max_gap, 1.0)
    for at, wide in gaps:
        assert np.isfinite(z[0, at : at + wide]).all() == (wide <= max_gap and at + wide < 120)


def test_empty_and_single_rows_are_left_alone() -> None:
    z = np.full((3, 10), np.nan, np.float32)
    z[1, 4] = 2
    before = z.copy()
    fill_rows(z, 9, 1.0)
    np.testing.assert_array_equal(z, before)
