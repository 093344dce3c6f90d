"""One offset of each repeating pattern is chosen by all overlaps together, or none where that would be a guess."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.truth.overlaps import EDGE_PX, PIXEL_UM, STAGE_PX, Fields, Numbers, grid, repeating, shifts_of
from wafer_viewer.model.surface.field_poses import N_CANDIDATE, RejectionReason, Shifts
from wafer_viewer.reconstruct.pose_graph.candidate_choice import Choice, choose_candidates

REACH_PX = 40.0


def patterned(
    fields: Fields, pitch_px: float, seed: int, unique: float = 0.0, reach_px: float = REACH_PX
) -> tuple[Shifts, Numbers]:
    """Overlaps that fit at every period within reach, and where the fields are, [n, 2]; unique: fraction with marks."""
    rng = np.random.default_rng(seed)
    shifts, true = shifts_of(fields, rng)
    steps = np.arange(-8, 9)
    lattice = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2) * pitch_px * PIXEL_UM
    table = np.full((len(shifts.first), 25, N_CANDIDATE), np.nan, np.float32)
    marked = rng.random(len(shifts.first)) < unique
    for row, x_um, y_um, is_marked in zip(table, shifts.x_um, shifts.y_um, marked, strict=True):
        at = lattice + np.array([x_um, y_um])
        at = at[np.abs(at).max(axis=1) < reach_px * PIXEL_UM]
        at = at[np.argsort(np.hypot(*at.T), kind="stable")][:25]
        wrong = np.hypot(*(at - (x_um, y_um)).T) > PIXEL_UM
        row[: len(at), :2] = at
        row[: len(at), 2:5] = np.array([1, 0, 1]) / (EDGE_PX * PIXEL_UM) ** 2
        row[: len(at), 5] = np.where(wrong, 20.0 if is_marked else 0.0, 0.0)
    doubt = np.full(len(table), RejectionReason.AMBIGUOUS, np.uint8)
    some = rng.integers(0, np.isfinite(table[:, :, 0]).sum(axis=1))
    off = table[np.arange(len(table)), some, :2].astype(float)
    return dataclasses.replace(shifts, candidates=table, doubt=doubt, x_um=off[:, 0], y_um=off[:, 1]), true


def chosen(fields: Fields, shifts: Shifts, **given: object) -> Choice:
    choice = choose_candidates(fields.x_um, fields.y_um, shifts, PIXEL_UM, **given)
    assert choice is not None
    return choice


def error_px(fields: Fields, true: Numbers, choice: Choice) -> Numbers:
    """How far the expected offsets of the overlaps to be measured are off, [e, 2]."""
    moved = true - np.column_stack((fields.x_um, fields.y_um))
    off = choice.expected_um - (moved[fields.pairs[:, 1]] - moved[fields.pairs[:, 0]])
    return off[choice.to_measure] / PIXEL_UM


@pytest.mark.slow
@pytest.mark.parametrize("pitch_px", [200.0, 60.0, STAGE_PX / 0.14])
@pytest.mark.parametrize("size", [(4, 4), (8, 9)])
def test_the_right_period_is_chosen_where_the_stage_is_good_enough(size, pitch_px):
    """But for a field that the stage has more than three standard deviations off: the nearest period is likelier."""
    wrong: list[np.ndarray] = []
    for seed in range(3):
        fields = grid(*size)
        shifts, true = patterned(fields, pitch_px, seed)
        choice = chosen(fields, shifts)
        assert choice.to_measure.mean() > 0.9
        wrong.append(np.abs(error_px(fields, true, choice)).max(axis=1) > 1.0)
    assert np.concatenate(wrong).mean() < (0.03 if pitch_px < 50 else 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("of_pitch", [0.25, 0.35, 0.6])
def test_no_wrong_period_is_believed_by_a_stage_that_is_too_coarse(of_pitch):
    refused = []
    for seed in range(4):
        fields = grid(8, 9)
        shifts, true = patterned(fields, STAGE_PX / of_pitch, seed)
        choice = chosen(fields, shifts)
        refused.append(choice.refused)
        assert choice.refused == (not choice.to_measure.any())
        if not choice.refused:
            assert np.abs(error_px(fields, true, choice)).max() < 1.0
    assert np.mean(refused) > 0.8
    (note,) = choice.notes(PIXEL_UM)
    assert "no period was chosen" in note


def test_few_fields_do_not_show_how_good_the_stage_is_but_a_person_may_know():
    fields = grid(2, 2)
    for seed in range(4):
        assert not chosen(fields, patterned(fields, 30.0, seed)[0]).to_measure.any()
        shifts, true = patterned(fields, 60.0, seed)
        choice = chosen(fields, shifts, stage_error_um=STAGE_PX * PIXEL_UM)
        assert choice.to_measure.any()
        assert np.abs(error_px(fields, true, choice)).max() < 1.0


def test_marks_that_are_there_once_decide_where_the_stage_does_not():
    for seed in range(4):
        fields = grid(6, 6)
        shifts, true = patterned(fields, 20.0, seed, unique=1.0)
        choice = chosen(fields, shifts)
        assert not choice.refused
        assert choice.to_measure.mean() > 0.9
        assert np.abs(error_px(fields, true, choice)).max() < 1.0


def test_backlash_of_alternating_rows_is_found_along_the_way():
    """Every second row is 9 px late, which adds to the scatter of the stage a good part of the pitch."""
    fields = grid(10, 8)
    shifts, true = patterned(fields, 40.0, 5)
    late_um = 9.0 * PIXEL_UM * (np.unique(fields.y_um, return_inverse=True)[1] % 2)
    told = dataclasses.replace(fields, x_um=fields.x_um - late_um)
    lag_um = late_um[fields.pairs[:, 1]] - late_um[fields.pairs[:, 0]]
    table = shifts.candidates.copy()
    table[:, :, 0] += lag_um[:, None]
    choice = chosen(told, dataclasses.replace(shifts, candidates=table, x_um=shifts.x_um + lag_um))
    assert choice.to_measure.mean() > 0.9
    assert np.abs(error_px(told, true, choice)).max() < 1.0


def test_fields_that_are_fixed_stay_and_place_the_others():
    fields = grid(5, 5)
    shifts, true = patterned(fields, 50.0, 2)
    fixed = np.arange(25) < 20
    choice = chosen(fields, shifts, fixed=fixed, start=(true[:, 0], true[:, 1]))
    assert choice.to_measure.all()
    assert np.abs(error_px(fields, true, choice)).max() < 1.0


def test_fields_that_are_all_fixed_stay():
    fields = grid(3, 3)
    shifts, true = patterned(fields, 50.0, 4)
    choice = chosen(fields, shifts, fixed=np.ones(9, bool), start=(true[:, 0], true[:, 1]))
    assert choice.to_measure.all()
    assert np.abs(error_px(fields, true, choice)).max() < 1.0


def test_what_was_measured_at_the_chosen_period_is_not_measured_again():
    fields = grid(4, 4)
    shifts, true = patterned(fields, 60.0, 1)
    moved = true - np.column_stack((fields.x_um, fields.y_um))
    at = moved[fields.pairs[:, 1]] - moved[fields.pairs[:, 0]]
    known = dataclasses.replace(shifts, x_um=at[:, 0], y_um=at[:, 1], doubt=np.zeros(len(at), np.uint8))
    choice = chosen(fields, known)
    assert not choice.to_measure.any()
    assert choice.shifts.believed.all()
    assert not chosen(fields, dataclasses.replace(known, x_um=at[:, 0] + 60 * PIXEL_UM)).shifts.believed.any()


@pytest.mark.parametrize("seed", [8, 9, 11, 12, 19])
def test_neighbours_that_hold_each_other_do_not_lie_a_period_off_together(seed):
    """A mark in their overlap holds them at each other; of the overlaps around, one of each speaks for the truth."""
    pitch_px, pair = STAGE_PX / 0.12, np.array([12, 13])
    fields = grid(5, 5)
    shifts, true = patterned(fields, pitch_px, seed, reach_px=3 * pitch_px)
    late_um = np.zeros(25)
    late_um[pair] = 0.54 * pitch_px * PIXEL_UM - (true[:, 0] - fields.x_um)[pair]
    told = dataclasses.replace(fields, x_um=fields.x_um - late_um)
    first, second = fields.pairs.T
    moved = true - np.column_stack((told.x_um, told.y_um))
    at = moved[second] - moved[first]
    table, doubt = shifts.candidates.copy(), shifts.doubt.copy()
    table[:, :, 0] += (late_um[second] - late_um[first])[:, None]
    n_of_pair = np.isin(fields.pairs, pair).sum(axis=1)
    telling = [next(e for e in np.flatnonzero(n_of_pair == 1) if n in fields.pairs[e]) for n in pair]
    wrong = np.abs(table[telling, :, :2] - at[telling, None]).max(axis=2) > PIXEL_UM
    table[telling, :, 5] = np.where(wrong, 4.0, 0.0)
    table[n_of_pair == 2] = np.nan
    doubt[n_of_pair == 2] = 0
    known = dataclasses.replace(shifts, candidates=table, doubt=doubt, x_um=at[:, 0], y_um=at[:, 1])
    choice = chosen(told, known)
    assert choice.to_measure.mean() > 0.8
    assert np.abs(error_px(told, true, choice)).max() < 1.0


@pytest.mark.campaign
def test_a_few_patterns_among_very_many_fields_are_chosen_like_those_of_few_fields():
    """From 2000 fields on, they are moved together by an iterative solver."""
    fields, random = grid(60, 50), np.random.default_rng(8)
    shifts, true = shifts_of(fields, random, wrong=0.02, blank=0.05)
    shifts = repeating(shifts, random, 0.02, 45.0)
    choice = chosen(fields, shifts)
    assert choice.to_measure.sum() > 0.95 * shifts.repeats.sum() > 50
    assert np.abs(error_px(fields, true, choice)).max() < 1.0


def test_without_patterns_there_is_nothing_to_choose():
    fields = grid(3, 3)
    shifts, _ = shifts_of(fields, np.random.default_rng(0))
    assert choose_candidates(fields.x_um, fields.y_um, shifts, PIXEL_UM) is None


def test_rows_do_not_alternate_by_a_period_for_the_sake_of_a_smaller_scatter():
    """A backlash of one period fits as well as none, and is the less likely."""
    for seed in range(12):
        fields = grid(4, 3)
        shifts, true = patterned(fields, STAGE_PX / 0.13, seed)
        choice = chosen(fields, shifts)
        off = np.abs(error_px(fields, true, choice))
        assert not off.size or (off.max(axis=1) > 1).mean() < 0.5


def test_fields_know_how_sure_their_period_is():
    fields = grid(6, 6)
    choice = chosen(fields, patterned(fields, 60.0, 3)[0])
    assert choice.odds_nats.shape == (36,)
    assert choice.odds_nats.min() > 4.0
    coarse = chosen(fields, patterned(fields, STAGE_PX / 0.16, 3)[0])
    assert np.median(coarse.odds_nats) < np.median(choice.odds_nats)
    refused = chosen(fields, patterned(fields, STAGE_PX / 0.6, 3)[0])
    assert refused.refused
    assert (refused.odds_nats == 0).all()


def test_pictures_that_mislead_at_half_resolution_do_not_make_the_stage_look_coarse():
    """All overlaps fit one period off a little better, as a pattern does between binned pixels."""
    fields = grid(6, 6)
    shifts, true = patterned(fields, 60.0, 3)
    moved = true - np.column_stack((fields.x_um, fields.y_um))
    at = moved[fields.pairs[:, 1]] - moved[fields.pairs[:, 0]]
    table = shifts.candidates.copy()
    whole = np.abs(table[:, :, :2] - at[:, None]).max(axis=2) < PIXEL_UM
    table[:, :, 5] += np.where(whole, 5.0, 0.0)
    choice = chosen(fields, dataclasses.replace(shifts, candidates=table))
    assert choice.to_measure.mean() > 0.9
    assert np.abs(error_px(fields, true, choice)).max() < 1.0


@pytest.mark.slow
def test_what_very_many_pictures_tell_a_little_does_not_make_alternating_rows_likely():
    """In each overlap the right period fits a little worse than others, by noise and alike in all of them."""
    fields, rng = grid(20, 20), np.random.default_rng(7)
    shifts, true = patterned(fields, 60.0, 3, reach_px=160.0)
    moved = true - np.column_stack((fields.x_um, fields.y_um))
    at = moved[fields.pairs[:, 1]] - moved[fields.pairs[:, 0]]
    table = shifts.candidates.copy()
    whole = np.abs(table[:, :, :2] - at[:, None]).max(axis=2) < PIXEL_UM
    table[:, :, 5] += np.where(whole, 0.2, 0.0) + rng.exponential(0.2, table.shape[:2])
    choice = chosen(fields, dataclasses.replace(shifts, candidates=table))
    assert choice.to_measure.mean() > 0.9
    assert np.abs(error_px(fields, true, choice)).max() < 1.0
