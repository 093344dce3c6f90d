"""The mean of pairs: slopes stay, steps stay, noise goes."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.campaigns import examples
from wafer_viewer.numerics.filters.denoising import pair_mean


@settings(max_examples=examples(20))
@given(seed=st.integers(0, 500), limit=st.floats(0.1, 3), holes=st.sampled_from([0.0, 0.4]))
def test_each_pixel_is_averaged_with_the_pairs_that_agree(seed: int, limit: float, holes: float) -> None:
    rng = np.random.default_rng(seed)
    z = rng.normal(0, 1, (9, 11)).astype(np.float32)
    z[rng.random(z.shape) < holes] = np.nan
    padded = np.pad(z, 4, constant_values=np.nan).astype(float)
    got = pair_mean(z, limit)
    for r, c in np.ndindex(z.shape):
        window = padded[r : r + 9 : 2, c : c + 9 : 2]
        offs = ((window + window[::-1, ::-1]) / 2 - padded[r + 4, c + 4]).ravel()[:12]
        if np.min(np.abs(np.abs(offs) - limit), initial=1, where=np.isfinite(offs)) < 1e-5:
            continue
        agree = offs[np.abs(offs) <= limit]
        expected = z[r, c] + agree.sum() / (agree.size + 0.5)
        np.testing.assert_allclose(got[r, c], expected, atol=1e-5)


def test_steep_planes_stay_up_to_their_borders() -> None:
    rows, cols = np.indices((40, 50))
    z = (7.0 * rows - 3.0 * cols).astype(np.float32)
    z[12:20, 30:41] = np.nan
    np.testing.assert_allclose(pair_mean(z, 0.01), z, atol=1e-4)


def test_noise_shrinks_and_a_step_stays_sharp() -> None:
    truth = np.zeros((200, 200), np.float32)
    truth[:, 100:] = 20
    z = truth + np.random.default_rng(1).normal(0, 1, truth.shape).astype(np.float32)
    off = pair_mean(z, 4.0) - truth
    assert off.std() < 0.33
    assert np.abs(off[:, 98:102]).mean() < 0.4
