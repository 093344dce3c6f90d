"""Distances to the nearest neighbours are those of a full search of the 7 x 7 window."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from tests.support.campaigns import examples
from wafer_viewer.numerics.filters.denoising import NEIGHBOUR_REACH_PX, distances_in_cloud, few_near, mean_distances


@settings(max_examples=examples(20))
@given(seed=st.integers(0, 500), neighbours=st.integers(4, 24), holes=st.sampled_from([0.0, 0.3, 0.85]))
def test_the_mean_distance_is_that_of_a_sorted_window(seed: int, neighbours: int, holes: float) -> None:
    rng = np.random.default_rng(seed)
    z = rng.normal(0, 1, (17, 19)).astype(np.float32)
    z[rng.random(z.shape) < holes] = np.nan
    padded = np.pad(z, NEIGHBOUR_REACH_PX, constant_values=np.nan)
    rows, cols = np.nonzero(np.isfinite(z))
    expected = []
    for r, c in zip(rows, cols, strict=True):
        away = np.abs(padded[r : r + 7, c : c + 7] - z[r, c]).ravel()
        near = np.sort(np.delete(away, 24))
        near = near[np.isfinite(near)][:neighbours]
        expected.append(near.mean() if 2 * near.size >= neighbours else np.inf)
    found = mean_distances(padded, rows, cols, neighbours)
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    away = [np.abs(padded[r : r + 7, c : c + 7] - z[r, c]) <= 0.4 for r, c in zip(rows, cols, strict=True)]
    few = few_near(padded, 0.4, neighbours)
    np.testing.assert_array_equal(few[rows, cols], [np.count_nonzero(a) - 1 < neighbours for a in away])


def test_distances_in_the_cloud_are_those_of_a_search_tree_or_not_given() -> None:
    """On a slope with a step, gaps and 2 % of false heights: most of these are further away than is looked."""
    rng = np.random.default_rng(3)
    z = rng.normal(0, 0.5, (90, 110)) + 0.1 * np.arange(110)
    z[:, 60:] += 40
    false = rng.random(z.shape) < 0.02
    z[false] += rng.uniform(20, 60, np.count_nonzero(false))
    z[rng.random(z.shape) < 0.05] = np.nan
    z = z.astype(np.float32)
    found = distances_in_cloud(z, 0.467, 15)
    rows, cols = np.nonzero(np.isfinite(z))
    points = np.stack([0.467 * cols, 0.467 * rows, z[rows, cols]], axis=1)
    searched = np.full(z.shape, np.nan)
    searched[rows, cols] = cKDTree(points).query(points, 16)[0][:, 1:].mean(axis=1)
    near = np.isfinite(found)
    np.testing.assert_allclose(found[near], searched[near], rtol=1e-9)
    assert np.isnan(found[np.isnan(z)]).all()
    assert np.mean(near[np.isfinite(z)]) > 0.95
    assert np.mean(near[false & np.isfinite(z)]) < 0.2


def test_a_single_point_has_no_distance_in_the_cloud() -> None:
    z = np.full((5, 7), np.nan, np.float32)
    z[2, 3] = 1.0
    assert np.isnan(distances_in_cloud(z, 1.0, 4)).all()
