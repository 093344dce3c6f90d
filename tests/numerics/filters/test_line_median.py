"""What stands apart along all four lines is what sorting each of them would find."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.support.campaigns import examples
from wafer_viewer.numerics.filters.denoising import LINE_REACH_PX, beside_lines, line_medians_at, line_outliers

ALONG = ((0, 1), (1, 0), (1, 1), (1, -1))


def _map(seed: int, holes: float) -> NDArray[np.float32]:
    rng = np.random.default_rng(seed)
    z = rng.normal(0, 1, (19, 26)).astype(np.float32)
    z[rng.random(z.shape) < holes] = np.nan
    return np.pad(z, LINE_REACH_PX, constant_values=np.nan)


def _lines(padded: NDArray, row: int, col: int) -> list[NDArray]:
    steps = np.arange(-LINE_REACH_PX, LINE_REACH_PX + 1)
    lines = (padded[row + LINE_REACH_PX + steps * down, col + LINE_REACH_PX + steps * right] for down, right in ALONG)
    return [np.sort(line[np.isfinite(line)]) for line in lines]


@settings(max_examples=examples(20))
@given(seed=st.integers(0, 500), holes=st.sampled_from([0.0, 0.3]), limit=st.floats(0.05, 1.5))
def test_counting_finds_the_same_pixels_as_sorting(seed: int, holes: float, limit: float) -> None:
    padded = _map(seed, holes)
    far = line_outliers(padded, np.float32(limit))
    for r, c in np.ndindex(far.shape):
        v = padded[r + LINE_REACH_PX, c + LINE_REACH_PX]
        if np.isnan(v):
            assert not far[r, c]
            continue
        middles = [(line[(line.size - 1) // 2], line[line.size // 2]) for line in _lines(padded, r, c)]
        away = min(max(low - v, v - high, 0) for low, high in middles)
        if abs(away - limit) > 1e-4:
            assert far[r, c] == (away > limit)


@settings(max_examples=examples(20))
@given(seed=st.integers(0, 500), holes=st.sampled_from([0.0, 0.5]))
def test_the_replacement_is_the_middle_of_the_four_medians(seed: int, holes: float) -> None:
    padded = _map(seed, holes)
    rows, cols = np.nonzero(np.isfinite(padded[LINE_REACH_PX:-LINE_REACH_PX, LINE_REACH_PX:-LINE_REACH_PX]))
    expected = [np.median([np.median(line) for line in _lines(padded, r, c)]) for r, c in zip(rows, cols, strict=True)]
    np.testing.assert_allclose(line_medians_at(padded, rows, cols), expected, atol=1e-6)


@settings(max_examples=examples(20))
@given(seed=st.integers(0, 500), changed=st.integers(0, 6))
def test_what_changes_shows_only_beside_the_lines_through_it(seed: int, changed: int) -> None:
    rng = np.random.default_rng(seed)
    z = np.repeat(rng.normal(0, 1, (40, 5)), 60, axis=1).astype(np.float32)
    padded = np.pad(z, LINE_REACH_PX, constant_values=np.nan)
    inner = padded[LINE_REACH_PX:-LINE_REACH_PX, LINE_REACH_PX:-LINE_REACH_PX]
    before = line_outliers(padded, 1.0)
    rows, cols = rng.integers(0, 40, changed), rng.integers(0, 300, changed)
    inner[rows, cols] += 5
    near = beside_lines(rows, cols, z.shape)
    found, beside = line_outliers(padded, 1.0, near), line_outliers(padded, 1.0)
    covered = near.repeat(64, axis=1)[:, :300]
    np.testing.assert_array_equal(found, beside & covered)
    np.testing.assert_array_equal(beside[~covered], before[~covered])


@pytest.mark.parametrize("wide", [1, 3, 5])
def test_a_blob_up_to_five_pixels_wide_is_an_outlier(wide: int) -> None:
    for side, apart in ((wide, True), (wide + 6, False)):
        z = np.zeros((40, 40), np.float32)
        z[15 : 15 + side, 15 : 15 + side] = 9
        far = line_outliers(np.pad(z, LINE_REACH_PX, constant_values=np.nan), 1.0)
        np.testing.assert_array_equal(far, (z > 0) & apart)
