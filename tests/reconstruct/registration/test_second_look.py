"""Overlaps that the search loses are found where the poses expect them; what is not alike stays lost."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from tests.support.overlapping_tiles import PIXEL_UM, Sample, a_field, a_sample
from tests.truth.drawn_grids import PIXEL_UM as DRAWN_PIXEL_UM
from tests.truth.drawn_grids import drawn, made
from wafer_viewer.model.surface.field_poses import RejectionReason, Shifts
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.reconstruct.registration.pair_registration import look_again, refine, register

SHAPE = (120, 140)
PAIR = np.array([[0, 1]], np.int32)
OFF_PX = (2.5, -3.0)


def stripes(shape: tuple[int, int], turn: float, seed: int = 1) -> Sample:
    """Stripes of random widths and greys at an angle, in rad."""
    rng = np.random.default_rng(seed)
    line = gaussian_filter1d(rng.normal(size=2000), 4.0)
    down, right = np.indices(shape)
    at = np.cos(turn) * down - np.sin(turn) * right + 500
    grey = np.interp(at, np.arange(2000), line)
    return Sample(110 + 18 * grey / grey.std(), np.zeros(shape))


def two_fields(sample: Sample, noise: float = 2.0) -> list[HeightMap]:
    return [
        a_field(sample, 10, 10, SHAPE, noise_counts=noise, seed=1),
        a_field(sample, 10, 122, SHAPE, off_px=OFF_PX, noise_counts=noise, seed=2),
    ]


def lost(heights: list[HeightMap], doubt: RejectionReason = RejectionReason.UNLIKE) -> Shifts:
    """The overlap as if the search had not found it."""
    found = register(heights, PAIR)
    nothing = np.full(1, np.inf)
    return dataclasses.replace(found, doubt=np.array([doubt], np.uint8), u_x_um=nothing, u_y_um=nothing)


def looked(heights: list[HeightMap], shifts: Shifts, expected_px: tuple[float, float], u_px: float) -> Shifts:
    expected_um = np.array([expected_px]) * PIXEL_UM
    u_um = np.array([u_px * PIXEL_UM])
    return look_again(shifts, expected_um, u_um, PIXEL_UM, lambda pairs, at: refine(heights, pairs, at))


@pytest.mark.parametrize("expected_px", [(-3.0, -2.5), (0.0, 0.0)], ids=str)
def test_what_the_search_lost_is_found_near_the_expected_shift(expected_px: tuple[float, float]):
    heights = two_fields(a_sample((150, 300)))
    found = looked(heights, lost(heights), expected_px, 4.0)
    assert found.believed.all()
    assert (found.x_um[0] / PIXEL_UM, found.y_um[0] / PIXEL_UM) == pytest.approx((-3.0, -2.5), abs=0.05)


def test_of_lines_only_the_place_across_them_counts():
    turn = 0.6
    heights = two_fields(stripes((150, 300), turn))
    found = looked(heights, lost(heights), (0.0, 0.0), 4.0)
    assert found.believed.all()
    across = np.array([np.sin(turn), np.cos(turn)])  # to the right and up
    off = np.array([found.x_um[0], found.y_um[0]]) / PIXEL_UM - (-3.0, -2.5)
    assert abs(off @ (across * (-1, -1))) < 0.1 or abs(off @ (across * (-1, 1))) < 0.1


@pytest.mark.parametrize("doubt", [RejectionReason.UNLIKE, RejectionReason.BLANK, RejectionReason.END_OF_SEARCH])
def test_a_field_of_another_sample_stays_lost(doubt: RejectionReason):
    first, _ = two_fields(a_sample((150, 300)))
    for seed in range(8):
        _, other = two_fields(a_sample((150, 300), seed=seed + 5))
        heights = [first, other]
        assert not looked(heights, lost(heights, doubt), (0.0, 0.0), 5.0).believed.any()


def test_noise_alone_is_not_alike():
    flat = Sample(np.full((150, 300), 110.0), np.zeros((150, 300)))
    heights = two_fields(flat, noise=4.0)
    shifts = register(heights, PAIR)
    assert shifts.doubt[0] == RejectionReason.BLANK
    assert not looked(heights, shifts, (0.0, 0.0), 5.0).believed.any()


def test_a_match_that_may_be_chance_counts_where_the_poses_allow_it():
    """The search ended at the true place, but not surely; no beginning about the expected one comes near it."""
    heights = two_fields(stripes((150, 300), 0.6))
    told = lost(heights, RejectionReason.AMBIGUOUS)
    told = dataclasses.replace(told, u_x_um=(known := register(heights, PAIR)).u_x_um, u_y_um=known.u_y_um)
    across = np.array([np.sin(0.6), np.cos(0.6)])  # to the right and up
    at = np.array([told.x_um[0], told.y_um[0]]) / PIXEL_UM
    x_px, y_px = (at + 12.0 * across).tolist()
    found = looked(heights, told, (x_px, y_px), 6.0)
    assert found.believed.all()
    assert abs((np.array([found.x_um[0], found.y_um[0]]) / PIXEL_UM - at) @ across) < 0.1
    assert not looked(heights, told, (x_px, y_px), 2.0).believed.any()


@pytest.mark.parametrize(("seed", "pair"), [(71, (19, 24)), (292, (16, 17))], ids=str)
def test_lines_in_noise_that_fit_at_full_resolution_are_found(seed: int, pair: tuple[int, int]):
    """Between binned pixels their correlation is 0.6 to 0.7, which chance may reach too; refined it is about 0.9."""
    grid = made(drawn(seed))
    first, second = pair
    shifts = register(grid.heights, np.array([pair], np.int32))
    assert shifts.doubt[0] in (RejectionReason.NONE, RejectionReason.AMBIGUOUS)
    moved = (grid.true_um - grid.stage_um)[second] - (grid.true_um - grid.stage_um)[first]
    across = np.array([np.sin(grid.drawn.angle), np.cos(grid.drawn.angle)])
    assert abs((np.array([shifts.x_um[0], shifts.y_um[0]]) - moved) @ across) < 0.2 * DRAWN_PIXEL_UM


def test_a_match_far_from_where_it_is_expected_is_not_accepted():
    heights = two_fields(a_sample((150, 300)))
    assert not looked(heights, lost(heights), (2.5, 2.5), 0.0).believed.any()


def test_accepted_overlaps_stay_as_they_are():
    heights = two_fields(a_sample((150, 300)))
    shifts = register(heights, PAIR)
    assert shifts.believed.all()
    assert looked(heights, shifts, (0.0, 0.0), 4.0) is shifts
