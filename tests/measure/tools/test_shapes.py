"""Kerf width, die size, circle and chipping of pictures with known truth, as findings with their budgets."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.made_up_pictures import all_of, chipped_edge, covered, die, disc, edge, kerf, surface
from tests.support.surfaces import PIXEL_UM
from wafer_viewer.measure.base.height_samples import MAX_PIXELS
from wafer_viewer.measure.tools.chipping import chipping
from wafer_viewer.measure.tools.circle import circle_size
from wafer_viewer.measure.tools.die_size import die_size
from wafer_viewer.measure.tools.kerf import kerf_width
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.findings import MeasurementResults
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.store.tables.csv_tables import findings_csv

WHOLE = Region.rectangle(-20, -60, 20, 60)


def of_kerf(**about):
    made = surface(kerf(**about))
    return kerf_width(made, all_of(made))


def test_a_kerf_of_38_4_px_is_measured_whichever_way_it_runs():
    for grey in (kerf(), kerf().T, kerf(bright_kerf=False)):
        made = surface(grey)
        found = kerf_width(made, all_of(made))
        assert found.width.value_um == pytest.approx(38.4 * PIXEL_UM, abs=0.02 * PIXEL_UM)
        assert found.main == found.width.quantity
    assert found.kerf == "dark"


@pytest.mark.slow
def test_the_uncertainty_of_a_kerf_covers_its_error():
    found = [of_kerf(seed=seed, rows=160) for seed in range(40)]
    errors = [one.width.value_um - 38.4 * PIXEL_UM for one in found]
    assert abs(np.mean(errors)) < 0.005 * PIXEL_UM
    assert covered(errors, [one.width.expanded_um for one in found]) >= 0.88


def test_a_wedge_has_its_angle_its_narrowest_and_its_widest_place():
    found = of_kerf(wedge=0.02)
    assert found.angle.value == pytest.approx(np.degrees(0.02), abs=2 * found.angle.expanded)
    assert found.width.value_um == pytest.approx(38.4 * PIXEL_UM, abs=0.02)
    assert found.narrowest.value_um == pytest.approx((38.4 - 3) * PIXEL_UM, abs=0.2)
    assert found.widest.value_um == pytest.approx((38.4 + 3) * PIXEL_UM, abs=0.2)


def test_the_pixel_scale_stands_in_the_budget_and_without_a_calibration_there_is_none():
    made = surface(kerf())
    held = replace(made.provenance.calibration, u_pixel_um=0.001 * PIXEL_UM)
    found = kerf_width(surface(kerf(), calibration=held), all_of(made))
    budget = {line.name: line.u_um for line in found.width.budget}
    assert budget["pixel scale"] == pytest.approx(1e-3 * found.width.value_um)
    assert set(budget) == {"pixel scale", "scatter of the edge points", "place between two pixels"}
    assert any("Not in the budget: where light and focus put an edge" in note for note in found.notes)
    mapped = kerf_width(surface(kerf(), calibration=replace(held, u_mapping_um=0.3)), all_of(made))
    assert {line.name: line.u_um for line in mapped.width.budget}["x-y mapping deviation"] == 0.3
    assert not any("distortion" in note for note in mapped.notes)
    bare = kerf_width(made, all_of(made), calibration_valid=False)
    assert (bare.width.status, bare.width.expanded_um, bare.angle.status) == ("uncalibrated", None, "uncalibrated")


def test_a_die_of_700_3_by_512_7_px_turned_by_1_3_degrees():
    made = surface(die())
    found = die_size(made, all_of(made))
    assert found.width.value_um == pytest.approx(700.3 * PIXEL_UM, abs=0.02 * PIXEL_UM)
    assert found.height.value_um == pytest.approx(512.7 * PIXEL_UM, abs=0.02 * PIXEL_UM)
    assert found.rotation.value == pytest.approx(1.3, abs=2 * found.rotation.expanded)
    assert found.squareness.value == pytest.approx(0.0, abs=2 * found.squareness.expanded)
    assert np.hypot(found.center.x_um, found.center.y_um) < 0.02 * PIXEL_UM
    corner = found.outline.points[0]
    assert np.hypot(corner.x_um, corner.y_um) == pytest.approx(np.hypot(700.3, 512.7) / 2 * PIXEL_UM, abs=0.05)
    assert (corner.x_um < 0, corner.y_um < 0, found.die) == (True, True, "bright")


def test_what_is_printed_on_a_die_is_not_its_edge():
    grey = die(turn_deg=0.0)
    grey[150:160, 150:650] = grey[460:470, 150:650] = 250
    made = surface(grey)
    assert die_size(made, all_of(made)).height.value_um == pytest.approx(512.7 * PIXEL_UM, abs=0.02 * PIXEL_UM)


def test_a_circle_has_its_diameter_place_and_roundness():
    made = surface(disc(30.3, 1.2, -0.7))
    found = circle_size(made, Region.circle(0, 0, 19))
    assert found.diameter.value_um == pytest.approx(60.6 * PIXEL_UM, abs=0.02 * PIXEL_UM)
    assert found.radius.expanded_um == pytest.approx(found.diameter.expanded_um / 2, rel=0.1)
    assert (found.center.x_um, found.center.y_um) == (pytest.approx(0.6, abs=0.02), pytest.approx(-0.35, abs=0.02))
    assert (found.roundness.status, found.inside) == ("not evaluated", "bright")
    assert found.roundness.value_um < 0.3


CHIPS = ((-80.0, 6.0), (60.0, 9.0))


def chipped(heights=True, **about):
    grey = chipped_edge(CHIPS, slope=0.0, **about)
    z = np.where(np.arange(grey.shape[0])[:, None] * np.ones(grey.shape) > 80, 30.0, 0.0)
    return surface(grey, z if heights else None)


def test_chips_of_known_depth_length_and_area_are_found():
    made = chipped()
    found = chipping(made, all_of(made, 4))
    assert (found.n_chips, found.die) == (2, "lower")
    deep, small = found.chips
    assert deep.depth_um == pytest.approx(9 * PIXEL_UM, abs=0.25 * PIXEL_UM)
    assert small.depth_um == pytest.approx(6 * PIXEL_UM, abs=0.25 * PIXEL_UM)
    assert found.deepest.value_um == deep.depth_um
    assert deep.place.x_um == pytest.approx(60 * PIXEL_UM, abs=1)
    assert found.longest.value_um == pytest.approx(18 * PIXEL_UM, abs=1)
    truth = np.pi / 2 * (81 + 36) * PIXEL_UM**2
    assert found.area.value == pytest.approx(truth, rel=0.05)
    assert chipping(made, all_of(made, 4), limit_um=7 * PIXEL_UM).n_chips == 1


def test_the_die_is_on_the_higher_side_or_where_one_says():
    flat = chipped(heights=False)
    with pytest.raises(MeasureError, match="Both sides of the edge are as high within 1 um"):
        chipping(flat, all_of(flat, 4))
    assert chipping(flat, all_of(flat, 4), die="bright").die == "lower"
    assert chipping(flat, all_of(flat, 4), die="dark").n_chips == 0


def test_a_large_region_is_read_at_a_coarser_level_and_says_so():
    class Levels:
        """A surface of two levels, the second half as fine."""

        def __init__(self, made, coarse):
            self.parts, self.levels = (made, coarse), 2
            self.pixel_um, self.x0_um, self.y0_um = made.pixel_um, made.x0_um, made.y0_um
            self.shape, self.provenance = made.shape, made.provenance

        def window(self, region=None, level=0):
            return self.parts[level].window(region)

    rows, cols = 1800, 1200
    assert rows * cols > MAX_PIXELS
    fine = surface(kerf(rows=rows, cols=cols, width_px=200.0, slope=0.0, noise=1.0))
    coarse = surface(kerf(rows=rows // 2, cols=cols // 2, width_px=100.0, slope=0.0, off_px=0.1, noise=1.0))
    import dataclasses

    coarse = dataclasses.replace(coarse, pixel_um=2 * PIXEL_UM, x0_um=2 * coarse.x0_um, y0_um=2 * coarse.y0_um)
    found = kerf_width(Levels(fine, coarse), all_of(fine))
    assert found.width.value_um == pytest.approx(200 * PIXEL_UM, abs=0.1)
    assert any("Read at level 1" in note for note in found.notes)


def test_findings_survive_their_file_and_stand_in_the_table():
    made, chips = surface(die(seed=1)), chipped()
    found = MeasurementResults(items=(die_size(made, all_of(made)), of_kerf(), chipping(chips, all_of(chips, 4))))
    import msgspec

    assert msgspec.json.decode(msgspec.json.encode(found), type=MeasurementResults) == found
    table = findings_csv(found)
    for reported in ("die_size,height,", "kerf_width,widest,", "chipping,area,", "chip 1 depth"):
        assert reported in table


def uncovered():
    made = surface(kerf())
    made.origin[:, :60] = Origin.NOT_COVERED
    return made


@pytest.mark.parametrize(
    ("made", "region", "sentence"),
    [
        (lambda: surface(kerf()), Region.circle(0, 0, 20), "A kerf width is measured in a rectangle"),
        (lambda: surface(kerf()), Region.rectangle(900, 0, 950, 50), "lies outside of the surface"),
        (
            lambda: surface(kerf()),
            Region.rectangle(0, 0, 30, 5),
            "60 x 10 pixels large and a kerf width needs at least 16",
        ),
        (uncovered, Region.rectangle(-25, -60, 10, 60), "of the region lies on the picture"),
        (lambda: surface(edge(cols=100)), WHOLE, "No edge stands out on both sides of a kerf"),
        (
            lambda: surface(np.hstack([kerf(rows=300), kerf(rows=300)])),
            Region.rectangle(-49, -60, 49, 60),
            "More than one kerf",
        ),
        (lambda: surface(np.full((300, 100), 90, np.uint8)), WHOLE, "No edge stands out"),
    ],
)
def test_what_is_no_kerf_is_one_sentence(made, region, sentence):
    with pytest.raises(MeasureError, match=sentence):
        kerf_width(made(), region)


@pytest.mark.parametrize(
    ("made", "sentence"),
    [
        (lambda: surface(np.full((300, 300), 90, np.uint8)), "No edge stands out on the left side"),
        (lambda: surface(edge(rows=300, cols=300)), "No edge stands out on the"),
    ],
)
def test_what_is_no_die_is_one_sentence(made, sentence):
    shown = made()
    with pytest.raises(MeasureError, match=sentence):
        die_size(shown, all_of(shown))


def test_other_regions_than_a_tool_asks_for_are_refused():
    made = surface(disc())
    with pytest.raises(MeasureError, match="A diameter is measured in a circle, this region is a rectangle"):
        circle_size(made, Region.rectangle(-5, -5, 5, 5))
    with pytest.raises(MeasureError, match="Chipping is measured in a rectangle, this region is a circle"):
        chipping(made, Region.circle(0, 0, 10))
    with pytest.raises(MeasureError, match="A die size is measured in a rectangle, this region is a circle"):
        die_size(made, Region.circle(0, 0, 10))
