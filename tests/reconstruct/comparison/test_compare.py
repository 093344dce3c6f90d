"""Two surfaces laid over each other and subtracted: what was moved is found, what has changed is seen."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from tests.support.compared_surfaces import X0_UM, Y0_UM, a_texture, taken, tilted, with_bump, with_heights
from tests.truth.endless_wafer import Wafer
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.surface.comparison import Registration
from wafer_viewer.model.surface.height_map import Origin, Provenance
from wafer_viewer.reconstruct.comparison.compare import compare, read_as
from wafer_viewer.reconstruct.comparison.resampled_surface import ResampledMosaic


@pytest.fixture(scope="module")
def first():
    return taken()


def shift_at_centre(found: Registration, x_um: float, y_um: float, turn_mrad: float) -> tuple[float, float]:
    """The true shift about the centre that a registration has: turns are made about the first pixel."""
    turn, dx, dy = turn_mrad * 1e-3, found.about_x_um - X0_UM, found.about_y_um - Y0_UM
    cos, sin = math.cos(turn), math.sin(turn)
    return x_um + cos * dx - sin * dy - dx, y_um + sin * dx + cos * dy - dy


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("moved", [(3.3, -7.7, 0.0), (21.2, -11.1, 3.0), (-8.0, 12.4, -45.0)])
def test_shift_and_turn_are_found_within_their_uncertainty(first, moved):
    found = compare(first, taken(*moved, seed=1)).registration
    x_um, y_um = shift_at_centre(found, *moved)
    assert found.by == "images"
    assert found.u_xy_um < 0.2
    assert found.u_turn_mrad < 0.6
    assert abs(found.x_um - x_um) < found.u_xy_um
    assert abs(found.y_um - y_um) < found.u_xy_um
    assert abs(found.turn_mrad - moved[2]) < found.u_turn_mrad


@pytest.mark.slow
def test_height_and_tilt_are_found_within_their_uncertainty(first):
    found = compare(first, tilted(taken(3.0, 2.0, seed=1), 4.2, 2.0, -1.0)).registration
    at_centre = 4.2 + 1e-3 * (2.0 * (found.about_x_um - 3.0 - X0_UM) - (found.about_y_um - 2.0 - Y0_UM))
    assert abs(found.z_um + at_centre) < found.u_z_um + 2.2e-3 * found.u_xy_um
    assert abs(found.tilt_x_mrad + 2.0) < found.u_tilt_mrad
    assert abs(found.tilt_y_mrad - 1.0) < found.u_tilt_mrad
    assert found.u_z_um < 0.01
    assert found.residual_um < 0.1


def test_what_was_added_is_seen_at_its_place_with_its_volume_and_moves_nothing_else(first):
    second = tilted(with_bump(taken(6.0, -4.0, seed=1), slice(200, 240), slice(300, 360), 2.0), 1.0, 0.5)
    made = compare(first, second)
    off = made.window()
    changed = off.z_um > 1.0
    x, y = off.x_um[changed.any(axis=0)], off.y_um[changed.any(axis=1)]
    full = changed[np.ix_(np.abs(off.y_um - (Y0_UM - 220 - 4)) < 15, np.abs(off.x_um - (X0_UM + 330 + 6)) < 25)]
    assert full.mean() > 0.98
    assert (x.min(), y.max()) != (off.x_um[0], off.y_um[0])
    numbers = made.change()
    assert numbers.gained_um3 - numbers.lost_um3 == pytest.approx(40 * 60 * 2.0, rel=0.05)
    assert numbers.changed_fraction < 0.06
    assert abs(numbers.median_um) < 0.01
    assert numbers.limit_um == pytest.approx(3 * 0.05 * math.sqrt(2), rel=0.3)


def test_raw_and_cleaned_of_the_same_frames_need_no_alignment(first):
    cleaned = first.z_um + np.float32(0.5)
    surface = dataclasses.replace(first, z_um=cleaned, provenance=Provenance(input_checksum="abc"))
    made = compare(read_as(surface, "raw"), read_as(surface, "cleaned"))
    assert made.registration == Registration(by="same")
    assert made.change().mean_um == pytest.approx(0.5, abs=1e-5)
    assert made.change().sq_um < 1e-5
    assert np.array_equal(made.window().all_in_focus, first.all_in_focus)


def test_a_golden_surface_keeps_z_when_requested(first):
    second = tilted(taken(4.0, 3.0, seed=1, wafer=Wafer(seed=2)), 3.0)
    made = compare(first, second, keep_z=True)
    assert not made.registration.levelled
    assert made.registration.x_um == pytest.approx(4.0, abs=0.3)
    assert made.change().median_um == pytest.approx(3.0, abs=0.3)


def test_by_the_stage_only_z_and_tilt_are_taken_out(first):
    made = compare(first, tilted(with_heights(first, first.z_um), 2.0, 1.0), align="stage")
    assert (made.registration.by, made.registration.x_um, made.registration.u_xy_um) == ("stage", 0.0, None)
    assert made.change().sq_um < 0.01
    stored = compare(first, with_heights(first, first.z_um + 2), align="none").registration
    assert (stored.z_um, stored.levelled) == (0.0, False)


def test_unmeasured_stays_unmeasured_for_the_reason_it_has(first):
    z = first.z_um.copy()
    z[100:140, 200:260] = np.nan
    other = with_heights(first, z)
    part = compare(first, other, align="stage").window()
    assert np.isnan(part.z_um[100:140, 200:260]).all()
    assert (part.origin[100:140, 200:260] == Origin.NO_TEXTURE).all()
    assert np.isfinite(part.z_um[:99]).all()
    assert (part.confidence <= np.minimum(first.confidence, other.confidence) + 1e-6).all()


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize(
    ("second", "align", "why"),
    [
        (lambda first: a_texture(2), "images", "do not look alike.*align by the stage"),
        (lambda first: a_texture(2, contrast=0.0), "images", "align by the stage"),
        (lambda first: dataclasses.replace(first, x0_um=5000.0), "auto", "lie beside each other"),
        (lambda first: with_heights(first, first.z_um * np.nan), "stage", "measured at 0 of the places"),
        (lambda first: with_heights(first, first.z_um * np.nan), "none", "No place is measured in both"),
        (lambda first: first, "somehow", "it must be one of auto, images, stage, none"),
    ],
)
def test_what_cannot_be_compared_is_refused_with_its_mend(second, align, why):
    of = a_texture(1)
    with pytest.raises(MeasureError, match=why):
        compare(of, second(of), align=align)


def test_the_second_is_read_at_the_level_that_fits_its_pixels(first):
    coarse = ResampledMosaic(first, taken(pixel_um=2.0, shape=(240, 320), seed=1), Registration()).window()
    inside = coarse.z_um[100:300, 150:450] - first.z_um[100:300, 150:450]
    assert abs(np.nanmedian(inside)) < 0.05
    assert coarse.shape == first.shape
