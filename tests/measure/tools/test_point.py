"""Heights at points and the way between them, against surfaces whose heights are known."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from tests.support.campaigns import drawn_after
from tests.support.surfaces import calibration, coordinates, gauge_blocks, noise_of, surface_of
from wafer_viewer.measure.base.levelled_surface import levelled
from wafer_viewer.measure.tools.point import distance, point_height
from wafer_viewer.measure.tools.profile import profile
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.tool_options import Levelling
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.recipe import Recipe

TILT = 0.05
SWEEP = {"recipe": Recipe(window=9), "z_step_um": 4.0}


def slope(seed=0, noise_um=0.1, correlation_px=8.0, holes=(), u_pixel_um=0.0, u_mapping_um=None):
    """z = 0.05 x + 20 with noise."""
    x_um, _ = np.meshgrid(*coordinates(200, 300))
    z = TILT * x_um + 20 + noise_of(seed, x_um.shape, noise_um, correlation_px)
    for rows, cols in holes:
        z[rows, cols] = np.nan
    return surface_of(z, calibration=replace(calibration(), u_pixel_um=u_pixel_um, u_mapping_um=u_mapping_um), **SWEEP)


def test_a_height_without_noise_is_that_of_the_surface():
    found = point_height(slope(noise_um=0.0), Region.point(40.25, 10.25))
    assert found.height.value_um == pytest.approx(20 + TILT * 40.25, abs=1e-4)
    assert found.points == 9
    assert found.main.value == found.height.value_um
    assert (found.main.unit, found.main.status) == ("um", "evaluated")


@pytest.mark.slow
@pytest.mark.parametrize("correlation_px", drawn_after(1, [0.0, 8.0]))
def test_the_uncertainty_covers_the_noise_of_a_height(correlation_px):
    surfaces = [slope(seed, 0.5, correlation_px) for seed in range(12)]
    places = [(x, y) for x in range(-60, 61, 20) for y in (-30, 0, 30)]
    found = [(point_height(s, Region.point(x, y)).height, x) for s in surfaces for x, y in places]
    covered = [abs(length.value_um - 20 - TILT * x) <= length.expanded_um for length, x in found]
    assert np.mean(covered) >= 0.92
    assert np.mean([length.expanded_um for length, _ in found]) < 1.3, "twice a noise of 0.5 um, and little more"


def dome(seed, radius_um=500.0, noise_um=0.1, correlation_px=8.0):
    """A cap of a sphere, its top at 20 um, with noise; and its heights without."""
    x_um, y_um = np.meshgrid(*coordinates(300, 400))
    z = 20 - radius_um + np.sqrt(radius_um**2 - x_um**2 - y_um**2)
    noisy = z + noise_of(seed, z.shape, noise_um, correlation_px)
    return surface_of(noisy, calibration=calibration(), **SWEEP)


@pytest.mark.slow
def test_the_form_of_a_dome_is_no_noise_of_its_heights():
    places = [(x, y) for x in (-60.25, 0.25, 40.25) for y in (-30.25, 0.25)]
    found = [(point_height(dome(seed), Region.point(*at)).height, at) for seed in range(4) for at in places]
    covered = [abs(z.value_um + 480 - math.sqrt(500**2 - x**2 - y**2)) <= z.expanded_um for z, (x, y) in found]
    assert np.mean(covered) >= 0.9
    assert max(z.expanded_um for z, _ in found) < 0.35, "twice a noise of 0.1 um, and little more"


def test_the_noise_of_a_profile_over_a_dome_is_that_of_its_heights():
    found, _ = profile(dome(0), Region.line(-70.25, 20.25, 70.25, 20.25))
    assert found.rise.expanded_um < 0.5, "the difference of two heights with a noise of 0.1 um"
    assert abs(found.rise.value_um) <= found.rise.expanded_um


def test_a_wrong_height_nearby_changes_nothing():
    surface = slope(noise_um=0.0)
    surface.z_raw_um[100, 150] += 50
    near = Region.point(surface.x_um[150], surface.y_um[100])
    assert point_height(surface, near).height.value_um == pytest.approx(20 + TILT * surface.x_um[150], abs=0.05)


def test_a_faint_pixel_is_less_certain_than_the_area_around_it():
    surface, place = slope(noise_um=0.01), Region.point(40.25, 10.25)
    around = point_height(surface, place).height
    u_um = np.full(surface.shape, 0.001, np.float32)
    assert point_height(dataclasses.replace(surface, u_um=u_um), place).height == around
    faint = point_height(dataclasses.replace(surface, u_um=u_um + np.float32(0.5)), place).height
    assert faint.expanded_um == pytest.approx(1.0, rel=0.01)
    assert point_height(dataclasses.replace(surface, u_um=u_um + 0.5), place, layer="smoothed").height.value_um


def test_a_pixel_with_an_uncertainty_needs_no_area_around_it():
    surface = slope(noise_um=0.0)
    surface.z_raw_um[:] = np.where(np.hypot(*np.indices(surface.shape) - np.array([100, 150])[:, None, None]) < 4,
                                   surface.z_raw_um, np.nan)  # fmt: skip
    place = Region.point(surface.x_um[150], surface.y_um[100])
    assert point_height(surface, place).height.status == "not evaluated"
    found = point_height(dataclasses.replace(surface, u_um=np.full(surface.shape, 0.3, np.float32)), place).height
    assert found.expanded_um == pytest.approx(0.6, rel=0.05)


def test_where_little_is_measured_there_is_a_height_and_no_uncertainty():
    surface = slope(noise_um=0.0)
    x_um, y_um = surface.x_um[150], surface.y_um[100]
    keep = surface.z_raw_um[99:102, 149:152].copy()
    surface.z_raw_um[:] = np.nan
    surface.z_raw_um[99:102, 149:152] = keep
    found = point_height(surface, Region.point(x_um, y_um)).height
    assert found.value_um == pytest.approx(20 + TILT * x_um, abs=1e-4)
    assert (found.expanded_um, found.status) == (None, "not evaluated")


def test_a_height_is_read_from_the_zero_that_was_chosen():
    found = point_height(levelled(slope(noise_um=0.0), Levelling(by="plane")), Region.point(40.0, 10.0))
    assert found.height.value_um == pytest.approx(0.0, abs=1e-4)
    assert found.levelling.by == "plane"
    assert any("how sure the zero is" in note for note in found.notes)


def test_a_way_has_its_parts_and_their_slope():
    start, end = Region.point(-30.25, 0.25), Region.point(29.75, 0.25)
    found = distance(slope(noise_um=0.0), start, end)
    assert found.lateral.value_um == pytest.approx(60.0)
    assert found.dz.value_um == pytest.approx(60 * TILT, abs=1e-4)
    assert found.distance.value_um == pytest.approx(math.hypot(60, 60 * TILT), abs=1e-4)
    assert found.slope.value == pytest.approx(math.degrees(math.atan(TILT)), abs=1e-3)
    assert found.slope.unit == "deg"
    back = distance(slope(noise_um=0.0), end, start)
    assert back.dz.value_um == pytest.approx(-found.dz.value_um)
    assert back.distance.value_um == pytest.approx(found.distance.value_um)
    assert any("where the points were set" in note for note in found.notes)


def test_the_pixel_counts_across_and_the_z_scale_along_z():
    found = distance(slope(u_pixel_um=0.005), Region.point(-30, 0), Region.point(30, 0))
    across = {line.name: line.u_um for line in found.lateral.budget}
    assert across == {"pixel scale": pytest.approx(0.01 * 60)}
    along = {line.name: line.u_um for line in found.dz.budget}
    assert along["z scale"] == pytest.approx(5e-4 * abs(found.dz.value_um))
    both = {line.name: line.u_um for line in found.distance.budget}
    assert set(both) == set(across) | set(along)
    assert both["pixel scale"] == pytest.approx(0.6, rel=0.01)


def test_a_measured_mapping_deviation_is_in_the_budget_across_and_no_longer_missing():
    ends = Region.point(-30, 0), Region.point(30, 0)
    before, after = distance(slope(), *ends), distance(slope(u_mapping_um=0.2), *ends)
    across = {line.name: line.u_um for line in after.lateral.budget}
    assert across == {"pixel scale": 0.0, "x-y mapping deviation": 0.2}
    assert after.lateral.expanded_um == pytest.approx(0.4)
    assert "x-y mapping deviation" not in {line.name for line in after.dz.budget}
    assert [any("distortion of the lens" in note for note in found.notes) for found in (before, after)] == [True, False]


@pytest.mark.campaign
def test_the_uncertainty_covers_the_errors_of_a_way():
    covered: list[tuple[bool, bool, bool]] = []
    for seed in range(8):
        surface = slope(seed, 0.4)
        for y in (-30.0, 0.0, 30.0):
            found = distance(surface, Region.point(-40, y), Region.point(40, y))
            errors = (
                (found.dz.value_um - 80 * TILT, found.dz.expanded_um),
                (found.distance.value_um - math.hypot(80, 80 * TILT), found.distance.expanded_um),
                (found.slope.value - math.degrees(math.atan(TILT)), found.slope.expanded),
            )
            covered.append(tuple(abs(error) <= u for error, u in errors))
    assert np.mean(covered, axis=0).min() >= 0.9


def test_without_a_valid_calibration_nothing_has_an_uncertainty():
    found = distance(slope(), Region.point(-30, 0), Region.point(30, 0), calibration_valid=False)
    assert {found.distance.status, found.lateral.status, found.dz.status, found.slope.status} == {"uncalibrated"}
    assert found.slope.expanded is None
    assert found.notes == ()
    assert point_height(gauge_blocks(1, calibration=None), Region.point(-50, 0)).height.status == "uncalibrated"


@pytest.mark.parametrize(
    ("place", "sentence"),
    [
        (Region.point(900, 0), "lies outside of the surface"),
        (Region.point(0.25, 0.25), "No height was measured at .* set the point where the surface has no holes"),
        (Region.circle(0, 0, 5), "this region is a circle: set a point"),
    ],
)
def test_what_has_no_height_is_one_sentence(place, sentence):
    with pytest.raises(MeasureError, match=sentence):
        point_height(slope(holes=[(slice(95, 105), slice(145, 155))]), place)


def test_two_points_in_one_place_are_no_way():
    with pytest.raises(MeasureError, match=r"Both points are at \(3\.0, 4\.0\) um: move one"):
        distance(slope(), Region.point(3, 4), Region.point(3, 4))
