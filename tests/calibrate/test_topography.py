"""Noise, flatness deviation, amplification and linearity from heights with known errors."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.calibrate.image_geometry import Estimate
from wafer_viewer.calibrate.topography import StepPair, flatness_deviation_um, measurement_noise_um, scale_response
from wafer_viewer.model.errors import MeasureError

ROWS, COLS = 96, 128


def maps(n, noise_um, form_um=0.0, texture_um=0.0, seed=0):
    """Tilted maps of one form, with noise, and with texture of their own."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[-1 : 1 : ROWS * 1j, -1 : 1 : COLS * 1j]
    form = form_um * (x**2 + y**2) / 2
    same = rng.normal(0, 1, (ROWS, COLS))
    made = []
    for _ in range(n):
        z = form + same + rng.normal() * x + rng.normal(0, noise_um, (ROWS, COLS)) + rng.normal(0, texture_um, x.shape)
        z[rng.random(z.shape) < 0.05] = np.nan
        made.append(z.astype(np.float32))
    return made


def test_noise_is_found_whatever_the_surface_and_its_drift():
    found = measurement_noise_um(maps(6, 0.05))
    assert found.value == pytest.approx(0.05, rel=0.02)
    assert found.value == pytest.approx(0.05, abs=2 * found.u + 0.05 / np.sqrt(6 * ROWS * COLS))


def test_flatness_is_the_range_of_the_form_within_u():
    found = flatness_deviation_um([m - s for m, s in zip(maps(9, 0.05, 0.4), maps(9, 0.05), strict=True)])
    assert found.value == pytest.approx(0.4 * 0.88, abs=0.05), "of blocks, whose centres are not at the corners"
    assert 0 < found.u < 0.05


@pytest.mark.parametrize("steps", [(10.0, 100.0, 400.0)])
def test_amplification_and_linearity_of_certified_steps(steps):
    made = [StepPair(Estimate(1.001 * h + (0.2 if h == 100 else 0), 0.02), Estimate(h, 0.02)) for h in steps]
    found = scale_response(made)
    assert found.amplification.value == pytest.approx(1.001, abs=3e-4)
    assert found.linearity_um is not None
    assert found.linearity_um.value == pytest.approx(0.2, abs=0.03)


def test_steps_of_one_height_tell_nothing_about_linearity():
    assert scale_response([StepPair(Estimate(400.4, 0.05), Estimate(400.0, 0.05))] * 2).linearity_um is None


def test_too_little_to_measure_by_is_refused():
    with pytest.raises(MeasureError, match="3 repeats; there are 2"):
        measurement_noise_um(maps(2, 0.1))
    with pytest.raises(MeasureError, match="4 places; there are 3"):
        flatness_deviation_um(maps(3, 0.1))
    with pytest.raises(MeasureError, match="signed checks"):
        scale_response([])
    empty = np.full((ROWS, COLS), np.nan, np.float32)
    with pytest.raises(MeasureError, match="Less than half of the field"):
        measurement_noise_um([empty] * 3)
