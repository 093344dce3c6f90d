"""The angle between faces whose tilts are known."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.surfaces import calibration, coordinates, noise_of, surface_of
from wafer_viewer.measure.base.levelled_surface import levelled
from wafer_viewer.measure.tools.angle import face_angle
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.tool_options import Levelling
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.recipe import Recipe

LEFT, RIGHT = Region.rectangle(-70, -45, -5, 45), Region.rectangle(5, -45, 70, 45)


def roof(left=0.2, right=-0.1, across=0.0, seed=0, noise_um=0.0, correlation_px=8.0, u_pixel_um=0.0):
    """Two faces with slopes along x that meet at x = 0; the right one is tilted across as well; 1 in 1000 is wrong."""
    x_um, y_um = np.meshgrid(*coordinates(200, 300))
    z = np.where(x_um < 0, left * x_um, right * x_um + across * y_um) + noise_of(
        seed, x_um.shape, noise_um, correlation_px
    )
    z[np.random.default_rng(seed).random(z.shape) < 1e-3] += 30.0
    held = replace(calibration(u_z_scale=1e-6), u_pixel_um=u_pixel_um)
    return surface_of(z, calibration=held, recipe=Recipe(window=9), z_step_um=4.0)


def true_angle_deg(left=0.2, right=-0.1, across=0.0):
    m, n = np.array([-left, 0, 1]), np.array([-right, -across, 1])
    return np.degrees(np.arccos(m @ n / np.linalg.norm(m) / np.linalg.norm(n)))


@pytest.mark.parametrize("slopes", [(0.2, -0.1, 0.0), (0.0, 0.0, 0.3), (1.0, -1.0, 0.0), (0.02, 0.02, 0.001)])
def test_an_angle_without_noise_is_exact(slopes):
    found = face_angle(roof(*slopes), LEFT, RIGHT)
    assert found.angle.value == pytest.approx(true_angle_deg(*slopes), abs=2e-4)
    assert found.first_tilt_deg == pytest.approx(np.degrees(np.arctan(slopes[0])), abs=2e-4)
    assert (found.main, found.main.unit) == (found.angle, "deg")
    assert found.first_sq_um < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("correlation_px", [0.0, 8.0])
def test_the_uncertainty_covers_the_noise_of_the_faces(correlation_px):
    found = [
        face_angle(roof(seed=s, noise_um=0.5, correlation_px=correlation_px), LEFT, RIGHT).angle for s in range(20)
    ]
    errors = np.array([angle.value - true_angle_deg() for angle in found])
    expanded = np.array([angle.expanded for angle in found])
    assert np.mean(np.abs(errors) <= expanded) >= 0.9
    noise = [line.u for angle in found for line in angle.budget if line.name == "noise and form of the faces"]
    assert np.mean(noise) < 2 * errors.std(), "nor is it far too large"


def test_scales_that_are_wrong_change_a_steep_angle_as_the_budget_says():
    surface = roof(u_pixel_um=0.0005)
    found = face_angle(surface, LEFT, RIGHT)
    wider = {line.name: line.u for line in found.angle.budget}["pixel scale"]
    assert wider == pytest.approx(true_angle_deg() - true_angle_deg(0.2 / 1.001, -0.1 / 1.001), rel=0.01)


def test_levelling_tilts_both_faces_alike():
    surface = levelled(roof(0.1, 0.1, 0.02), Levelling(by="region", places=(LEFT,)))
    found = face_angle(surface, LEFT, RIGHT)
    assert found.first_tilt_deg == pytest.approx(0, abs=1e-4)
    assert found.angle.value == pytest.approx(np.degrees(np.arctan(0.02)), abs=1e-3)


@pytest.mark.parametrize(
    ("first", "second", "sentence"),
    [
        (Region.line(0, 0, 1, 1), RIGHT, "The first region is a line and has no area"),
        (
            LEFT,
            Region.rectangle(5, 5, 7, 7),
            r"The second region has \d+ measured .* an angle needs at least 200",
        ),
        (LEFT, Region.rectangle(500, 5, 570, 7), "lies outside of the surface"),
    ],
)
def test_what_has_no_angle_is_one_sentence(first, second, sentence):
    with pytest.raises(MeasureError, match=sentence):
        face_angle(roof(), first, second)
