"""Smoothing: the literal equations keep the noise, the other forms take it away and leave what is there."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from tests.support.noisy_maps import noisy_step, rmse
from wafer_viewer.model.surface.recipe import Levy
from wafer_viewer.reconstruct.cleaning.clean import MOST_ROUNDS, settle_levy
from wafer_viewer.reconstruct.cleaning.levy_flight import (
    NOISE_LAG_PX,
    SMOOTHERS,
    flight_lengths,
    height_noise_um,
    smooth,
)

FACTS = {"literal": 30, "guided": 30, "switching_median": 6, "sigma_filter": 2}


@pytest.fixture(scope="module")
def step() -> tuple[NDArray, NDArray[np.float32]]:
    return noisy_step()


def _levy(mode: str, **settings: float) -> Levy:
    return Levy(**{"mode": mode, "n_sigma": 3.0, "alpha": 0.5, "iterations": FACTS.get(mode, 1), **settings})


@pytest.mark.campaign
def test_the_literal_equations_raise_the_error_of_a_noisy_map(step: tuple[NDArray, NDArray]) -> None:
    truth, z = step
    assert rmse(z, truth) == pytest.approx(14.90, abs=0.05)
    after = [rmse(smooth(z, _levy("literal", seed=seed), 10.0), truth) for seed in range(5)]
    assert min(after) > rmse(z, truth) + 0.2
    assert np.median(after) < 18


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize(("mode", "left_um"), [("guided", 1.80), ("switching_median", 1.58), ("sigma_filter", 0.55)])
def test_the_other_forms_take_salt_and_blobs_away(step: tuple[NDArray, NDArray], mode: str, left_um: float) -> None:
    truth, z = step
    smoothed = smooth(z, _levy(mode), 10.0)
    assert rmse(smoothed, truth) < left_um
    assert np.corrcoef(smoothed.ravel(), truth.ravel())[0, 1] > 0.995


def test_the_literal_form_is_that_of_the_equations() -> None:
    """Written down once more from the page: eq. 12 once, then eq. 13 and 14; R and Z a matrix each."""
    levy = _levy("literal", alpha=0.3, iterations=40, seed=5)
    z = np.random.default_rng(2).normal(0, 1, (2, 2)).astype(np.float32)
    rng = np.random.default_rng(5)

    def flight() -> NDArray:
        signs = np.sign(rng.standard_normal(4, np.float32))
        return (0.3 * signs * flight_lengths(rng, 4, levy.beta)).reshape(2, 2)

    estimates = [z + flight()]
    for _ in range(39):
        candidate = estimates[-1] + flight()
        chi_ini, chi_new = np.mean((z - estimates[-1]) ** 2), np.mean((z - candidate) ** 2)
        estimates.append(candidate if chi_new < chi_ini else estimates[-1])
    np.testing.assert_allclose(smooth(z, levy, 10.0), estimates[-1], atol=1e-5)
    assert len({float(e[0, 0]) for e in estimates}) > 2


@pytest.mark.slow
def test_smoothing_changes_only_outliers(step: tuple[NDArray, NDArray]) -> None:
    _, z = step
    for mode in ("guided", "switching_median"):
        assert np.mean(smooth(z, _levy(mode), 10.0) != z) < 0.07


@pytest.mark.parametrize("mode", SMOOTHERS)
def test_the_same_seed_gives_the_same_map_and_nan_stays(step: tuple[NDArray, NDArray], mode: str) -> None:
    holed = step[1][:150, 180:330].copy()
    holed[50:60, 40:90] = np.nan
    before = holed.copy()
    first = smooth(holed, _levy(mode, seed=7, iterations=6), 10.0)
    np.testing.assert_array_equal(first, smooth(holed, _levy(mode, seed=7, iterations=6), 10.0))
    np.testing.assert_array_equal(np.isnan(first), np.isnan(holed))
    np.testing.assert_array_equal(holed, before)


def test_another_seed_flies_elsewhere(step: tuple[NDArray, NDArray]) -> None:
    z = step[1][:100, :100]
    assert (smooth(z, _levy("guided", seed=1), 10.0) != smooth(z, _levy("guided", seed=2), 10.0)).any()


@pytest.mark.parametrize("mode", SMOOTHERS)
def test_a_map_without_heights_stays_empty(mode: str) -> None:
    assert np.isnan(smooth(np.full((40, 40), np.nan, np.float32), _levy(mode), 2.0)).all()


def test_a_quiet_slope_is_left_alone_up_to_the_border_of_the_map_and_of_a_gap() -> None:
    rows, cols = np.indices((60, 60))
    quiet = (0.4 * rows + 0.05 * cols).astype(np.float32)
    quiet[20:30, 20:30] = np.nan
    np.testing.assert_allclose(smooth(quiet, _levy("sigma_filter"), 4.0), quiet, atol=1e-4)
    gentle = quiet * np.float32(0.25)
    np.testing.assert_array_equal(smooth(gentle, _levy("switching_median"), 6.0), gentle)


def _square(height_um: float, side_px: int, tilt: int = 0) -> NDArray[np.bool_]:
    """A square in the middle of 120 x 120 pixels, on its edge or on its corner."""
    rows, cols = np.indices((120, 120)) - 60
    half = side_px / 2
    return (
        (np.abs(rows + cols) <= half) & (np.abs(rows - cols) <= half)
        if tilt
        else ((np.abs(rows) <= half) & (np.abs(cols) <= half))
    )


@pytest.mark.parametrize("noise_um", [0.0, 0.3])
@pytest.mark.parametrize("tilt", [0, 45])
def test_a_sharp_corner_stays(noise_um: float, tilt: int) -> None:
    die = _square(40, 60, tilt)
    z = (np.where(die, 40, 0) + np.random.default_rng(1).normal(0, noise_um, die.shape)).astype(np.float32)
    smoothed = smooth(z, _levy("sigma_filter"), 3.0)
    assert np.abs(smoothed - np.where(die, 40, 0)).max() < 1.5


@pytest.mark.campaign
def test_a_bump_20_px_wide_and_three_deviations_high_keeps_its_height_and_width() -> None:
    bump = _square(3, 20)
    rest = [smooth(np.where(bump, 3, 0) + _noise(seed), _levy("sigma_filter"), 10.0) for seed in range(5)]
    mean = np.mean(rest, axis=0)
    assert mean[55:66, 55:66].mean() > 0.92 * 3
    assert np.count_nonzero(mean[60] > 1.5) == pytest.approx(21, abs=2)


def _noise(seed: int) -> NDArray[np.float32]:
    return np.random.default_rng(seed).normal(0, 1, (120, 120)).astype(np.float32)


def test_a_map_that_is_half_false_does_not_blur_a_step_of_the_other_half() -> None:
    z = np.where(np.indices((120, 120))[1] < 60, 0.0, 9.0)
    z[60:] = np.random.default_rng(1).uniform(0, 400, (60, 120))
    smoothed = smooth(z.astype(np.float32), _levy("sigma_filter"), 4.0)
    np.testing.assert_allclose(smoothed[:38], z[:38], atol=1e-4)  # beyond the reach of averages and corrections
    np.testing.assert_allclose(smoothed[:50], z[:50], atol=0.1)


@pytest.mark.parametrize("length_px", [40, 80])
@pytest.mark.parametrize("noise_um", [0.0, 0.1])
def test_waves_are_nowhere_flattened_by_more_than_the_noise_that_goes(length_px: int, noise_um: float) -> None:
    x = np.arange(160) * np.ones((160, 1))
    truth = 2 * np.cos(2 * np.pi * x / length_px)
    noise = gaussian_filter(np.random.default_rng(3).normal(0, 1, x.shape), 2.0)
    z = (truth + noise_um * noise / noise.std()).astype(np.float32)
    smoothed = smooth(z, _levy("sigma_filter"), 1.0)
    assert rmse(smoothed, truth) <= max(1.02 * rmse(z, truth), 0.05)


def test_a_noisy_slope_is_smoothed_as_much_as_level_ground() -> None:
    x = np.arange(160) * np.ones((160, 1))
    noise = gaussian_filter(np.random.default_rng(3).normal(0, 1, x.shape), 2.0)
    noise = (0.1 * noise / noise.std()).astype(np.float32)
    inner = slice(10, -10)
    left = [rmse(smooth((t * x + noise).astype(np.float32), _levy("sigma_filter"), 1.0), t * x) for t in (0.0, 0.5)]
    assert left[1] == pytest.approx(left[0], rel=0.05)
    assert left[0] < 0.75 * float(noise[inner, inner].std())


def test_a_narrow_ridge_stays() -> None:
    z = np.zeros((60, 60), np.float32)
    z[:, 30:32] = 20
    np.testing.assert_allclose(smooth(z, _levy("sigma_filter"), 2.0), z, atol=1e-5)


def test_flights_of_beta_2_are_gaussian_and_smaller_ones_have_long_tails() -> None:
    rng = np.random.default_rng(1)
    tails = [np.mean(flight_lengths(rng, 200_000, beta) > 10) for beta in (0.8, 1.5, 1.95)]
    assert tails[0] > tails[1] > tails[2] > 0


def test_the_noise_of_a_slope_is_that_of_its_errors() -> None:
    slope = 0.3 * np.indices((120, 120)).sum(axis=0)
    assert height_noise_um((slope + _noise(3)).astype(np.float32)) == pytest.approx(1, rel=0.1)
    assert height_noise_um(np.zeros((NOISE_LAG_PX, NOISE_LAG_PX), np.float32)) == 0


@pytest.mark.parametrize("mode", SMOOTHERS)
def test_what_is_auto_is_chosen_from_the_map_and_nothing_else(step: tuple[NDArray, NDArray], mode: str) -> None:
    z = step[1][:128, 200:328]
    settled = settle_levy([z], Levy(mode=mode), 10.0)
    assert "auto" not in (settled.n_sigma, settled.alpha, settled.iterations)
    assert settled.iterations <= MOST_ROUNDS[mode]
    fixed = Levy(mode=mode, n_sigma=2.0, alpha=0.7, iterations=4)
    assert settle_levy([z], fixed, 10.0) == fixed


def test_a_map_with_spikes_has_a_narrower_limit_than_clean_noise(step: tuple[NDArray, NDArray]) -> None:
    assert settle_levy([step[1]], Levy(), 10.0).n_sigma == 3.0
    assert settle_levy([_noise(1)], Levy(), 10.0).n_sigma > 3.0


@pytest.mark.parametrize("beta", [1.0, 1.5, 1.95])
def test_flights_of_the_chosen_length_converge_for_any_beta(step: tuple[NDArray, NDArray], beta: float) -> None:
    truth, z = step
    levy = settle_levy([z], Levy(mode="guided", n_sigma=3.0, beta=beta, iterations=30), 10.0)
    assert rmse(smooth(z, levy, 10.0), truth) < 1.65


@pytest.mark.slow
def test_the_iteration_ends_when_nothing_changes(step: tuple[NDArray, NDArray]) -> None:
    quiet = np.zeros((64, 64), np.float32)
    assert all(settle_levy([quiet], Levy(mode=mode), 2.0).iterations == 1 for mode in SMOOTHERS if mode != "literal")
    assert settle_levy([step[1]], Levy(mode="literal"), 10.0).iterations == 1
    assert settle_levy([step[1]], Levy(), 10.0).iterations == 2
