"""Step heights, and whether their uncertainty tells the truth."""

from __future__ import annotations

import numpy as np
import pytest

from tests.measure.surfaces import height_map, step_surface
from wafer_viewer.measure.step import step_height
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region

UPPER, LOWER = Region.rectangle(-90, -45, -10, 45), Region.rectangle(10, -45, 90, 45)


def test_an_exact_step_is_found_exactly_on_a_tilted_sample():
    found = step_height(step_surface(399.88, tilt=5e-4), UPPER, LOWER)
    assert found.height.value_um == pytest.approx(399.88, abs=1e-4)
    assert found.relative_tilt_mrad == pytest.approx(0.0, abs=1e-3)
    assert (found.upper_points, found.lower_points) == (160 * 180, 160 * 180)


def test_outliers_do_not_move_it():
    surface = step_surface(30.0, noise_um=0.5, seed=3)
    wild = np.random.default_rng(5).random(surface.shape) < 0.01
    z = np.where(wild, surface.z_um + 50.0, surface.z_um)
    assert step_height(height_map(z), UPPER, LOWER).height.value_um == pytest.approx(30.0, abs=0.03)


@pytest.mark.parametrize("correlation_px", [0.0, 2.0, 8.0])
def test_the_noise_in_the_budget_is_the_spread_over_many_surfaces(correlation_px):
    found = [
        step_height(step_surface(10.0, rows=100, noise_um=1.0, correlation_px=correlation_px, seed=s), UPPER, LOWER)
        for s in range(40)
    ]
    spread = np.std([f.height.value_um for f in found])
    stated = np.mean([f.height.budget[0].u_um for f in found])
    assert 0.6 < stated / spread < 1.5
    assert abs(np.mean([f.height.value_um for f in found]) - 10.0) < 3 * spread / np.sqrt(40) + 0.01


def test_the_expanded_uncertainty_covers_the_error_in_nine_of_ten_surfaces():
    surfaces = (step_surface(10.0, rows=100, noise_um=1.0, correlation_px=4.0, seed=s) for s in range(50))
    lengths = [step_height(s, UPPER, LOWER).height for s in surfaces]
    covered = [abs(h.value_um - 10.0) <= (h.expanded_um or 0.0) for h in lengths]
    assert np.mean(covered) >= 0.9


def test_the_z_scale_counts_in_proportion_to_the_height():
    budget = {c.name: c.u_um for c in step_height(step_surface(400.0), UPPER, LOWER).height.budget}
    assert budget["z scale"] == pytest.approx(400 * 5e-4)


def test_faces_tilted_against_each_other_are_told_and_counted():
    x = (np.arange(400) - 199.5) * 0.5
    z = np.tile(np.where(x < 0, 400.0, 3e-4 * x), (200, 1))
    found = step_height(height_map(z), UPPER, LOWER)
    assert found.relative_tilt_mrad == pytest.approx(0.3, abs=0.01)
    assert found.height.value_um == pytest.approx(400.0, abs=0.002)
    assert {c.name: c.u_um for c in found.height.budget}["relative tilt of the faces"] > 0.004


@pytest.mark.parametrize(("kind", "valid"), [({"calibration": None}, True), ({}, False)])
def test_without_a_calibration_that_holds_there_is_no_uncertainty(kind, valid):
    height = step_height(step_surface(10.0, **kind), UPPER, LOWER, calibration_valid=valid).height
    assert (height.status, height.expanded_um) == ("uncalibrated", None)


@pytest.mark.parametrize(
    ("upper", "words"),
    [
        (Region.rectangle(-20, -20, 20, 20), "share"),
        (Region.rectangle(-20, -20, -19, -19), "needs 64"),
        (Region.rectangle(500, 500, 600, 600), "outside"),
    ],
)
def test_regions_that_cannot_be_measured_say_what_to_do(upper, words):
    with pytest.raises(MeasureError, match=words):
        step_height(step_surface(10.0), upper, LOWER)


def test_unmeasured_points_are_left_out_and_mentioned():
    surface = step_surface(10.0)
    z = surface.z_um.copy()
    z[:, 50:120] = np.nan
    found = step_height(height_map(z), UPPER, LOWER)
    assert found.height.value_um == pytest.approx(10.0, abs=1e-4)
    assert "upper region is measured" in found.notes[0]
