"""Pieces that hang together are those a flood would find."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import binary_opening, label

from tests.support.campaigns import examples
from wafer_viewer.numerics.filters.regions import border_components, component_sizes, narrow_parts


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


@settings(max_examples=examples(30))
@given(seed=st.integers(0, 500), share=st.floats(0.6, 0.98), side=st.integers(2, 5))
def test_narrow_parts_are_what_an_opening_removes(seed: int, share: float, side: int) -> None:
    z = np.where(np.random.default_rng(seed).random((24, 33)) < share, 0.0, np.nan).astype(np.float32)
    valid = np.isfinite(z)
    opened = binary_opening(np.pad(valid, side, mode="edge"), np.ones((side, side)))[side:-side, side:-side]
    np.testing.assert_array_equal(narrow_parts(z, 6.0, side), valid & ~opened)


def test_a_strip_between_steps_is_narrow() -> None:
    z = np.zeros((20, 30), np.float32)
    z[:, 10:13] = 50
    expected = np.zeros((20, 30), bool)
    expected[:, 10:13] = True
    np.testing.assert_array_equal(narrow_parts(z, 6.0, 4), expected)
    assert not narrow_parts(z, 6.0, 3).any()


@settings(max_examples=examples(30))
@given(seed=st.integers(0, 500), share=st.floats(0.3, 0.8), depth=st.integers(1, 14))
def test_components_at_the_border_are_those_that_reach_no_deeper(seed: int, share: float, depth: int) -> None:
    mask = np.random.default_rng(seed).random((24, 33)) < share
    labels = np.asarray(label(mask, np.ones((3, 3)))[0])
    deep = np.isin(labels, labels[depth:-depth, depth:-depth])
    expected = mask & ~deep if 2 * depth < 24 else np.zeros_like(mask)
    np.testing.assert_array_equal(border_components(mask, depth), expected)
