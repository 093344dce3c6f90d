from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.support.campaigns import examples
from tests.support.surfaces import calibration, coordinates, surface_of
from wafer_viewer.measure.texture.roughness import roughness
from wafer_viewer.measure.tools import profile as module
from wafer_viewer.measure.tools.flatness import flatness
from wafer_viewer.measure.tools.profile import NOISE, SELECTION, profile, slab_profile
from wafer_viewer.measure.tools.step_profile import step_profile
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.model.surface.recipe import Recipe


def slope(rows=80, cols=120, a=0.3, b=-0.2):
    x_um, y_um = np.meshgrid(*coordinates(rows, cols))
    return a * x_um + b * y_um


INSIDE = st.tuples(st.floats(-28, 28), st.floats(-18, 18))


@given(start=INSIDE, end=INSIDE, width_um=st.floats(0, 3))
@example(start=(1.2e-07, -1.0), end=(-1.0, -1.0), width_um=0.0)
@settings(max_examples=examples(50))
def test_a_plane_is_cut_exactly_along_any_line(start, end, width_um):
    if np.hypot(end[0] - start[0], end[1] - start[1]) < 1:
        return
    found, curve = profile(surface_of(slope()), Region.line(*start, *end, width_um=min(width_um, 1.0)))
    np.testing.assert_allclose(curve.z_um, 0.3 * curve.x_um - 0.2 * curve.y_um, atol=1e-4)
    assert found.rise.value_um == pytest.approx(curve.z_um[-1] - curve.z_um[0])
    assert found.pt.value_um == pytest.approx(abs(found.rise.value_um), abs=1e-4)
    assert (curve.x_um[0], curve.y_um[0]) == pytest.approx(start)
    assert (curve.x_um[-1], curve.y_um[-1]) == pytest.approx(end)
    assert found.length_um == pytest.approx(curve.distance_um[-1])
    assert found.measured_fraction == 1.0
    assert np.diff(curve.distance_um).max() <= 0.5 + 1e-9


def around(radius_um, n=361, turns=1.0):
    angle = np.linspace(0, 2 * np.pi * turns, n)
    return list(zip(radius_um * np.cos(angle), radius_um * np.sin(angle), strict=True))


def polar(rows=200, cols=200):
    x_um, y_um = np.meshgrid(*coordinates(rows, cols))
    return np.hypot(x_um, y_um), np.mod(np.arctan2(y_um, x_um), 2 * np.pi)


@pytest.mark.parametrize("width_um", [0.0, 4.0])
def test_a_circle_round_a_cone_is_level_and_as_long_as_its_arc(width_um):
    radius_um, _ = polar()
    circle = Region.polyline(*around(30.0), width_um=width_um)
    found, curve = profile(surface_of(10 - 0.5 * radius_um), circle)
    np.testing.assert_allclose(curve.z_um, -5.0, atol=0.01)
    assert found.pt.value_um < 0.01
    assert found.length_um == pytest.approx(2 * np.pi * 30.0, rel=2e-5)
    np.testing.assert_allclose(np.hypot(curve.x_um, curve.y_um), 30.0, atol=0.002)
    steps_um = np.hypot(np.diff(curve.x_um), np.diff(curve.y_um))
    np.testing.assert_allclose(steps_um, np.diff(curve.distance_um), rtol=1e-3)


def test_a_path_up_a_helix_rises_by_its_lead_along_the_arc():
    _, angle = polar()
    lead_um, radius_um = 6.0, 40.0
    quarter_turns = Region.polyline(*around(radius_um, 200, 0.9)[10:])
    found, curve = profile(surface_of(lead_um * angle / (2 * np.pi)), quarter_turns)
    slope = np.polyfit(curve.distance_um, curve.z_um, 1)[0]
    assert slope == pytest.approx(lead_um / (2 * np.pi * radius_um), rel=1e-4)
    assert found.rise.value_um == pytest.approx(slope * found.length_um, abs=0.01)


def test_a_path_over_a_cone_dips_and_rises_with_the_distance_from_its_tip():
    radius_um, _ = polar()
    corners = [(-30.0, -20.0), (10.0, -20.0), (10.0, 25.0)]
    found, curve = profile(surface_of(-radius_um), Region.polyline(*corners))
    assert found.length_um == 85.0
    np.testing.assert_allclose(curve.z_um, -np.hypot(curve.x_um, curve.y_um), atol=0.01)
    x_um, y_um = (np.interp(curve.distance_um, [0, 40, 85], along) for along in zip(*corners, strict=True))
    np.testing.assert_allclose(curve.x_um, x_um, atol=1e-9)
    np.testing.assert_allclose(curve.y_um, y_um, atol=1e-9)


def test_points_on_one_line_make_the_profile_of_that_line():
    surface = surface_of(np.random.default_rng(4).normal(size=(80, 120)))
    straight = profile(surface, Region.line(-20, -10, 20, 10, width_um=3))[1]
    bent = profile(surface, Region.polyline((-20, -10), (-4, -2), (-4, -2), (20, 10), width_um=3))[1]
    np.testing.assert_allclose(bent.distance_um, straight.distance_um)
    np.testing.assert_allclose(bent.z_um, straight.z_um, atol=1e-6)


@pytest.mark.parametrize("measure", [roughness, step_profile, slab_profile])
def test_what_needs_a_straight_line_refuses_a_polyline(measure):
    with pytest.raises(MeasureError, match="needs a straight line"):
        measure(surface_of(slope()), Region.polyline((-20, 0), (0, 5), (20, 0)))


def test_a_path_without_length_is_refused_and_has_no_area():
    with pytest.raises(MeasureError, match=r"begins and ends at \(1.0, 2.0\)"):
        profile(surface_of(slope()), Region.polyline((1, 2), (1, 2)))
    with pytest.raises(MeasureError, match="at least 2 points for a polyline"):
        Region.polyline((1, 2))
    with pytest.raises(MeasureError, match="is a polyline and has no area"):
        flatness(surface_of(slope()), Region.polyline((1, 2), (3, 4)))


def test_a_line_begins_at_its_first_point():
    rising, falling = Region.line(-20, 0, 20, 0), Region.line(20, 0, -20, 0)
    surface = surface_of(slope(b=0.0))
    assert profile(surface, rising)[0].rise.value_um == pytest.approx(12, abs=1e-4)
    assert profile(surface, falling)[0].rise.value_um == pytest.approx(-12, abs=1e-4)


def test_a_width_averages_the_noise_away():
    rng = np.random.default_rng(1)
    surface = surface_of(rng.normal(size=(80, 400)))
    thin = profile(surface, Region.line(-90, 0.25, 90, 0.25))[1].z_um.std()
    wide, curve = profile(surface, Region.line(-90, 0.25, 90, 0.25, width_um=12.5))
    assert curve.z_um.std() == pytest.approx(thin / 5, rel=0.25)
    assert wide.filter == "mean over 12.5 um across the line"


def test_a_hole_is_a_gap_and_nothing_is_drawn_across_it():
    z = slope()
    z[:, 50:70] = np.nan
    found, curve = profile(surface_of(z), Region.line(-25, 0.25, 25, 0.25))
    x_um, _ = coordinates(80, 120)
    gap = np.isnan(curve.z_um)
    assert (curve.x_um[gap] > x_um[49] + 0.2).all()
    assert (curve.x_um[gap] < x_um[70] - 0.2).all()
    assert found.measured_fraction == pytest.approx(1 - gap.mean())
    np.testing.assert_allclose(curve.z_um[~gap], slope()[39, 0] + 0.3 * (curve.x_um[~gap] - x_um[0]), atol=0.16)


def test_filled_heights_are_left_out_unless_requested():
    z, origin = slope(), np.zeros((80, 120), np.uint8)
    origin[:, 60:80] = Origin.FILLED
    surface = surface_of(z, np.where(origin == 0, z, np.nan), origin)
    line = Region.line(-25, 0.25, 25, 0.25)
    assert profile(surface, line)[0].measured_fraction < 0.9
    filled, _ = profile(surface, line, layer="filled")
    assert filled.measured_fraction == 1.0
    assert filled.surface == "filled"


def test_the_recipe_says_which_heights_are_measured_on():
    z = slope()
    surface = surface_of(z, z + 1.0, recipe=Recipe(measure_on="smoothed"))
    line = Region.line(-5, 0.25, 5, 0.25)
    found, curve = profile(surface, line)
    assert found.surface == "smoothed"
    raw_curve = profile(surface, line, layer="unsmoothed")[1]
    np.testing.assert_allclose(raw_curve.z_um - curve.z_um, 1.0, atol=1e-5)


def test_the_part_of_a_line_beyond_the_surface_is_unmeasured():
    _, curve = profile(surface_of(slope()), Region.line(0, 0, 200, 0))
    np.testing.assert_array_equal(np.isfinite(curve.z_um), curve.x_um <= 29.75 + 0.25 + 1e-6)


class Pyramid:
    """A surface with levels that must be asked for small windows only."""

    levels = 3

    def __init__(self):
        self.fine = surface_of(slope(800, 800, b=0.1))
        self.requested = set()
        self.largest = 0

    def __getattr__(self, name):
        return getattr(self.fine, name)

    def window(self, region=None, level=0):
        from wafer_viewer.model.surface.height_map import HeightMap

        n = 2**level
        z = self.fine.z_um.reshape(800 // n, n, 800 // n, n).mean(axis=(1, 3))
        coarse = surface_of(z)
        shift = (n - 1) / 2 * 0.5
        layers = {k: getattr(coarse, k) for k in ("z_um", "z_raw_um", "confidence", "all_in_focus", "origin")}
        place = {"pixel_um": n * 0.5, "x0_um": self.fine.x0_um + shift, "y0_um": self.fine.y0_um - shift}
        part = HeightMap(**layers, **place).window(region)
        self.requested.add(level)
        self.largest = max(self.largest, part.z_um.size)
        return part


def test_a_long_line_is_read_coarsely_and_in_pieces(monkeypatch):
    monkeypatch.setattr(module, "MAX_SAMPLES", 300)
    monkeypatch.setattr(module, "_PIECE", 16)
    pyramid = Pyramid()
    found, curve = profile(pyramid, Region.line(-190, -190, 190, 190))
    assert pyramid.requested == {2}
    assert len(curve.z_um) == pytest.approx(380 * np.sqrt(2) / 2, abs=2)
    assert pyramid.largest < 20 * 20
    np.testing.assert_allclose(curve.z_um, 0.3 * curve.x_um + 0.1 * curve.y_um, atol=1e-3)
    assert found.notes == ("Read at level 2: each pixel is the mean of 16.",)


def test_pt_and_rise_have_a_budget_where_the_surface_is_calibrated():
    line = Region.line(-19.75, 0.25, 20.25, 0.25)
    noisy = [slope() + np.random.default_rng(seed).normal(0, 0.05, slope().shape) for seed in range(10)]
    made = [surface_of(z, calibration=calibration(), simulated=True) for z in noisy]
    calibrated, (found, *more) = made[0], [profile(surface, line)[0] for surface in made]
    assert found.pt.status == found.rise.status == "evaluated"
    assert {line.name for line in found.pt.budget} >= {"z scale", NOISE, SELECTION}
    assert SELECTION not in {line.name for line in found.rise.budget}
    assert found.rise.expanded_um == pytest.approx(2 * math.sqrt(2) * 0.05, rel=0.25)
    assert sum(abs(one.rise.value_um - 0.3 * 40) <= one.rise.expanded_um for one in (found, *more)) >= 8
    assert found.simulated
    assert profile(calibrated, line, calibration_valid=False)[0].rise.status == "uncalibrated"
    assert profile(surface_of(slope()), line)[0].pt.status == "uncalibrated"


def test_the_mean_across_a_wide_line_has_less_noise():
    noisy = slope() + np.random.default_rng(1).normal(0, 0.05, slope().shape)
    surface = surface_of(noisy, calibration=calibration())
    thin, wide = (profile(surface, Region.line(-20, 0, 20, 0, width_um=w))[0].rise.expanded_um for w in (0.0, 8.0))
    assert wide < thin / 2


def test_the_range_of_noise_alone_lies_within_u_of_nothing():
    """Pt of a flat line is all noise: it grows from 0 to the range of many draws."""
    flat = np.random.default_rng(2).normal(0, 0.05, (160, 200))
    found, _ = profile(surface_of(flat, calibration=calibration()), Region.line(-45.25, 0.25, 45.25, 0.25))
    assert found.pt.value_um > 0.2
    assert found.pt.value_um <= found.pt.expanded_um < 3 * found.pt.value_um


def test_where_little_is_measured_round_a_sample_there_is_no_u():
    z = np.full((160, 200), np.nan)
    z[80, :] = 1.0
    found, _ = profile(surface_of(z, calibration=calibration()), Region.line(-45, -0.25, 45, -0.25))
    assert (found.pt.status, found.pt.expanded_um) == ("not evaluated", None)


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        (Region.line(3, 3, 3, 3), r"begins and ends at \(3.0, 3.0\) um: draw it longer"),
        (Region.line(500, 500, 600, 600), "lies outside"),
        (Region.rectangle(0, 0, 5, 5), "needs a line, this region is a rectangle"),
        (Region.line(10, -15, 20, -15), "No heights were measured along the line"),
    ],
)
def test_what_cannot_be_cut_is_one_sentence(line, sentence):
    z = slope()
    z[60:, 60:] = np.nan
    with pytest.raises(MeasureError, match=sentence):
        profile(surface_of(z), line)
