"""Pixel size and rotation from lines of moves of a stage with errors."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.calibrate.image_geometry import StageLine, pixel_scale
from wafer_viewer.model.errors import RigError
from wafer_viewer.rigs.virtual.stage import LATERAL_ERROR_UM, LATERAL_WAVES_UM, ScaleError

STEP_UM, N_STEPS, SPREAD_UM = 250.0, 20, 30_000.0


def lines(seed, slope, axis, noise_px=0.02, n_lines=4):
    """Lines along an axis, on a stage with the errors of the virtual one."""
    rng = np.random.default_rng((seed, axis))
    off_x, off_y = (ScaleError((seed, n), LATERAL_ERROR_UM, LATERAL_WAVES_UM) for n in (1, 2))
    along = np.arange(N_STEPS + 1) * STEP_UM
    made = []
    for across in np.linspace(-SPREAD_UM / 2, SPREAD_UM / 2, n_lines):
        scale = along + 1j * across if axis == 0 else across + 1j * along
        true = np.array([z + off_x.at(z.real, z.imag) + 1j * off_y.at(z.real, z.imag) for z in scale])
        noise = noise_px * (rng.normal(size=N_STEPS) + 1j * rng.normal(size=N_STEPS))
        made.append(StageLine(np.diff(scale), np.diff(true) / slope + noise))
    return made


def test_hidden_pixel_sizes_and_rotations_are_covered_by_u():
    covered, expanded = [], []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        pixel_um, angle = 0.46729 * (1 + rng.uniform(-1e-3, 1e-3)), rng.uniform(-1e-3, 1e-3)
        slope = pixel_um * np.exp(1j * angle)
        found = pixel_scale(lines(seed, slope, 0), lines(seed, slope, 1))
        covered += [abs(found.pixel_um.value - pixel_um) <= 2 * found.pixel_um.u]
        covered += [abs(found.rotation_rad.value - angle) <= 2 * found.rotation_rad.u]
        expanded.append(2 * found.pixel_um.u / pixel_um)
    assert np.mean(covered) >= 0.9
    assert np.median(expanded) < 1e-4, "an uncertainty that is far too large is no help either"


def test_steps_without_a_match_and_wrong_matches_are_left_out():
    slope = 0.5 * np.exp(2e-3j)
    along_x, along_y = lines(0, slope, 0), lines(0, slope, 1)
    clean = pixel_scale(along_x, along_y)
    along_x[0].displaced_px[4] = np.nan
    along_y[1].displaced_px[9] += 7.0
    found = pixel_scale(along_x, along_y)
    assert found.n_rejected == 2
    assert found.pixel_um.value == pytest.approx(clean.pixel_um.value, rel=5e-5)


def test_the_scale_of_the_stage_is_in_u():
    slope = 0.5 + 0j
    args = lines(0, slope, 0), lines(0, slope, 1)
    without, with_scale = pixel_scale(*args), pixel_scale(*args, u_stage_fraction=1e-3)
    assert with_scale.pixel_um.u == pytest.approx(np.hypot(without.pixel_um.u, 5e-4), rel=1e-4)
    assert with_scale.rotation_rad == without.rotation_rad


def test_axes_that_are_not_square_show_as_shear():
    found = pixel_scale(lines(0, 0.5 * np.exp(1e-3j), 0), lines(0, 0.5 * np.exp(3e-3j), 1))
    assert found.shear_rad.value == pytest.approx(2e-3, abs=2 * found.shear_rad.u)


def test_lines_that_cannot_be_followed_are_refused():
    slope = 0.5 + 0j
    blind = [StageLine(line.moved_um, line.displaced_px * np.nan) for line in lines(0, slope, 1)]
    with pytest.raises(RigError, match="0 of the lines along y can be followed"):
        pixel_scale(lines(0, slope, 0), blind)
