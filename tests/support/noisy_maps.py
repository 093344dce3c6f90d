"""Maps of known height with noise, salt and blobs: what cleaning is tested and measured on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def noisy_step(
    side_px: int = 512, blobs: int = 60, wrong_um: float = 136.0, seed: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """(truth, map): a step of 40 um, noise of 1.5 um, 3 % salt, blobs of 5 x 5; both up to wrong_um off."""
    rng = np.random.default_rng(seed)
    truth = np.zeros((side_px, side_px))
    truth[:, side_px // 2 :] = 40.0
    z = truth + rng.normal(0, 1.5, truth.shape)
    salt = rng.random(z.shape) < 0.03
    z[salt] = truth[salt] + rng.uniform(-wrong_um, wrong_um, np.count_nonzero(salt))
    for r, c in rng.integers(0, side_px - 5, (blobs, 2)):
        z[r : r + 5, c : c + 5] = truth[r : r + 5, c : c + 5] + rng.uniform(-wrong_um, wrong_um)
    return truth, z.astype(np.float32)


def rmse(z: NDArray[np.floating], truth: NDArray[np.floating]) -> float:
    """Over what is measured."""
    return float(np.sqrt(np.nanmean((z - truth) ** 2)))
