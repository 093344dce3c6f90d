"""Levy smoothing: the literal equations keep the noise, the guided form and the switching median remove it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from wafer_viewer.model.recipe import Levy
from wafer_viewer.reconstruct.levy import AUTO_ITERATIONS, SMOOTHERS, flight_lengths, smooth


@pytest.fixture(scope="module")
def step_um() -> NDArray:
    truth = np.zeros((200, 200))
    truth[:, 100:] = 40
    return truth


@pytest.fixture(scope="module")
def noisy(step_um: NDArray) -> NDArray[np.float32]:
    """Noise, 3 % salt, blobs: the map of the measurements behind the default."""
    rng = np.random.default_rng(3)
    z = step_um + rng.normal(0, 1.5, step_um.shape)
    salt = rng.random(z.shape) < 0.03
    z[salt] = rng.uniform(-60, 100, np.count_nonzero(salt))
    for r, c in rng.integers(2, 195, (8, 2)):
        z[r : r + 3, c : c + 3] = rng.uniform(-60, 100)
    return z.astype(np.float32)


def _rmse(z: NDArray, truth: NDArray) -> float:
    return float(np.sqrt(np.mean((z - truth) ** 2)))


def _smoothed(noisy: NDArray, mode: str, **settings: float) -> NDArray:
    return smooth(noisy, Levy(mode=mode, **settings), AUTO_ITERATIONS[mode], 0.0)


def test_the_literal_equations_do_not_reduce_noise(noisy: NDArray, step_um: NDArray) -> None:
    assert _rmse(_smoothed(noisy, "literal"), step_um) >= _rmse(noisy, step_um)


@pytest.mark.parametrize(("mode", "left"), [("guided", 0.35), ("switching_median", 0.25)])
def test_the_other_forms_do(noisy: NDArray, step_um: NDArray, mode: str, left: float) -> None:
    smoothed = _smoothed(noisy, mode)
    assert _rmse(smoothed, step_um) < left * _rmse(noisy, step_um)
    inner = np.abs(smoothed - step_um)[:, 97:103]
    assert np.median(inner) < 2


@pytest.mark.parametrize("mode", SMOOTHERS)
def test_the_same_seed_gives_the_same_map_and_nan_stays(noisy: NDArray, mode: str) -> None:
    holed = noisy.copy()
    holed[50:60, 40:90] = np.nan
    before = holed.copy()
    first = _smoothed(holed, mode, seed=7)
    np.testing.assert_array_equal(first, _smoothed(holed, mode, seed=7))
    np.testing.assert_array_equal(np.isnan(first), np.isnan(holed))
    np.testing.assert_array_equal(holed, before)


def test_another_seed_flies_elsewhere(noisy: NDArray) -> None:
    assert (_smoothed(noisy, "guided", seed=1) != _smoothed(noisy, "guided", seed=2)).any()


def test_what_is_quiet_is_left_alone() -> None:
    rows, cols = np.indices((60, 60))
    quiet = (0.1 * rows + 0.05 * cols).astype(np.float32)
    np.testing.assert_array_equal(smooth(quiet, Levy(), 6, 0.2), quiet)


def test_flights_of_beta_2_are_gaussian_and_smaller_ones_have_long_tails() -> None:
    rng = np.random.default_rng(1)
    tails = [np.mean(flight_lengths(rng, 200_000, beta) > 10) for beta in (0.8, 1.5, 1.95)]
    assert tails[0] > tails[1] > tails[2] > 0
