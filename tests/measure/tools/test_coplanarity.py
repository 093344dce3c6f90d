"""Bumps found on a tilted die: their heights, their coplanarity, what U says, what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import uniform_filter

from tests.support.bumped_surface import HEIGHT_UM, PITCH_UM, bumped
from tests.support.made_up_pictures import all_of, covered
from tests.support.surfaces import PIXEL_UM, noise_of, surface_of
from wafer_viewer.measure.base.error_covariance import ErrorCovariance, WeightedHeights
from wafer_viewer.measure.tools.coplanarity import Top, coplanarity, least_squares, seating
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.recipe import Recipe

RADIUS_OF_SHALLOW_UM = 20.0
"""Radius of the sphere of bumps of 4 um on a foot of 12 um."""


def found_on(made, **about):
    return coplanarity(made.surface, all_of(made.surface), **about)


@pytest.fixture(scope="module")
def die():
    return bumped()


@pytest.fixture(scope="module")
def found(die):
    return found_on(die)


@pytest.mark.slow
def test_100_bumps_and_the_tall_one_among_them(die, found):
    assert (found.n_bumps, found.left_out) == (100, 0)
    assert found.coplanarity.value_um == pytest.approx(die.range_um, abs=found.coplanarity.expanded_um)
    assert found.coplanarity.expanded_um < 0.3
    assert found.tilt_mrad == pytest.approx(2.0, abs=0.3)
    worst = found.bumps[0]
    assert (worst.place.x_um, worst.place.y_um) == (pytest.approx(20, abs=0.2), pytest.approx(60, abs=0.2))
    assert worst.deviation.value_um == pytest.approx(3, abs=0.7)
    assert worst.height.value_um == pytest.approx(HEIGHT_UM + 3, abs=0.6)
    assert worst.diameter_um == pytest.approx(24, abs=1), "its flank is upright from half of its height down"
    assert any("least-squares plane of all tops" in note for note in found.notes)


@pytest.mark.slow
def test_the_uncertainty_covers_the_heights_of_bumps(die, found):
    truth = {(round(x / PITCH_UM, 1), round(y / PITCH_UM, 1)): z - 2e-3 * x for x, y, z in die.tops}
    heights = [(bump.height, truth[_half(bump.place.x_um), _half(bump.place.y_um)]) for bump in found.bumps]
    errors = [length.value_um - true for length, true in heights]
    assert covered(errors, [length.expanded_um for length, _ in heights]) >= 0.88
    assert found.mean_height.value_um == pytest.approx(np.mean([z for _, z in heights]), abs=0.03)


def _half(um):
    return round(um / PITCH_UM - 0.5) + 0.5


@pytest.mark.slow
@pytest.mark.campaign
def test_the_uncertainty_of_coplanarity_covers_its_error():
    made = [bumped(side=3, seed=seed) for seed in range(6)]
    found = [found_on(one).coplanarity for one in made]
    errors = [length.value_um - one.range_um for length, one in zip(found, made, strict=True)]
    assert covered(errors, [length.expanded_um for length in found]) >= 0.8


def top_at(x_um, y_um, z_um):
    one = WeightedHeights(np.array([x_um]), np.array([y_um]), np.ones(1))
    errors = ErrorCovariance(np.full((1, 1), 0.01), PIXEL_UM, 1000.0, 3)
    return Top(x_um, y_um, z_um, z_um, 4.0, 0.1, one, one, errors)


def test_the_ground_round_shallow_bumps_is_read_where_the_window_sees_no_bump():
    window_px, made = 9, bumped(side=4, seed=4, noise_um=0.0, high_um=4.0, tall_um=0.0)
    seen = uniform_filter(uniform_filter(made.surface.z_um, window_px), window_px)
    held = made.surface.provenance.calibration
    found = coplanarity(surface_of(seen, calibration=held, recipe=Recipe(window=window_px)), all_of(made.surface))
    sag_um = 2 * (window_px**2 - 1) / 12 * PIXEL_UM**2 / RADIUS_OF_SHALLOW_UM
    over_um = float(np.mean(made.tops[:, 2] - made.tilt * made.tops[:, 0]))
    assert found.n_bumps == 16
    assert found.mean_height.value_um == pytest.approx(over_um - sag_um, abs=0.02)
    assert abs(found.mean_height.value_um - over_um) <= found.mean_height.expanded_um


def test_the_seating_plane_touches_three_tops_and_none_lies_over_it():
    places = [(-10.0, -10.0), (10.0, -10.0), (-10.0, 10.0), (10.0, 10.0), (0.0, 1.0)]
    heights = [5.0, 5.0, 5.0, 4.0, 5.5]
    tops = tuple(top_at(x, y, z) for (x, y), z in zip(places, heights, strict=True))
    seated = seating(tops)
    assert seated.deviation_um.max() == pytest.approx(0, abs=1e-9)
    assert np.count_nonzero(np.abs(seated.deviation_um) < 1e-9) >= 3
    assert seated.range_um > least_squares(tops).range_um


def test_both_planes_are_offered_and_each_says_which_it_is():
    made = bumped(side=3)
    found = found_on(made, reference="seating")
    assert found.options.reference == "seating"
    assert any("on which the part would stand" in note for note in found.notes)
    assert found.coplanarity.value_um != pytest.approx(made.range_um, abs=0.01)


@pytest.mark.slow
def test_bumps_that_are_cut_or_not_measured_are_left_out_and_counted():
    made = bumped(side=4, holes=True)
    found = found_on(made)
    assert (found.n_bumps, found.left_out) == (12, 4)
    cut = coplanarity(made.surface, Region.rectangle(-20, -100, 100, 100))
    assert cut.n_bumps == 8
    assert cut.left_out >= 1


def test_without_a_calibration_there_is_no_u():
    found = found_on(bumped(side=3), calibration_valid=False)
    assert (found.coplanarity.status, found.coplanarity.expanded_um) == ("uncalibrated", None)
    assert found.bumps[0].height.status == "uncalibrated"


def flat():
    return surface_of(noise_of(1, (200, 200), 0.1))


def unmeasured():
    return surface_of(np.full((100, 100), np.nan))


@pytest.mark.parametrize(
    ("made", "region", "sentence"),
    [
        (flat, Region.rectangle(-40, -40, 40, 40), "No bump stands out of the ground"),
        (unmeasured, Region.rectangle(-20, -20, 20, 20), "Nothing is measured in the region"),
        (flat, Region.rectangle(900, 0, 950, 50), "lies outside of the surface"),
        (flat, Region.point(0, 0), "has no area"),
        (
            lambda: bumped(side=4).surface,
            Region.rectangle(-45, -45, 5, 5),
            "needs 4 whole, measured bumps and the region",
        ),
    ],
)
def test_what_holds_no_bumps_is_one_sentence(made, region, sentence):
    with pytest.raises(MeasureError, match=sentence):
        coplanarity(made(), region)
