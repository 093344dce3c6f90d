"""Scenes drawn by seed: the same seed gives the same bits, the sample lies within the sweep, faults are seen."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from tests.support.campaigns import drawn_after
from tests.truth.unseen import FEWEST_FRAMES, MOST_FRAMES, Unseen, drawn_scene

SIDE = 96


@cache
def seen_scene(seed: int) -> Unseen:
    """The scene of a seed as all tests look at it."""
    return drawn_scene(seed, SIDE)


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("seed", [2, 3])
def test_a_seed_gives_the_same_bits_again(seed):
    one, again, other = seen_scene(seed), drawn_scene(seed, SIDE), seen_scene(seed + 2)
    assert np.array_equal(one.stack.images, again.stack.images)
    assert one.instrument != other.instrument


@pytest.mark.slow
@pytest.mark.parametrize("seed", drawn_after(2, range(8)))
def test_the_sweep_covers_the_sample(seed):
    one = seen_scene(seed)
    z_um = one.stack.z_um
    assert FEWEST_FRAMES <= len(z_um) <= MOST_FRAMES
    assert z_um[0] < one.truth_um.min() <= one.truth_um.max() < z_um[-1]
    assert one.stack.depth_of_field_um in (0.0, one.instrument.depth_of_field_um)


@pytest.mark.campaign
def test_dark_frames_and_flashes_show():
    scenes = [seen_scene(seed) for seed in range(0, 60, 2)]
    assert {s.instrument.dark for s in scenes} == {s.instrument.flashes for s in scenes} == {0, 1}
    for one in scenes:
        levels = one.stack.images.mean(axis=(1, 2))
        assert (levels < 2).sum() >= one.instrument.dark
        assert (levels > 254).sum() >= one.instrument.flashes
