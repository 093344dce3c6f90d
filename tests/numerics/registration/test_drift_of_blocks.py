"""Drift of an overlap by the shifts of its blocks: none where only noise shifts them, however uneven their texture."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.numerics.block_gradients import BlockGradients, lag_errors

GRID = (8, 2)
RUNS = 800
PART_ROWS = 4


def drifts(random: np.random.Generator, unevenness: float, drift_px: float = 0.0) -> np.ndarray:
    """Drifts along rows and columns where noise and parts of 4 rows of blocks shift the blocks, [n, 2]."""
    index = np.argwhere(np.ones(GRID))
    n = len(index)
    found = np.empty((RUNS, 2))
    for k in range(RUNS):
        stiffness = 100 * np.exp(unevenness * random.normal(size=n))[:, None] * np.ones(2)
        parts = drift_px * random.normal(size=(GRID[0] // PART_ROWS, 2))
        pull = random.normal(size=(n, 2)) * np.sqrt(stiffness) + stiffness * parts[index[:, 0] // PART_ROWS]
        pull -= stiffness * pull.sum(axis=0) / stiffness.sum(axis=0)  # at the lag that fits best
        table = np.zeros((n, 13))
        table[:, 6:8] = pull
        table[:, [8, 11]] = stiffness
        total = np.zeros(9)
        total[2:6] = np.diag(stiffness.sum(axis=0)).ravel()
        found[k] = lag_errors(BlockGradients(index, table, total, GRID), total[2:6].reshape(2, 2), np.eye(2)).drift
    return found


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("unevenness", [0.0, 1.5])
def test_noise_alone_shows_no_drift(unevenness: float) -> None:
    found = drifts(np.random.default_rng(1), unevenness)
    error = found.std(axis=0) / np.sqrt(RUNS)
    assert (np.abs(found.mean(axis=0)) < 3 * error).all()


def test_a_drift_of_parts_is_shown_beyond_that_of_noise() -> None:
    found = drifts(np.random.default_rng(2), 0.5, drift_px=0.3)
    about_their_mean_px2 = 0.3**2 / 2
    assert 0.7 * about_their_mean_px2 < found.mean() < about_their_mean_px2  # neighbours at the border of parts differ
