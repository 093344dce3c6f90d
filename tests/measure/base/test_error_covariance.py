"""Uncertainty of means by the covariance of errors: what it says where it is known, small faces, what is told."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.surfaces import PIXEL_UM, calibration, coordinates, noise_of, surface_of
from wafer_viewer.measure.base.error_covariance import UNRESOLVED_NOTE, ErrorCovariance, WeightedHeights
from wafer_viewer.measure.base.height_samples import HeightSamples
from wafer_viewer.measure.tools.step_height import step_height
from wafer_viewer.model.region import Region

UPPER, LOWER = Region.rectangle(-30, -10, -10, 10), Region.rectangle(10, -10, 30, 10)
"""Faces of 40 px, the gap between them as wide."""


def samples(z_um):
    x_um, y_um = np.meshgrid(*coordinates(*z_um.shape))
    return HeightSamples(x_um.ravel(), y_um.ravel(), z_um.ravel())


def u_of_mean(z_um):
    points = samples(z_um)
    errors = ErrorCovariance.of(points, points.z_um - points.z_um.mean(), PIXEL_UM, 1)
    return errors.scatter(WeightedHeights.of(points, np.full(len(points), 1 / len(points)))).u


@pytest.mark.parametrize("side_px", [100, 600])
def test_the_mean_of_white_noise_is_surer_by_the_root_of_its_points(side_px):
    assert u_of_mean(noise_of(1, (side_px, side_px), 0.1)) == pytest.approx(0.1 / side_px, rel=0.1)


@pytest.mark.parametrize("correlation_px", [4.0, 9.0])
def test_the_mean_of_correlated_noise_has_as_many_points_as_are_independent(correlation_px):
    """White noise smoothed by a Gaussian of half that: its correlation integrates to pi times the square."""
    found = u_of_mean(noise_of(2, (400, 400), 0.1, correlation_px))
    assert found == pytest.approx(0.1 * np.sqrt(np.pi) * correlation_px / 400, rel=0.2)


def test_a_face_that_is_noisier_than_what_surrounds_it_counts_as_it_is():
    points = samples(noise_of(3, (60, 60), 0.1))
    quiet = ErrorCovariance(np.full((1, 1), 0.01**2), PIXEL_UM, 1000.0, 3)
    design = np.ones((len(points), 1))
    assert quiet.covering(points, design, points.z_um).variance_um2 == pytest.approx(0.01, rel=0.1)
    assert quiet.covering(points, design, 0.1 * points.z_um) is quiet


def stepped(correlation_px, around=True, seed=1):
    """A step of 5 um; around: measured beyond the two faces as well."""
    x_um, y_um = np.meshgrid(*coordinates(300, 300))
    z_um = np.where(x_um < 0, 5.0, 0.0) + noise_of(seed, x_um.shape, 0.1, correlation_px)
    if not around:
        z_um[~(UPPER.contains(x_um, y_um) | LOWER.contains(x_um, y_um))] = np.nan
    return surface_of(z_um, calibration=calibration(0.0))


@pytest.mark.slow
def test_small_faces_have_the_errors_of_what_surrounds_them():
    found = [step_height(stepped(32.0, seed=seed), UPPER, LOWER) for seed in range(10)]
    assert np.mean([abs(step.height.value_um - 5) <= step.height.expanded_um for step in found]) >= 0.8
    assert not any(UNRESOLVED_NOTE in step.notes for step in found)
    alone = [step_height(stepped(32.0, around=False, seed=seed), UPPER, LOWER) for seed in range(10)]
    rest = [np.median([step.height.expanded_um for step in steps]) for steps in (found, alone)]
    assert rest[0] > 1.2 * rest[1], "a face does not show the error that is alike over all of it"


def test_a_small_face_alone_says_that_its_errors_are_not_resolved():
    alone = step_height(stepped(32.0, around=False), UPPER, LOWER)
    assert UNRESOLVED_NOTE in alone.notes
    fine = step_height(stepped(0.0, around=False), UPPER, LOWER)
    assert UNRESOLVED_NOTE not in fine.notes
