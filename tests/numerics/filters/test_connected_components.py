"""Pieces that hang together are those a flood would find."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import label

from tests.support.campaigns import examples
from wafer_viewer.numerics.filters.regions import component_sizes


@settings(max_examples=examples(30))
@given(seed=st.integers(0, 500), share=st.floats(0.3, 0.8), min_pixels=st.integers(1, 12))
def test_islands_of_two_levels_are_those_of_scipy(seed: int, share: float, min_pixels: int) -> None:
    rng = np.random.default_rng(seed)
    z = np.where(rng.random((24, 33)) < share, 0.0, 50.0).astype(np.float32)
    z[rng.random(z.shape) < 0.1] = np.nan
    expected = np.zeros(z.shape, bool)
    for level in (0.0, 50.0):
        labels, _ = label(z == level)
        expected |= (labels > 0) & (np.bincount(labels.ravel())[labels] < min_pixels)
    np.testing.assert_array_equal(np.isfinite(z) & (component_sizes(z, 6.0) < min_pixels), expected)


def test_a_slope_hangs_together() -> None:
    z = (np.arange(200, dtype=np.float32) * 5)[None].repeat(3, axis=0)
    assert (component_sizes(z, 6.0) == z.size).all()
    assert (component_sizes(z, 4.0) == 3).all()
