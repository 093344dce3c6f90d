"""Filters for the picture: a defect of any size stands out of coarse grain further than a mean over pixels shows."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from wafer_viewer.measure.defects.matched_filters import BINS, DIAMETERS_PX, SHARP, SOFT, matched, spectrum_of
from wafer_viewer.numerics.filters.gaussian import coarseness

SHAPE, CELLS = (180, 200), 6
ROW, COL = 70, 110
WHITE = np.ones(BINS, np.float32)


def coarse_grain(seed: int) -> np.ndarray:
    """Grain of deviation 1 that is alike over some pixels, with a little uncorrelated noise."""
    rng = np.random.default_rng(seed)
    grain = gaussian_filter(rng.standard_normal(SHAPE), 2.5)
    return (grain / grain.std() + 0.1 * rng.standard_normal(SHAPE)).astype(np.float32)


def disc(diameter_px: float) -> np.ndarray:
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    sharp = (np.hypot(rows - ROW, cols - COL) <= diameter_px / 2).astype(np.float32)
    return gaussian_filter(sharp, 0.9)


def deviations(answer: np.ndarray, noise: np.ndarray) -> float:
    """How far the place of the disc stands out, in deviations of the answer to noise alone."""
    return float(np.abs(answer[ROW - 3 : ROW + 4, COL - 3 : COL + 4]).max() / np.nanstd(noise))


def spectrum() -> np.ndarray:
    return spectrum_of([coarse_grain(seed) for seed in range(CELLS)])


def test_a_small_disc_stands_out_further_than_of_any_mean() -> None:
    grain, by = coarse_grain(100), spectrum()
    shown = grain - 2 * disc(6)
    filtered = deviations(matched(shown, by, ())[SHARP, 6.0], matched(grain, by, ())[SHARP, 6.0])
    means = [deviations(gaussian_filter(shown, s), gaussian_filter(grain, s)) for s in (0.7, 1.5, 2.5, 4)]
    assert filtered > 1.5 * max(means)


@pytest.mark.parametrize("diameter", DIAMETERS_PX)
def test_a_disc_is_answered_loudest_by_the_filter_of_its_size(diameter: float) -> None:
    by, grain = spectrum(), coarse_grain(100)
    alone, noise = matched(disc(diameter), by, ()), matched(grain, by, ())
    best = max(DIAMETERS_PX, key=lambda d: deviations(alone[SHARP, d], noise[SHARP, d]))
    assert best == diameter


def test_few_defects_are_not_taken_for_noise() -> None:
    cells = [coarse_grain(seed) for seed in range(CELLS)]
    cells[0] = cells[0] + 30 * disc(14)
    assert spectrum_of(cells) == pytest.approx(spectrum(), rel=0.35)


def test_uncorrelated_noise_has_the_same_power_everywhere() -> None:
    rng = np.random.default_rng(3)
    cells = [rng.standard_normal(SHAPE).astype(np.float32) for _ in range(CELLS)]
    assert spectrum_of(cells)[20:80] == pytest.approx(1, abs=0.15)


def test_unmeasured_pixels_give_no_result() -> None:
    nothing = np.full(SHAPE, np.nan, np.float32)
    assert spectrum_of([nothing]) == pytest.approx(1)
    assert matched(nothing, WHITE, (4.0,)) == {}


def test_wide_scales_are_filtered_on_squares_of_pixels() -> None:
    answers = matched(coarse_grain(1), spectrum(), (0.0, 1.5, 4.0, 10.0))
    assert {key for key in answers if key[0] == SOFT} == {(SOFT, 4.0), (SOFT, 10.0)}
    side = coarseness(10.0)
    assert answers[SOFT, 10.0].shape == (SHAPE[0] // side, SHAPE[1] // side)


def test_the_border_of_what_is_known_is_no_defect() -> None:
    by, grain = spectrum(), coarse_grain(7)
    cut = grain + 5
    cut[:, 150:] = np.nan
    answer = matched(cut, by, ())[SHARP, 6.0]
    noise = float(np.nanstd(matched(grain, by, ())[SHARP, 6.0]))
    assert np.isnan(answer[:, 150:]).all()
    assert np.nanmax(np.abs(answer[:, 140:150])) < 6 * noise
    assert np.nanmax(np.abs(answer[:, :10])) < 6 * noise
