"""Area, volume, flatness and texture of surfaces whose numbers are known."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.surfaces import PIXEL_UM, calibration, coordinates, noise_of, surface_of
from wafer_viewer.measure.base import height_samples
from wafer_viewer.measure.base.levelled_surface import levelled
from wafer_viewer.measure.texture.areal_texture import texture
from wafer_viewer.measure.tools.flatness import flatness
from wafer_viewer.measure.tools.volume import area_volume
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.tool_options import Levelling
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.recipe import Recipe

FACE = Region.rectangle(-40, -30, 40, 30)
SHAPE = 160, 200


def lattice():
    return np.meshgrid(*coordinates(*SHAPE))


def mesa(height_um=8.0, seed=0, noise_um=0.0, correlation_px=8.0, side_um=20.0, u_pixel_um=0.0):
    """A square mesa on a tilted plane; its sides lie between pixels, so that its area is known exactly."""
    x_um, y_um = lattice()
    z = np.where((np.abs(x_um) < side_um / 2) & (np.abs(y_um) < side_um / 2), height_um, 0.0) + 0.01 * x_um + 5
    z += noise_of(seed, z.shape, noise_um, correlation_px)
    held = replace(calibration(u_z_scale=1e-6), u_pixel_um=u_pixel_um)
    return surface_of(z, calibration=held, recipe=Recipe(window=9), z_step_um=1.0)


@pytest.mark.parametrize(
    "region", [FACE, Region.circle(0, 0, 30), Region.polygon((-38, -30), (38, -28), (30, 35), (-35, 30))]
)
@pytest.mark.parametrize("height_um", [8.0, -8.0])
def test_the_volume_of_a_mesa_or_a_hole(region, height_um):
    found = area_volume(mesa(height_um), region)
    one, other = (found.volume_above, found.volume_below)[:: 1 if height_um > 0 else -1]
    raised = found.area_above if height_um > 0 else found.area_below
    assert one.value == pytest.approx(400 * 8, rel=1e-4)
    assert other.value == pytest.approx(0, abs=1)
    assert raised.value == 400
    assert found.area.value == pytest.approx(region.area_um2, rel=0.03)
    assert found.main == one, "what there is more of stands for it"
    assert (found.reference, one.unit, raised.unit) == ("border", "um3", "um2")
    assert "border of the region" in found.notes[0]


def test_from_a_zero_that_was_chosen_the_border_does_not_count():
    x_um, _ = lattice()
    ground = Region.rectangle(-48, -38, -40, 38)
    surface = surface_of(np.where(x_um < -35, 0.0, 2.0) + 0.01 * x_um, calibration=calibration())
    flat = levelled(surface, Levelling(by="region", places=(ground,)))
    found = area_volume(flat, Region.rectangle(-30, -20, 30, 20))
    assert found.reference == "zero"
    assert found.volume_above.value == pytest.approx(2.0 * found.area.value, rel=1e-3)
    assert found.volume_above.status == "not evaluated"
    assert found.area.status == "evaluated"
    assert area_volume(flat, Region.rectangle(-30, -20, 30, 20), reference="border").main.value < 1


def test_noise_alone_has_no_volume_and_no_area():
    found = area_volume(mesa(0.0, noise_um=0.5, correlation_px=0.0), FACE)
    assert found.area_above.value < 0.01 * found.area.value
    assert found.volume_above.value < 0.05 * found.area.value
    assert found.noise_um == pytest.approx(1.5, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("height_um", "noise_um"), [(8.0, 0.3), (0.6, 0.2)])
@pytest.mark.parametrize("correlation_px", [0.0, 8.0])
def test_the_uncertainty_covers_the_error_of_a_volume(height_um, noise_um, correlation_px):
    """Also of a mesa that hardly rises over the noise."""
    volumes = [area_volume(mesa(height_um, s, noise_um, correlation_px), FACE).volume_above for s in range(20)]
    errors = np.array([volume.value - 400 * height_um for volume in volumes])
    expanded = np.array([volume.expanded for volume in volumes])
    assert np.mean(np.abs(errors) <= expanded) >= 0.9
    assert expanded.mean() < 6 * errors.std()


def test_the_budget_of_a_volume_counts_the_pixel_twice():
    found = area_volume(mesa(u_pixel_um=0.005), FACE)
    budget = {line.name: line.u for line in found.volume_above.budget}
    assert budget["pixel scale"] == pytest.approx(2 * 0.01 * 3200, rel=1e-3)
    assert budget["z scale"] == pytest.approx(1e-6 * 3200, rel=1e-3)
    assert found.area.budget[0].u == pytest.approx(2 * 0.01 * found.area.value)


def test_unmeasured_pixels_are_no_volume_and_are_reported():
    surface = mesa()
    surface.z_raw_um[:, 100:110] = np.nan
    found = area_volume(surface, FACE)
    assert found.volume_above.value == pytest.approx(3200 * 0.75, rel=1e-3)
    assert found.measured_fraction == pytest.approx(1 - 10 * PIXEL_UM / 80, abs=0.02)


def test_the_uncertainty_covers_what_unmeasured_pixels_would_add():
    whole, surface = area_volume(mesa(), FACE), mesa()
    surface.z_raw_um[:, 100:110] = np.nan
    found = area_volume(surface, FACE)
    missing_um3 = whole.volume_above.value - found.volume_above.value
    line = {line.name: line.u for line in found.volume_above.budget}["unmeasured part of the region"]
    assert line == pytest.approx(0.75 * missing_um3, rel=0.05)
    assert found.volume_above.expanded > missing_um3 > whole.volume_above.expanded
    assert all(line.name != "unmeasured part of the region" for line in whole.volume_above.budget)


def test_holes_in_level_ground_hide_no_volume():
    surface = mesa(0.0, noise_um=0.1)
    surface.z_raw_um[50:60, 100:110] = np.nan
    names = [line.name for line in area_volume(surface, FACE).volume_above.budget]
    assert "unmeasured part of the region" not in names


def wavy(amplitude_um=1.0):
    """A whole number of waves along x and y on a tilted plane."""
    x_um, y_um = lattice()
    waves = np.sin(2 * np.pi * x_um / 10) * np.sin(2 * np.pi * y_um / 10)
    return surface_of(amplitude_um * waves + 0.02 * x_um - 0.03 * y_um + 100, calibration=calibration())


WAVES = Region.rectangle(-39.9, -29.9, 39.9, 29.9)
"""Eight waves along x and six along y, every pixel of them once."""


def test_the_texture_of_waves_is_that_of_the_textbook():
    found = texture(wavy(), WAVES)
    assert found.sq.value_um == pytest.approx(0.5, rel=0.01)
    assert found.sa.value_um == pytest.approx((2 / np.pi) ** 2, rel=0.01)
    assert (found.sp.value_um, found.sv.value_um) == (pytest.approx(1, abs=0.03), pytest.approx(1, abs=0.03))
    assert found.sz.value_um == pytest.approx(found.sp.value_um + found.sv.value_um)
    assert found.ssk == pytest.approx(0, abs=0.01)
    assert found.sku == pytest.approx((3 / 8) ** 2 / (1 / 4) ** 2, rel=0.01)
    assert found.main == found.sa.quantity
    assert found.sa.status == "not evaluated"
    assert any("give it with noise_um" in note for note in found.notes)


@pytest.mark.slow
def test_with_its_noise_a_texture_has_an_uncertainty_that_covers_what_noise_added():
    true = wavy(0.2)
    noisy = surface_of(true.z_um + noise_of(5, SHAPE, 0.1, 5.0), calibration=calibration(u_z_scale=0.01))
    smooth, found = texture(true, WAVES), texture(noisy, WAVES, noise_um=0.1)
    for name in ("sa", "sq", "sp", "sv", "sz", "sk"):
        length, truth_um = getattr(found, name), getattr(smooth, name).value_um
        assert length.status == "evaluated"
        assert abs(length.value_um - truth_um) <= length.expanded_um < 5 * abs(length.value_um - truth_um) + 0.05, name
    lines = {line.name: line.u_um for line in found.sq.budget}
    assert lines["z scale"] == pytest.approx(0.01 * found.sq.value_um)
    assert lines["noise of the heights"] > 0.5 * (found.sq.value_um - smooth.sq.value_um)
    assert any("values are not corrected for it" in note for note in found.notes)
    assert found.sal.status == "not evaluated"
    less = texture(noisy, WAVES, noise_um=0.02)
    assert less.sq.value_um == found.sq.value_um, "by definition, whatever the noise"
    assert less.sq.expanded_um < found.sq.expanded_um


def test_without_a_valid_calibration_texture_and_flatness_have_no_u():
    assert texture(wavy(), WAVES, noise_um=0.1, calibration_valid=False).sq.status == "uncalibrated"
    assert flatness(wavy(), WAVES, calibration_valid=False).flt_t.status == "uncalibrated"


@pytest.mark.slow
def test_what_the_focus_window_took_of_short_waves_is_in_the_budget():
    def line(window):
        made = replace(Recipe(), window=window)
        surface = surface_of(wavy().z_um, calibration=calibration(), recipe=made)
        found = texture(surface, WAVES, noise_um=0.0)
        return {line.name: line.u_um for line in found.sq.budget}["resolution of the focus window"]

    assert 0 < 3 * line(3) < line(9)


@pytest.mark.parametrize("correlation_px", [0.0, 9.0])
def test_the_uncertainty_of_flatness_covers_what_noise_added(correlation_px):
    x_um, y_um = lattice()
    bow = 1e-3 * (x_um**2 - x_um * y_um)
    truth = flatness(surface_of(bow), FACE)
    noisy = surface_of(bow + noise_of(7, SHAPE, 0.1, correlation_px), calibration=calibration(u_z_scale=0.0))
    found = flatness(noisy, FACE)
    for name in ("flt_t", "flt_q", "flt_t_minimum_zone"):
        length, truth_um = getattr(found, name), getattr(truth, name).value_um
        assert abs(length.value_um - truth_um) <= length.expanded_um < 1.5, name
    assert {line.name for line in found.flt_t.budget} >= {"z scale", "noise of the heights"}
    assert found.flt_t.value_um > truth.flt_t.value_um


def test_holes_leave_the_texture_as_it_is():
    surface = wavy()
    surface.z_raw_um[np.random.default_rng(1).random(SHAPE) < 0.3] = np.nan
    found = texture(surface, WAVES)
    assert found.sq.value_um == pytest.approx(0.5, rel=0.02)
    assert found.measured_fraction == pytest.approx(0.7, abs=0.03)
    assert found.points == pytest.approx(0.7 * 160 * 120, rel=0.03)


def test_normal_noise_has_the_moments_of_normal_noise():
    found = texture(surface_of(noise_of(3, SHAPE, 0.2)), FACE)
    assert found.sq.value_um == pytest.approx(0.2, rel=0.02)
    assert found.sa.value_um == pytest.approx(0.2 * np.sqrt(2 / np.pi), rel=0.02)
    assert (found.ssk, found.sku) == (pytest.approx(0, abs=0.1), pytest.approx(3, abs=0.2))


def test_what_is_flat_has_no_skewness():
    found = texture(surface_of(np.full(SHAPE, 50.0)), FACE)
    assert (found.ssk, found.sku) == (None, None)
    assert found.sz.value_um < 1e-4


def test_flatness_is_about_the_plane_of_least_squares():
    found = flatness(wavy(), WAVES)
    assert found.flt_t.value_um == pytest.approx(2.0, abs=0.05)
    assert found.flt_q.value_um == pytest.approx(0.5, rel=0.01)
    assert found.reference == "least_squares"
    assert (found.main.status, found.main.unit) == ("evaluated", "um")


@pytest.mark.parametrize("tilt", [0.0, 0.003])
def test_the_minimum_zone_is_the_lowest_layer_that_holds_every_point(tilt):
    """A saddle's zone lies level; one raised corner tilts the plane of least squares, and the zone hardly."""
    x_um, y_um = lattice()
    saddle = 1e-3 * x_um * y_um + tilt * x_um
    found = flatness(surface_of(saddle), FACE)
    assert found.flt_t_minimum_zone is not None
    assert found.flt_t_minimum_zone.value_um == pytest.approx(4 * 1e-3 * 40 * 30 / 2, rel=0.03)
    wedge = np.where(x_um > 30, 0.5 * (x_um - 30), 0.0) + tilt * x_um
    zone, total = flatness(surface_of(wedge), FACE).flt_t_minimum_zone, flatness(surface_of(wedge), FACE).flt_t
    assert zone is not None
    assert zone.value_um == pytest.approx(5 * 70 / 80, rel=0.03), "a triangle's height over its longest side"
    assert zone.value_um < total.value_um


def test_the_zone_of_a_plane_is_nothing():
    x_um, y_um = lattice()
    found = flatness(surface_of(0.01 * x_um + 0.02 * y_um), FACE)
    assert found.flt_t_minimum_zone is not None
    assert found.flt_t_minimum_zone.value_um < 1e-6 + 1e-6 * 50


def test_a_single_wrong_height_is_in_the_total_and_not_in_the_band():
    surface = surface_of(noise_of(3, SHAPE, 0.1))
    surface.z_raw_um[80, 100] = 20.0
    found = flatness(surface, FACE)
    assert found.flt_t.value_um > 19
    assert found.band_9973_um == pytest.approx(6 * 0.1, rel=0.05)


def test_form_is_not_flatness_once_it_is_levelled_out():
    x_um, y_um = lattice()
    surface = surface_of(1e-3 * (x_um**2 + y_um**2))
    assert flatness(surface, FACE).flt_t.value_um > 1
    found = flatness(levelled(surface, Levelling(by="form")), FACE)
    assert found.flt_t.value_um < 0.01
    assert found.levelling.by == "form"


def test_a_region_too_large_for_memory_is_read_coarser_and_says_so(monkeypatch):
    fine = wavy(0.0)

    class Pyramid:
        levels = 2

        def __getattr__(self, name):
            return getattr(fine, name)

        def window(self, region=None, level=0):
            assert level == 1
            return fine

    monkeypatch.setattr(height_samples, "MAX_PIXELS", 10_000)
    assert "Read at level 1: each pixel is the mean of 4." in flatness(Pyramid(), FACE).notes


MEASURES = [pytest.param(measure, id=measure.__name__) for measure in (area_volume, flatness, texture)]


@pytest.mark.parametrize("measure", MEASURES)
@pytest.mark.parametrize(
    ("region", "sentence"),
    [
        (Region.line(0, 0, 10, 10), "is a line and has no area"),
        (Region.rectangle(500, 0, 510, 10), "lies outside of the surface"),
        (Region.rectangle(0, 0, 3, 3), r"has \d+ measured points and .* needs at least 200"),
        (Region.rectangle(30, -30, 49, 30), r"Only \d+ % of the (face|region) is measured and .* needs 50 %"),
        (Region.rectangle(-70, -30, -30, 30), None),
        (Region.rectangle(-170, -30, -30, 30), r"Only \d+ % of the"),
    ],
    ids=["a line", "off the map", "too small", "mostly unmeasured", "half off the map", "mostly off the map"],
)
def test_what_cannot_be_measured_is_one_sentence_with_a_mend(measure, region, sentence):
    surface = mesa(noise_um=0.1)
    surface.z_raw_um[:, 170:] = np.nan
    if sentence is None:
        assert measure(surface, region).measured_fraction == pytest.approx(0.5, abs=0.02)
        return
    with pytest.raises(MeasureError, match=sentence):
        measure(surface, region)


@pytest.mark.parametrize("measure", MEASURES)
def test_every_result_says_what_it_was_measured_on(measure):
    surface = surface_of(noise_of(1, SHAPE, 0.1), simulated=True)
    found = measure(surface, FACE, name="die 4", layer="smoothed")
    assert (found.name, found.surface, found.simulated, found.filter) == ("die 4", "smoothed", True, "none")
    assert found.main.status == "uncalibrated"


def test_a_polygon_that_crosses_itself_is_measured_where_it_is():
    knot = Region.polygon((-30, -30), (30, 30), (30, -30), (-30, 30))
    assert knot.area_um2 == 0
    assert flatness(mesa(), knot).measured_fraction == 1.0


def test_a_border_off_the_measured_ground_is_no_reference():
    surface = mesa()
    inside = np.zeros(SHAPE, bool)
    inside[32:128, 40:160] = True
    surface.z_raw_um[~inside] = np.nan
    with pytest.raises(MeasureError, match=r"Along its border the region has 0 measured points"):
        area_volume(surface, Region.rectangle(-37, -31, 37, 31))
