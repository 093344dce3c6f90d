"""Radius and height of spheres on a tilted ground."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.support.surfaces import calibration, coordinates, noise_of, surface_of
from wafer_viewer.measure.tools.radius import bump_radius
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.recipe import Recipe

AROUND = Region.circle(0, 0, 27)
FOOT_UM = 20.0


def bump(
    radius_um=50.0,
    sign=1,
    seed=0,
    noise_um=0.0,
    correlation_px=8.0,
    tilt=0.01,
    u_pixel_um=0.0,
    foot_um=FOOT_UM,
    scale=1.0,
):
    """A cap with a foot of 20 um about (3, -2) um on a tilted plane; 1 in 1000 points is wrong."""
    x_um, y_um = np.meshgrid(*coordinates(140, 150))
    away2 = (x_um - 3) ** 2 + (y_um + 2) ** 2
    cap = np.sqrt(np.maximum(radius_um**2 - away2, 0)) - np.sqrt(radius_um**2 - foot_um**2)
    z = sign * np.where(away2 < foot_um**2, cap, 0) + tilt * x_um + noise_of(seed, x_um.shape, noise_um, correlation_px)
    z[np.random.default_rng(seed).random(z.shape) < 1e-3] += 30.0
    held = replace(calibration(u_z_scale=1e-6), u_pixel_um=u_pixel_um)
    return surface_of(z * scale, calibration=held, recipe=Recipe(window=9), z_step_um=4.0)


def height_um(radius_um, foot_um=FOOT_UM):
    return radius_um - np.sqrt(radius_um**2 - foot_um**2)


@pytest.mark.parametrize("radius_um", [20.5, 30.0, 50.0, 500.0])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_sphere_without_noise_is_found(radius_um, sign):
    found = bump_radius(bump(radius_um, sign, tilt=0.0), AROUND)
    assert found.kind == ("bump" if sign > 0 else "pit")
    assert found.radius.value_um == pytest.approx(radius_um, rel=2e-4)
    assert found.top.value_um == pytest.approx(sign * height_um(radius_um), abs=2e-3)
    assert (found.center.x_um, found.center.y_um) == (pytest.approx(3, abs=0.02), pytest.approx(-2, abs=0.02))
    assert found.main == found.radius.quantity


def test_a_tilted_ground_does_not_change_a_sphere():
    found = bump_radius(bump(50.0, tilt=0.03), AROUND)
    assert found.radius.value_um == pytest.approx(50.0, rel=0.01), "a cap on a slope is no longer quite a sphere"
    assert found.top.value_um == pytest.approx(height_um(50.0), abs=0.03)


@pytest.mark.parametrize(
    ("radius_um", "noise_um", "correlation_px"), [(30.0, 0.2, 8.0), (150.0, 0.06, 0.0), (150.0, 0.06, 4.0)]
)
def test_the_uncertainties_cover_the_errors(radius_um, noise_um, correlation_px):
    found = [bump_radius(bump(radius_um, 1, s, noise_um, correlation_px), AROUND) for s in range(10)]
    for lengths, truth in (
        ([f.radius for f in found], radius_um),
        ([f.top for f in found], height_um(radius_um)),
    ):
        errors = np.array([length.value_um - truth for length in lengths])
        expanded = np.array([length.expanded_um for length in lengths])
        assert np.mean(np.abs(errors) <= expanded) >= 0.9


@pytest.mark.parametrize("radius_um", [25.0, 50.0, 500.0])
def test_scales_enter_the_budget_of_a_radius_as_they_move_it(radius_um):
    surface, share = bump(radius_um, u_pixel_um=0.0005), 1e-3
    found = bump_radius(surface, AROUND).radius
    budget = {line.name: line.u_um for line in found.budget}
    wider = {name: getattr(surface, name) * (1 + share) for name in ("pixel_um", "x0_um", "y0_um")}
    by_pixel = bump_radius(dataclasses.replace(surface, **wider), AROUND).radius.value_um - found.value_um
    by_z = bump_radius(bump(radius_um, scale=1 + share), AROUND).radius.value_um - found.value_um
    assert budget["pixel scale"] == pytest.approx(abs(by_pixel), rel=0.01)
    assert budget["z scale"] == pytest.approx(abs(by_z) * 1e-6 / share, rel=0.02)


def test_frames_enter_the_budget_of_a_radius_over_the_height_of_its_cap():
    budget = {line.name: line.u_um for line in bump_radius(bump(), AROUND).radius.budget}
    assert budget["interpolation between frames"] == pytest.approx(0.02 * 50 / (0.7 * height_um(50.0)), rel=0.01)


def test_without_a_calibration_a_radius_reads_uncalibrated():
    found = bump_radius(bump(), AROUND, calibration_valid=False)
    assert (found.radius.status, found.radius.expanded_um, found.top.status) == ("uncalibrated", None, "uncalibrated")


def test_holes_in_a_bump_do_not_matter():
    surface = bump(noise_um=0.05)
    holes = np.random.default_rng(3).random(surface.shape) < 0.3
    surface.z_raw_um[holes] = np.nan
    assert bump_radius(surface, AROUND).radius.value_um == pytest.approx(50.0, rel=0.02)


def flat_ground():
    return bump(foot_um=0.0, noise_um=0.1)


def without_middle():
    surface = bump()
    surface.z_raw_um[50:90, 50:100] = np.nan
    return surface


@pytest.mark.parametrize(
    ("surface", "circle", "sentence"),
    [
        (bump, Region.rectangle(0, 0, 5, 5), "A radius is measured in a circle, this region is a rectangle"),
        (flat_ground, AROUND, "Nothing stands out of the surroundings"),
        (without_middle, AROUND, "Nothing is measured in the middle of the circle"),
        (bump, Region.circle(0, 0, 60), r"Round the circle 0 points are measured"),
        (bump, Region.circle(900, 0, 20), "lies outside of the surface"),
        (bump, Region.circle(3, -2, 1.5), "at least 50"),
    ],
)
def test_what_is_no_bump_is_one_sentence(surface, circle, sentence):
    with pytest.raises(MeasureError, match=sentence):
        bump_radius(surface(), circle)
