"""5 x 5 medians that leave out NaN are exact."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.support.campaigns import examples
from wafer_viewer.numerics.filters.denoising import median_outliers, medians_at, pad_with_nan


def _map(seed: int, holes: float) -> NDArray[np.float32]:
    rng = np.random.default_rng(seed)
    z = rng.normal(0, 1, (23, 31)).astype(np.float32).round(1)
    z[rng.random(z.shape) < holes] = np.nan
    return z


@pytest.mark.filterwarnings("ignore:All-NaN slice")
@settings(max_examples=examples(25))
@given(seed=st.integers(0, 500), holes=st.sampled_from([0.0, 0.2, 0.9]))
def test_a_median_is_that_of_numpy(seed: int, holes: float) -> None:
    z = _map(seed, holes)
    padded = pad_with_nan(z)
    rows, cols = (a.ravel() for a in np.indices(z.shape))
    windows = np.lib.stride_tricks.sliding_window_view(padded, (5, 5)).reshape(z.size, 25)
    np.testing.assert_allclose(medians_at(padded, rows, cols), np.nanmedian(windows, axis=1), rtol=1e-6)


@settings(max_examples=examples(25))
@given(seed=st.integers(0, 500), holes=st.sampled_from([0.0, 0.3]), limit=st.floats(0.15, 2))
def test_counting_finds_the_same_pixels_as_sorting(seed: int, holes: float, limit: float) -> None:
    z = _map(seed, holes)
    padded = pad_with_nan(z)
    far = median_outliers(padded, np.float32(limit))
    for r, c in np.ndindex(z.shape):
        window = np.sort(padded[r : r + 5, c : c + 5], axis=None)
        window = window[np.isfinite(window)]
        if np.isnan(z[r, c]):
            assert not far[r, c]
            continue
        low, high = window[(window.size - 1) // 2], window[window.size // 2]
        away = max(low - z[r, c], z[r, c] - high, 0)
        if abs(away - limit) > 1e-4:
            assert far[r, c] == (away > limit)
