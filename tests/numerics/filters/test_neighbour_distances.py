"""Distances to the nearest neighbours are those of a full search of the 7 x 7 window."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.campaigns import examples
from wafer_viewer.numerics.filters.denoising import NEIGHBOUR_REACH_PX, few_near, mean_distances


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
