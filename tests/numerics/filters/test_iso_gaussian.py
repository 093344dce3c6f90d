"""The Gaussian filter, polynomials and the autocorrelation of lattices with holes, against their definitions."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.numerics.filters.gaussian import ALPHA, gaussian_mean
from wafer_viewer.numerics.filters.interpolation import polynomial
from wafer_viewer.numerics.fourier import autocorrelation

RNG = np.random.default_rng(4)


def holed(shape, share=0.3):
    z = RNG.normal(size=shape)
    z[RNG.random(shape) < share] = np.nan
    return z


@pytest.mark.parametrize("cutoff_px", [6.0, 25.5, 90.0])
@pytest.mark.parametrize("period_px", [20, 40, 100])
def test_a_wave_passes_as_the_norm_says(cutoff_px, period_px):
    wave = np.cos(2 * np.pi * np.arange(600) / period_px)
    middle = slice(200, 400)
    passed = np.exp(-np.pi * (ALPHA * cutoff_px / period_px) ** 2)
    assert gaussian_mean(wave, cutoff_px)[middle] == pytest.approx(passed * wave[middle], abs=2e-6)
    assert gaussian_mean(wave, float(period_px))[middle] == pytest.approx(wave[middle] / 2, abs=2e-6)


def test_holes_and_borders_have_no_weight():
    z, cutoff_px = holed((25, 31)), 9.0
    at = 3, 29
    rows, cols = np.mgrid[:25, :31]
    weights = np.exp(-np.pi * ((rows - at[0]) ** 2 + (cols - at[1]) ** 2) / (ALPHA * cutoff_px) ** 2)
    weights *= (np.abs(rows - at[0]) <= cutoff_px) & (np.abs(cols - at[1]) <= cutoff_px) & np.isfinite(z)
    z[at] = z[at] if np.isfinite(z[at]) else 0.5
    weights[at] = 1.0
    assert gaussian_mean(z, cutoff_px)[at] == pytest.approx(np.nansum(weights * z) / weights.sum(), rel=1e-9)
    assert (np.isnan(gaussian_mean(z, cutoff_px)) == np.isnan(z)).all()


def test_a_level_surface_stays_level_to_the_border():
    assert gaussian_mean(np.full((40, 30), 7.0), 25.0) == pytest.approx(7.0)


@pytest.mark.parametrize("order", [0, 1, 3, 5])
def test_polynomials_are_those_of_least_squares(order):
    z = holed((30, 45)) + 100
    y, x = (np.linspace(-1, 1, n) for n in z.shape)
    design = np.stack([np.outer(y**i, x ** (t - i)).ravel() for t in range(order + 1) for i in range(t + 1)], axis=1)
    valid = np.isfinite(z).ravel()
    expected = design @ np.linalg.lstsq(design[valid], z.ravel()[valid], rcond=None)[0]
    assert polynomial(z, order) == pytest.approx(expected.reshape(z.shape), abs=1e-9)


def test_points_that_do_not_determine_a_polynomial_give_none():
    z = np.full((30, 40), np.nan)
    z[10] = 1.0
    assert polynomial(z, 1) is None
    assert polynomial(z, 0) == pytest.approx(1.0)


def test_a_lag_is_over_the_pairs_that_it_has():
    z = holed((40, 50))
    z -= np.nanmean(z)
    found = autocorrelation(z)
    assert found.shape == (41, 51)
    assert found[20, 25] == pytest.approx(1)
    pairs = z[3:, :-7] * z[:-3, 7:]
    assert found[20 + 3, 25 - 7] == pytest.approx(np.nanmean(pairs) / np.nanmean(z**2))
    assert found == pytest.approx(found[::-1, ::-1])


def test_without_holes_pairs_are_counted_alike():
    full = RNG.normal(size=(40, 50))
    edge = full.copy()
    edge[0, 0] = np.nan
    assert autocorrelation(full) == pytest.approx(autocorrelation(edge), abs=0.02)


def test_lags_with_hardly_any_pairs_have_no_value():
    z = np.full((60, 60), np.nan)
    z[:6] = RNG.normal(size=(6, 60))
    found = autocorrelation(z)
    assert np.isnan(found[30 + 20]).all()
    assert np.isfinite(found[30]).all()
