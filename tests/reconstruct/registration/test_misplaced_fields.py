"""Fields that fit nowhere are named and left out; the innocent stay."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.overlapping_tiles import Sample, a_field, a_sample, with_heights
from wafer_viewer.model.surface.field_poses import RejectionReason, Shifts, no_candidates, unknown_bend, unknown_drift
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.reconstruct.registration.misplaced_fields import (
    TURNS,
    has_no_heights,
    judge_misfit,
    misplaced_fields,
    reoriented,
    unverifiable_fields,
)
from wafer_viewer.reconstruct.registration.overlap_strips import neighbours
from wafer_viewer.reconstruct.registration.pair_registration import register

SHAPE = (120, 140)
PITCH = (95, 112)


def observations(edges: list[tuple[int, int, RejectionReason]]) -> Shifts:
    first, second, doubt = (np.array(column) for column in zip(*edges, strict=True))
    zeros = np.zeros(len(edges))
    return Shifts(
        first=first,
        second=second,
        x_um=zeros,
        y_um=zeros,
        u_x_um=zeros,
        u_y_um=zeros,
        correlation=zeros,
        by=zeros.astype(np.uint8),
        doubt=doubt.astype(np.uint8),
        weight=zeros,
        residual_x_um=zeros,
        residual_y_um=zeros,
        covariance_um2=zeros,
        candidates=no_candidates(len(zeros)),
        drift=unknown_drift(len(zeros)),
        bend=unknown_bend(len(zeros)),
    )


def grid_edges(
    rows: int, cols: int, misfits: set[int], doubt: RejectionReason = RejectionReason.UNLIKE
) -> list[tuple[int, int, RejectionReason]]:
    number = np.arange(rows * cols).reshape(rows, cols)
    pairs = [*zip(number[:, :-1].ravel(), number[:, 1:].ravel(), strict=True)]
    pairs += [*zip(number[:-1].ravel(), number[1:].ravel(), strict=True)]
    return [(a, b, doubt if misfits & {a, b} else RejectionReason.NONE) for a, b in pairs]


@pytest.mark.parametrize("misfits", [{4}, {0}, {4, 7}, {0, 8}, set()], ids=str)
def test_fields_that_fit_none_of_their_neighbours_are_suspects(misfits):
    assert set(misplaced_fields(9, observations(grid_edges(3, 3, misfits)))) == misfits


def test_blank_and_ambiguous_fields_are_innocent():
    assert len(misplaced_fields(9, observations(grid_edges(3, 3, {4}, RejectionReason.BLANK)))) == 0
    assert len(misplaced_fields(9, observations(grid_edges(3, 3, {4}, RejectionReason.AMBIGUOUS)))) == 0


def test_an_ambiguous_overlap_does_not_save_a_field_that_three_speak_against():
    edges = grid_edges(3, 3, {4})
    edges[2] = (*edges[2][:2], RejectionReason.AMBIGUOUS)
    assert 4 in edges[2][:2]
    assert misplaced_fields(9, observations(edges)).tolist() == [4]


def test_one_overlap_that_fits_is_enough_to_stay():
    edges = grid_edges(3, 3, {4})
    edges[2] = (*edges[2][:2], RejectionReason.NONE)
    assert 4 in edges[2][:2]
    assert len(misplaced_fields(9, observations(edges))) == 0


def test_the_end_of_a_row_is_named_but_stays():
    edges = [(0, 1, RejectionReason.NONE), (1, 2, RejectionReason.NONE), (2, 3, RejectionReason.UNLIKE)]
    assert misplaced_fields(4, observations(edges)).tolist() == []
    assert unverifiable_fields(4, observations(edges)).tolist() == [3]


def test_two_datasets_in_one_the_smaller_is_left_out():
    own = [(a, b, d) for a, b, d in grid_edges(4, 4, set()) if (a % 4 == 3) == (b % 4 == 3)]
    across = [(a, a + 1, RejectionReason.UNLIKE) for a in (2, 6, 10, 14)]
    assert misplaced_fields(16, observations(own + across)).tolist() == [3, 7, 11, 15]


def test_islands_do_not_judge_each_other():
    one, two = grid_edges(2, 2, set()), [(a + 4, b + 4, d) for a, b, d in grid_edges(3, 3, {8})]
    assert misplaced_fields(13, observations(one + two)).tolist() == [12]


@pytest.fixture(scope="module")
def heights() -> list[HeightMap]:
    sample: Sample = a_sample((340, 400))
    rng = np.random.default_rng(0)
    return [
        a_field(
            sample, 15 + r * PITCH[0], 15 + c * PITCH[1], SHAPE, off_px=tuple(rng.uniform(-3, 3, 2)), seed=3 * r + c
        )
        for r in range(3)
        for c in range(3)
    ]


@pytest.mark.parametrize("how", TURNS)
def test_a_field_held_the_wrong_way_is_found_and_reported(heights, how):
    back = {
        "turned by 90 degrees clockwise": "turned by 90 degrees anticlockwise",
        "turned by 90 degrees anticlockwise": "turned by 90 degrees clockwise",
    }
    wrong = reoriented(heights[4], TURNS[back.get(how, how)])
    assert f"Field 5 is {how} and" in judge_misfit(5, wrong, [heights[n] for n in (1, 3, 5, 7)])


def test_a_grid_with_a_mirrored_field(heights):
    mixed = [*heights[:4], reoriented(heights[4], np.fliplr), *heights[5:]]
    pairs = neighbours(mixed)
    assert misplaced_fields(9, register(mixed, pairs, 8.0)).tolist() == [4]
    assert len(misplaced_fields(9, register(heights, pairs, 8.0))) == 0


def test_a_field_of_another_sample(heights):
    other = a_field(a_sample((340, 400), seed=8), 110, 127, SHAPE)
    words = judge_misfit(5, other, [heights[n] for n in (1, 3, 5, 7)])
    assert words.startswith("Field 5 fits none of its 4 neighbours")
    assert "another sample" in words


def test_a_field_without_heights(heights):
    nowhere = np.full(SHAPE, np.nan)
    assert has_no_heights(with_heights(heights[0], nowhere))
    nowhere[61, 43] = 1.0
    assert not has_no_heights(with_heights(heights[0], nowhere))


def test_turning_keeps_the_centre(heights):
    held = reoriented(heights[0], TURNS["turned by 90 degrees clockwise"])
    assert held.shape == SHAPE[::-1]
    for one, other in zip(
        np.reshape(heights[0].bounds_um, (2, 2)).mean(0), np.reshape(held.bounds_um, (2, 2)).mean(0), strict=True
    ):
        assert one == pytest.approx(other)


def test_of_two_halves_that_do_not_fit_neither_is_left_out():
    none, unlike = RejectionReason.NONE, RejectionReason.UNLIKE
    halves = observations([(0, 1, none), (2, 3, none), (0, 2, unlike), (1, 3, unlike)])
    assert misplaced_fields(4, halves).size == 0
    assert unverifiable_fields(4, halves).tolist() == [2, 3]
