"""Noise of pixels in a sum of heights: alike over the focus window, and in the budgets of steps, grooves and bumps."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.support.surfaces import PIXEL_UM, calibration, coordinates, noise_of, surface_of
from wafer_viewer.measure.base.correlated_errors import Scatter
from wafer_viewer.measure.base.error_covariance import WeightedHeights
from wafer_viewer.measure.base.measurement_context import NOISE, MeasurementContext
from wafer_viewer.measure.base.pixel_noise import noise_um, pixel_noise_um
from wafer_viewer.measure.tools.radius import bump_radius
from wafer_viewer.measure.tools.step_height import step_height
from wafer_viewer.measure.tools.step_profile import step_profile
from wafer_viewer.model.quantity import Length
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.model.surface.recipe import Recipe

WINDOW = 9


def with_noise(z_um: np.ndarray, u_um: float) -> HeightMap:
    """A smooth surface whose pixels are told to be uncertain; nothing in its heights shows that."""
    surface = surface_of(z_um, calibration=calibration(0.0), recipe=Recipe(window=WINDOW), z_step_um=0.0)
    return dataclasses.replace(surface, u_um=np.full(z_um.shape, u_um, np.float32))


def reading(surface: HeightMap) -> MeasurementContext:
    return MeasurementContext.of(surface, None, True)


def mean_over(side: int, u_um: float = 0.2) -> float:
    surface = with_noise(np.zeros((200, 200)), u_um)
    x_um, y_um = (a.ravel() for a in np.meshgrid(*(axis[40 : 40 + side] for axis in coordinates(200, 200))))
    return pixel_noise_um(reading(surface), WeightedHeights(x_um, y_um, np.full(x_um.size, 1 / x_um.size)))


def test_one_pixel_has_its_own_noise_and_neighbours_err_alike():
    assert mean_over(1) == pytest.approx(0.2, rel=1e-5)
    assert mean_over(3) > 0.95 * 0.2


def test_a_wide_mean_has_the_noise_of_its_independent_windows():
    triangle = np.convolve(np.ones(WINDOW) / WINDOW, np.ones(WINDOW) / WINDOW)
    alike_px = 1 / np.sum(triangle**2)  # integral of the correlation of two windows
    assert mean_over(120) == pytest.approx(0.2 * alike_px / 120, rel=0.1)


def test_a_difference_of_neighbours_has_hardly_any():
    surface = with_noise(np.zeros((100, 100)), 0.2)
    near, far = (
        pixel_noise_um(reading(surface), WeightedHeights(np.array([0.0, x]), np.zeros(2), np.array([1.0, -1.0])))
        for x in (PIXEL_UM, 20.0)
    )
    assert near < 0.3 * far
    assert far == pytest.approx(0.2 * 2**0.5, rel=1e-3)


def test_noise_that_is_not_known_is_none():
    surface = surface_of(np.zeros((100, 100)), calibration=calibration(0.0), recipe=Recipe(window=WINDOW))
    one = WeightedHeights(np.zeros(1), np.zeros(1), np.ones(1))
    assert pixel_noise_um(reading(surface), one) == 0
    smoothed = MeasurementContext.of(with_noise(np.zeros((100, 100)), 0.2), "smoothed", True)
    assert pixel_noise_um(smoothed, one) == 0


def test_scatter_and_noise_of_pixels_are_pooled_and_form_stays():
    few = Scatter(0.1, 4.0)
    assert noise_um(few, 0.0) == few
    assert few.expanded < noise_um(few, 0.3).expanded < 2 * 0.3
    assert noise_um(Scatter(0.5, 4.0), 0.3) == Scatter(0.5, 4.0)
    assert noise_um(Scatter(0.1, 1e6), 0.3).u == pytest.approx(0.1, rel=1e-3)  # many residuals know better


@pytest.mark.slow
def test_noisy_pixels_make_a_step_a_groove_and_a_bump_less_certain():
    x_um, y_um = np.meshgrid(*coordinates(240, 320))
    seen_um = noise_of(1, x_um.shape, 0.02, 2 * WINDOW)  # few independent errors: they may hide the noise
    step_um = np.where(x_um < 0, 20.0, 0.0)
    groove_um = np.where(np.abs(x_um) < 10, -10.0, 0.0)
    cap_um = np.maximum(np.sqrt(np.maximum(60.0**2 - x_um**2 - y_um**2, 0)) - 52.0, 0.0)
    faces = Region.rectangle(-40, -8, -24, 8), Region.rectangle(24, -8, 40, 8)
    line = Region.line(-75, 3, 75, 3, width_um=5)

    def noises(u_um: float) -> list[float]:
        step = step_height(with_noise(step_um + seen_um, u_um), *faces).height
        groove = step_profile(with_noise(groove_um + seen_um, u_um), line).height
        top = bump_radius(with_noise(cap_um + seen_um, u_um), Region.circle(0, 0, 35)).top
        return [line_of(step, NOISE), line_of(groove, NOISE), line_of(top, "noise and form of the cap")]

    quiet, loud = noises(0.0), noises(0.5)
    assert all(b > 1.2 * a for a, b in zip(quiet, loud, strict=True))


def line_of(length: Length, name: str) -> float:
    return {line.name: line.u_um for line in length.budget}[name]
