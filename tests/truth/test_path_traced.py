"""Path-traced scenes: what is seen lies where the truth says, and bright metal where the sample has it."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from tests.truth.path_traced import FINE, MARGIN_PX, PIXEL_UM, Solid, drawn_solid, light_of

pytestmark = pytest.mark.skipif(find_spec("mitsuba") is None, reason="Mitsuba is not installed")
SIDE = 48


def a_corner_raised() -> Solid:
    """A level sample whose upper left quarter is higher, and whose upper right quarter is brighter."""
    n = FINE * (SIDE + 2 * MARGIN_PX)
    rows, cols = np.mgrid[:n, :n]
    upper, left = rows < n // 2, cols < n // 2
    grain = np.random.default_rng(1).uniform(0.5, 1.0, (n // 4, n // 4)).repeat(4, axis=0).repeat(4, axis=1)
    reflectance = (np.where(upper & ~left, 0.9, 0.3) * grain).astype(np.float32)
    height_um = np.where(upper & left, 12.0, 0.0).astype(np.float32)
    return Solid("corner", height_um, reflectance, np.zeros((n, n), bool), 0.3)


@pytest.mark.campaign
def test_each_part_is_sharp_at_its_own_height_and_where_it_lies() -> None:
    low, high = light_of(a_corner_raised(), 0.4, np.array([0.0, 12.0]), SIDE, 128, 1)
    quarters = {
        "raised": (slice(1, 12), slice(1, 12)),
        "bright": (slice(1, 12), slice(-12, -1)),
        "lower left": (slice(-12, -1), slice(1, 12)),
        "lower right": (slice(-12, -1), slice(-12, -1)),
    }
    contrast = {name: (low[part].std() / low[part].mean(), high[part].std() / high[part].mean())
                for name, part in quarters.items()}  # fmt: skip
    assert contrast.pop("raised")[1] > 1.6 * low[quarters["raised"]].std() / low[quarters["raised"]].mean()
    assert all(at_low > 1.6 * at_high for at_low, at_high in contrast.values())
    assert low[quarters["bright"]].mean() > 2 * low[quarters["lower left"]].mean()
    assert low[quarters["bright"]].mean() > 2 * low[quarters["lower right"]].mean()


@pytest.mark.slow
def test_kinds_of_samples_and_their_walls() -> None:
    solids = [drawn_solid(SIDE, np.random.default_rng(seed)) for seed in range(24)]
    assert {solid.name for solid in solids} == {"dies", "balls", "pits", "step"}
    assert 0 < sum(solid.metal.any() for solid in solids) < len(solids)
    for solid in solids:
        assert 0 < solid.reflectance.min() <= solid.reflectance.max() < 1
        assert np.ptp(solid.height_um) > 3 * PIXEL_UM
