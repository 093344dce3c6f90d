from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.campaigns import drawn_after, examples
from tests.support.surfaces import STEP_UM, calibration, gauge_blocks, surface_of
from wafer_viewer.measure.base import height_samples
from wafer_viewer.measure.base.levelled_surface import levelled
from wafer_viewer.measure.tools.step_height import step_height
from wafer_viewer.model.acquisition.calibration import OpticalSetup
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.tool_options import Levelling
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.comparison import Registration
from wafer_viewer.model.surface.frame_health import FrameHealth
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.blending.stitched_mosaic import mosaic_provenance
from wafer_viewer.reconstruct.comparison.compare import provenance_of
from wafer_viewer.reconstruct.comparison.resampled_surface import ResampledMosaic
from wafer_viewer.reconstruct.stitching import stitch

UPPER = Region.rectangle(-150, -50, -40, 50)
LOWER = Region.rectangle(40, -50, 150, 50)


def test_a_step_without_noise_is_exact():
    step = step_height(gauge_blocks(1, noise_um=0.0, tilt=0.0), UPPER, LOWER)
    assert step.height.value_um == pytest.approx(STEP_UM, abs=1e-4)
    assert step.relative_tilt_mrad == pytest.approx(0, abs=1e-3)
    assert step.upper_sq_um < 1e-3


def test_a_tilted_sample_and_outliers_do_not_change_the_step():
    straight = step_height(gauge_blocks(1, level=0.0), UPPER, LOWER).height.value_um
    tilted = step_height(gauge_blocks(1, level=5e-3), UPPER, LOWER)
    assert tilted.height.value_um == pytest.approx(straight, abs=2e-3)
    assert tilted.upper_points == pytest.approx(220 * 200 * 0.996, rel=0.01)


def test_the_other_way_round_it_is_negative():
    surface = gauge_blocks(1)
    present, back = step_height(surface, UPPER, LOWER), step_height(surface, LOWER, UPPER)
    assert back.height.value_um == pytest.approx(-present.height.value_um, abs=1e-6)
    assert back.height.expanded_um == pytest.approx(present.height.expanded_um, rel=1e-6)


@pytest.mark.campaign
def test_the_bias_over_many_scans_is_under_ten_nanometres():
    found = [step_height(gauge_blocks(s, correlation_px=0.0), UPPER, LOWER).height.value_um for s in range(20)]
    assert abs(np.mean(found) - STEP_UM) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("correlation_px", drawn_after(1, [2.0, 0.0, 8.0, 20.0]))
def test_the_uncertainty_covers_the_error_of_correlated_noise(correlation_px):
    steps = [step_height(gauge_blocks(s, 1.0, correlation_px, u_z_scale=0.0), UPPER, LOWER) for s in range(20)]
    errors = np.array([s.height.value_um - STEP_UM for s in steps])
    expanded = np.array([s.height.expanded_um for s in steps])
    assert np.mean(np.abs(errors) <= expanded) >= 0.85, "of 20 runs at 95 %, 17 or more in 98 of 100 cases"
    assert expanded.mean() < 6 * errors.std(), "an uncertainty that is far too large is no help either"


@pytest.mark.campaign
def test_the_uncertainty_covers_a_wrong_z_scale():
    u = 5e-4
    covered = []
    for seed in range(20):
        error = u * np.random.default_rng(seed).normal()
        length = step_height(gauge_blocks(seed, u_z_scale=u, scale_error=error), UPPER, LOWER).height
        covered.append(abs(length.value_um - STEP_UM) <= length.expanded_um)
    assert np.mean(covered) >= 0.9


def budget_of(step):
    return {line.name: line.u_um for line in step.height.budget}


def test_the_budget_names_what_it_is_made_of():
    step = step_height(gauge_blocks(1, noise_um=0.01), UPPER, LOWER)
    budget = budget_of(step)
    assert budget["z scale"] == pytest.approx(5e-4 * STEP_UM, rel=1e-3)
    assert budget["levelling"] == pytest.approx(3e-4 * 190 / np.sqrt(12), rel=0.5)
    assert budget["interpolation between frames"] == pytest.approx(0.02)
    assert step.height.expanded_um == pytest.approx(2 * np.sqrt(sum(u**2 for u in budget.values())))
    assert step.height.status == "evaluated"
    assert budget["poses of the fields"] == 0.0, "both regions are of one field"
    assert step.not_evaluated == (
        "z linearity", "drift during the scan", "repeatability", "temperature", "Abbe offset"
    )  # fmt: skip


def test_whole_frames_are_less_certain_than_peaks_between_them():
    z = np.where(np.arange(400) < 200, 8.0, 0.0) * np.ones((200, 1))
    surface = surface_of(z, calibration=calibration(), recipe=Recipe(peak="argmax"), z_step_um=4.0)
    step = step_height(surface, Region.rectangle(-90, -40, -10, 40), Region.rectangle(10, -40, 90, 40))
    assert budget_of(step)["interpolation between frames"] == pytest.approx(4 / np.sqrt(6))
    assert abs(step.height.value_um - 8.0) < 1e-6


@pytest.mark.parametrize(("width_um", "per_step"), [(9.2, 0.004), (6.8, 0.011), (5.0, 0.08), (1.0, 0.12)])
def test_narrower_curves_are_less_certain(width_um, per_step):
    z = np.where(np.arange(400) < 200, 8.0, 0.0) * np.ones((200, 1))
    recipe = Recipe(focus_width_um=width_um)
    surface = surface_of(z, calibration=calibration(), recipe=recipe, z_step_um=4.0)
    step = step_height(surface, Region.rectangle(-90, -40, -10, 40), Region.rectangle(10, -40, 90, 40))
    um = budget_of(step)["interpolation between frames"]
    assert um == pytest.approx(4 * np.sqrt(2) * per_step, rel=0.01)


TOLD = FrameHealth(u_between_um=0.1)
LEFT, RIGHT = Region.rectangle(-90, -40, -10, 40), Region.rectangle(10, -40, 90, 40)


def between_frames(z_um, **provenance) -> float:
    """The line of a step between two faces in the frames of one field, 4 um apart."""
    known = {"even_step_um": 4.0, "frame_health": TOLD, **provenance}
    surface = surface_of(z_um, calibration=calibration(), recipe=Recipe(focus_width_um=6.0), z_step_um=4.0, **known)
    return budget_of(step_height(surface, LEFT, RIGHT))["interpolation between frames"]


def two_faces(h_um: float, rise_um: float = 0.0):
    """The left face is h higher than the right one; both rise along y."""
    along = np.linspace(0, rise_um, 200)[:, None]
    return np.where(np.arange(400) < 200, h_um, 0.0) + along + 120.7


def test_errors_between_frames_cancel_in_whole_steps_and_over_faces_that_span_frames():
    as_far_apart_as_can_be = between_frames(two_faces(10.0))
    assert between_frames(two_faces(8.0)) < 0.35 * as_far_apart_as_can_be
    assert between_frames(two_faces(9.0)) == pytest.approx(np.sqrt(2) * 0.1, rel=1e-3)
    assert between_frames(two_faces(10.0, rise_um=10.0)) < 0.35 * as_far_apart_as_can_be
    assert as_far_apart_as_can_be == pytest.approx(0.2, rel=0.03)


def test_errors_between_frames_do_not_cancel_where_the_places_of_the_frames_are_not_known():
    unknown = np.sqrt(2) * 0.1
    assert between_frames(two_faces(8.0), even_step_um=0.0) == pytest.approx(unknown)
    surface = surface_of(two_faces(8.0), calibration=calibration(), z_step_um=4.0, even_step_um=4.0, frame_health=TOLD)
    flat = levelled(surface, Levelling(by="plane"))
    assert budget_of(step_height(flat, LEFT, RIGHT))["interpolation between frames"] == pytest.approx(unknown)
    assert mosaic_provenance([surface.provenance] * 2, Recipe()).even_step_um == 0.0
    assert mosaic_provenance([surface.provenance], Recipe()).even_step_um == 4.0
    assert provenance_of(surface.provenance, surface.provenance, ()).even_step_um == 0.0
    moved = ResampledMosaic(surface, surface, Registration(z_um=1.3))
    assert budget_of(step_height(moved, LEFT, RIGHT))["interpolation between frames"] == pytest.approx(unknown)


def test_faces_tilted_against_each_other_are_reported():
    step = step_height(gauge_blocks(1, noise_um=0.0, tilt=2e-3, level=0.0), UPPER, LOWER)
    assert step.relative_tilt_mrad == pytest.approx(2 * np.hypot(1, 0.4), rel=1e-3)
    # The lower face is 0.19 um higher under its own middle than at the joint.
    assert step.notes[0] == "Levelled to the upper face: 399.690 um, to the lower: 400.070 um."
    assert step.notes[1] == "Both faces extended to the middle between the regions, (0.0, 0.0) um: 399.880 um."


@pytest.mark.parametrize(("objective", "reach"), [("", 116.7), ("20x/0.42", 185.2)])
@pytest.mark.parametrize(("regions", "which"), [((UPPER, LOWER), "lower"), ((LOWER, UPPER), "upper")])
def test_a_region_in_the_shade_of_the_wall_is_told(objective, reach, regions, which):
    blocks = gauge_blocks(1, calibration=replace(calibration(), setup=OpticalSetup(objective=objective)))
    (note,) = (n for n in step_height(blocks, *regions).notes if "aperture" in n)
    assert note == (
        f"The {which} region begins at most 80.5 um from the wall, which hides part of the aperture out to {reach} um: "
        "heights there may be off by more than U. Move the region further away."
    )


def test_a_region_out_of_the_shade_is_not_told_of():
    far = Region.rectangle(90, -50, 150, 50)
    assert not any("aperture" in note for note in step_height(gauge_blocks(1), UPPER, far).notes)


@pytest.mark.parametrize(
    ("about", "valid"), [({"calibration": None}, True), ({}, False)], ids=["no calibration", "one that is out of date"]
)
def test_without_a_valid_calibration_there_is_no_uncertainty(about, valid):
    length = step_height(gauge_blocks(1, **about), UPPER, LOWER, calibration_valid=valid).height
    assert (length.status, length.expanded_um, length.budget) == ("uncalibrated", None, ())
    assert length.value_um == pytest.approx(STEP_UM, abs=1.0)


def test_simulated_data_are_marked():
    assert step_height(gauge_blocks(1, simulated=True), UPPER, LOWER).simulated
    assert not step_height(gauge_blocks(1), UPPER, LOWER).simulated


def layered():
    """Measured heights of 10, smoothed ones of 20, and a filled part of 30 on the upper side."""
    raw = np.where(np.arange(200) < 100, 10.0, 0.0) * np.ones((100, 1))
    origin = np.zeros(raw.shape, np.uint8)
    origin[:50, :100] = Origin.FILLED
    raw[:50, :100] = np.nan
    z = np.where(origin == Origin.FILLED, 30.0, 2 * raw)
    return z, raw, origin


@pytest.mark.parametrize(("layer", "height"), [(None, 10.0), ("unsmoothed", 10.0), ("smoothed", 20.0)])
def test_a_result_names_the_heights_it_is_of(layer, height):
    z, raw, origin = layered()
    upper, lower = Region.rectangle(-45, -24, -5, 24), Region.rectangle(5, -24, 45, 24)
    step = step_height(surface_of(z, raw, origin), upper, lower, layer=layer)
    assert step.height.value_um == pytest.approx(height, abs=1e-6)
    assert step.surface == (layer or "unsmoothed")
    assert step.upper_points < step.lower_points


def test_filled_heights_count_only_when_requested():
    z, raw, origin = layered()
    upper, lower = Region.rectangle(-45, 2, -5, 24), Region.rectangle(5, 2, 45, 24)
    with pytest.raises(MeasureError, match="The upper region has 0 measured points"):
        step_height(surface_of(z, raw, origin), upper, lower)
    step = step_height(surface_of(z, raw, origin), upper, lower, layer="filled")
    assert step.height.value_um == pytest.approx(30.0, abs=1e-6)


@pytest.mark.parametrize(
    ("upper", "lower", "sentence"),
    [
        (Region.line(0, 0, 1, 1), LOWER, "The upper region is a line and has no area"),
        (UPPER, Region.rectangle(40, 0, 42, 2), r"The lower region has (16|20|25) measured points and .* at least 200"),
        (UPPER, Region.rectangle(-45, -50, 60, 50), r"The two regions share \d+ points: move them apart"),
        (UPPER, Region.rectangle(900, 900, 999, 999), "lies outside"),
    ],
)
def test_what_cannot_be_measured_is_one_sentence_with_a_mend(upper, lower, sentence):
    with pytest.raises(MeasureError, match=sentence):
        step_height(gauge_blocks(1), upper, lower)


def test_points_on_a_line_are_no_face():
    z = np.full((400, 400), np.nan)
    z[200, :190], z[:, 300] = 5.0, 0.0
    z[:, 301] = 0.1
    with pytest.raises(MeasureError, match=r"measured points"):
        step_height(surface_of(z), Region.rectangle(-100, -5, -2, 5), Region.rectangle(20, -99, 80, 99))


def test_circles_and_polygons_are_regions_too():
    surface = gauge_blocks(3, correlation_px=0.0)
    upper = Region.circle(-90, 0, 40)
    lower = Region.polygon((50, -40), (140, -40), (95, 50))
    assert step_height(surface, upper, lower).height.value_um == pytest.approx(STEP_UM, abs=0.15)


def test_a_large_region_is_read_at_a_coarser_level(monkeypatch):
    """A surface with two levels, as a mosaic has; the fine one must not be touched."""
    fine = gauge_blocks(1, noise_um=0.1, correlation_px=0.0)

    class Pyramid:
        levels = 2
        requested = ()

        def __getattr__(self, name):
            return getattr(fine, name)

        def window(self, region=None, level=0):
            self.requested += (level,)
            return surface_of_half(fine).window(region)

    monkeypatch.setattr(height_samples, "MAX_PIXELS", 20_000)
    pyramid = Pyramid()
    step = step_height(pyramid, UPPER, LOWER)
    assert set(pyramid.requested) == {1}
    assert "Read at level 1: each pixel is the mean of 4." in step.notes
    assert step.height.value_um == pytest.approx(STEP_UM, abs=0.05)


def surface_of_half(fine):
    z = fine.z_um.reshape(120, 2, 320, 2).mean(axis=(1, 3))
    half = surface_of(z, calibration=fine.provenance.calibration)
    return type(fine)(
        z_um=half.z_um,
        z_raw_um=half.z_um,
        confidence=half.confidence,
        all_in_focus=half.all_in_focus,
        origin=half.origin,
        pixel_um=2 * fine.pixel_um,
        x0_um=fine.x0_um + fine.pixel_um / 2,
        y0_um=fine.y0_um - fine.pixel_um / 2,
        provenance=fine.provenance,
    )


@given(height=st.floats(-500, 500), slope_x=st.floats(-0.05, 0.05), slope_y=st.floats(-0.05, 0.05))
@settings(max_examples=examples(25))
def test_any_step_on_any_plane_is_found(height, slope_x, slope_y):
    x_um, y_um = np.meshgrid((np.arange(120) - 59.5) * 0.5, (29.5 - np.arange(60)) * 0.5)
    surface = surface_of(slope_x * x_um + slope_y * y_um + np.where(x_um < 0, height, 0.0))
    step = step_height(surface, Region.rectangle(-28, -14, -4, 14), Region.rectangle(4, -14, 28, 14))
    assert step.height.value_um == pytest.approx(height, abs=1e-3)


def test_a_surface_stitched_in_memory_is_measured_like_its_only_field():
    blocks = gauge_blocks(1)
    lone = Field(number=1, row=0, col=0, x_um=float(blocks.x_um.mean()), y_um=float(blocks.y_um.mean()), z_start_um=0.0)
    step = step_height(stitch([blocks], [lone]), UPPER, LOWER)
    assert step.height.value_um == pytest.approx(step_height(blocks, UPPER, LOWER).height.value_um, abs=1e-4)
