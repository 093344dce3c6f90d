"""The delay from shifts between upward and downward sweeps."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.calibrate.trigger_delay import FocusSweepCurve, SweepPair, curve_shift_um, delay_error, sharpness
from wafer_viewer.model.errors import RigError


def curve(shift_um=0.0, noise=0.0, gain=1.0, centre_um=0.0, seed=0):
    z_um = np.arange(-21.0, 21.1, 2.1)
    values = gain * np.exp(-(((z_um - shift_um - centre_um) / 6) ** 2)) + 0.3
    return FocusSweepCurve(z_um, values + np.random.default_rng(seed).normal(0, noise, len(z_um)))


@pytest.mark.parametrize("shift_um", [-0.4, 0.0, 0.03, 0.5])
def test_a_shift_between_two_curves_is_found_in_spite_of_other_light(shift_um):
    assert curve_shift_um(curve(), curve(shift_um, gain=1.2)) == pytest.approx(shift_um, abs=2e-3)


def test_a_curve_without_a_peak_is_refused():
    flat = FocusSweepCurve(curve().z_um, np.random.default_rng(0).normal(1.0, 1e-3, 21))
    with pytest.raises(RigError, match="cannot be compared"):
        curve_shift_um(curve(), flat)


def test_delay_and_play_are_told_apart_and_covered_by_u():
    covered = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        delay_us, play_um = rng.uniform(-200, 200), rng.uniform(-0.1, 0.1)
        pairs = [
            SweepPair(v, play_um + delay_us * 1e-6 * v + rng.normal(0, 0.003)) for v in (200.0, 800.0) for _ in range(4)
        ]
        found = delay_error(pairs)
        covered += [abs(found.delay_us.value - delay_us) <= 2 * found.delay_us.u]
        covered += [abs(found.play_um.value - play_um) <= 2 * found.play_um.u]
    assert np.mean(covered) >= 0.9


@pytest.mark.parametrize("speeds", [(200.0, 800.0), (200.0,) * 6])
def test_a_delay_takes_pairs_at_two_speeds(speeds):
    with pytest.raises(RigError, match="4 pairs of sweeps at two speeds"):
        delay_error([SweepPair(v, 0.0) for v in speeds])


def test_sharpness_does_not_depend_on_the_light():
    image = np.random.default_rng(0).integers(50, 100, (40, 50)).astype(np.uint8)
    assert sharpness((2 * image).astype(np.uint8)) == pytest.approx(sharpness(image), rel=1e-3)
