"""Fields are placed by all their overlaps at once, whatever some of these say."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from tests.truth.overlaps import PIXEL_UM, STAGE_PX, Fields, grid, shifts_of, wafer
from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.surface.field_poses import Form, Numbers, RejectionReason, Shifts, selected
from wafer_viewer.numerics.block_gradients import LOOSE_PX
from wafer_viewer.reconstruct.pose_graph import amg_solver, robust_solver
from wafer_viewer.reconstruct.pose_graph.lateral_poses import CameraAxes, Positions, solve_positions

WHOLE = grid(13, 16)


def solved(fields: Fields, shifts: Shifts, **how: object) -> Positions:
    return solve_positions(fields.x_um, fields.y_um, shifts, PIXEL_UM, **how)  # type: ignore[arg-type]


def off_px(found: Positions, true: Numbers) -> Numbers:
    """How far each field is from where it is, once all are shifted together."""
    off = np.column_stack((found.x_um, found.y_um)) - true
    return np.hypot(*(off - np.median(off, axis=0)).T) / PIXEL_UM


def rms(values: Numbers) -> float:
    return float(np.sqrt(np.mean(values**2)))


def observations(fields: Fields, seed: int, **how: float) -> tuple[Shifts, Numbers]:
    return shifts_of(fields, np.random.default_rng(seed), **how)


def only(shifts: Shifts, edges: Numbers, **values: float) -> Shifts:
    """The shifts, with those of some edges changed by so many pixels."""
    x_um, y_um = shifts.x_um.copy(), shifts.y_um.copy()
    x_um[edges] += values.get("x_px", 0.0) * PIXEL_UM
    y_um[edges] += values.get("y_px", 0.0) * PIXEL_UM
    return dataclasses.replace(shifts, x_um=x_um, y_um=y_um)


def lines(fields: Fields, seed: int, turn: float) -> tuple[Shifts, Numbers]:
    """What overlaps say that show lines at an angle (rad) to the x axis: the place across them, along them nothing."""
    shifts, true = observations(fields, seed)
    across, along = np.array([-np.sin(turn), np.cos(turn)]), np.array([np.cos(turn), np.sin(turn)])
    told = (np.column_stack((shifts.x_um, shifts.y_um)) @ across)[:, None] * across
    covariance = (shifts.u_x_um**2)[:, None, None] * np.outer(across, across)
    covariance = covariance + (LOOSE_PX * PIXEL_UM) ** 2 * np.outer(along, along)
    u_x_um, u_y_um = (np.sqrt(covariance[:, k, k]) for k in range(2))
    return dataclasses.replace(
        shifts,
        x_um=told[:, 0],
        y_um=told[:, 1],
        u_x_um=u_x_um,
        u_y_um=u_y_um,
        covariance_um2=covariance[:, 0, 1],
    ), true


def across_px(found: Positions, true: Numbers, turn: float) -> Numbers:
    """How far each field is off across lines, once all are shifted together, in pixels."""
    off = (np.column_stack((found.x_um, found.y_um)) - true) @ (-np.sin(turn), np.cos(turn))
    return np.abs(off - np.median(off)) / PIXEL_UM


def test_all_overlaps_together_know_each_field_to_a_tenth_of_a_pixel():
    shifts, true = observations(WHOLE, 1)
    found = solved(WHOLE, shifts)
    off = off_px(found, true)
    assert rms(off) <= 0.10
    assert off.max() <= 0.5
    assert found.stage_error_um == pytest.approx(STAGE_PX * PIXEL_UM, rel=0.1)
    assert np.all(found.group == 0)
    assert not found.notes
    assert np.all(found.shifts.believed)
    assert found.shifts.weight.mean() > 0.8
    assert rms(found.shifts.residual_x_um) < 0.06 * PIXEL_UM


@pytest.mark.parametrize("seed", [1, 3, 4])
def test_wrong_and_blank_overlaps_change_little(seed):
    shifts, true = observations(WHOLE, seed, wrong=0.03, blank=0.1)
    found = solved(WHOLE, shifts)
    clean, _ = observations(WHOLE, seed)
    wrong = np.hypot(shifts.x_um - clean.x_um, shifts.y_um - clean.y_um) > PIXEL_UM
    assert rms(off_px(found, true)) <= 0.2
    assert np.all(found.shifts.doubt[wrong] == RejectionReason.DISAGREES)
    assert np.all(found.shifts.weight[wrong] < 0.1)
    assert np.all(found.shifts.believed == (~wrong & shifts.believed))


@pytest.mark.parametrize("seed", [2, 5, 6, 7])
def test_a_field_that_two_good_overlaps_hold_is_right(seed):
    shifts, true = observations(WHOLE, seed, wrong=0.03, blank=0.1)
    clean, _ = observations(WHOLE, seed)
    good = shifts.believed & (np.hypot(shifts.x_um - clean.x_um, shifts.y_um - clean.y_um) < PIXEL_UM)
    held = np.bincount(WHOLE.pairs[good].ravel(), minlength=len(true)) >= 2
    assert not np.all(held)
    assert rms(off_px(solved(WHOLE, shifts), true)[held]) <= 0.2


def test_what_an_overlap_doubts_by_itself_does_not_count():
    shifts, _ = observations(WHOLE, 4, blank=0.1)
    doubtful = dataclasses.replace(shifts, doubt=np.where(np.arange(len(shifts.doubt)) % 7, 0, 2).astype(np.uint8))
    found = solved(WHOLE, only(doubtful, np.flatnonzero(doubtful.doubt), x_px=3.0))
    assert np.all(found.shifts.weight[doubtful.doubt == RejectionReason.UNLIKE] == 0)
    assert np.all(found.shifts.doubt[doubtful.doubt == RejectionReason.UNLIKE] == RejectionReason.UNLIKE)
    assert np.all(found.shifts.weight[np.isinf(shifts.u_x_um)] == 0)


def test_of_contradicting_ties_of_a_field_those_win_that_agree():
    fields = grid(5, 5)
    shifts, true = observations(fields, 5)
    ties = np.flatnonzero((fields.pairs == 12).any(axis=1))
    misled = only(only(shifts, ties[:1], x_px=14.8), ties[1:2], y_px=-11.0)
    found = solved(fields, misled)
    assert off_px(found, true).max() < 0.5
    assert list(np.flatnonzero(found.shifts.doubt)) == list(ties[:2])


def test_a_field_that_hangs_on_one_overlap_is_not_dragged_far_from_the_stage():
    fields = grid(4, 4)
    shifts, true = observations(fields, 6)
    ties = np.flatnonzero((fields.pairs == 0).any(axis=1))
    found = solved(fields, selected(only(shifts, ties[:1], x_px=80.0), np.arange(len(shifts.first)) != ties[1]))
    assert found.shifts.weight[ties[0]] < 0.1
    assert found.group[0] not in found.group[1:]
    assert abs(found.x_um[0] - fields.x_um[0]) < PIXEL_UM
    assert rms(off_px(found, true)[1:]) < 0.2


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_one_wrong_overlap_does_not_drag_half_of_the_fields_along_a_known_camera(seed):
    fields = grid(4, 8)
    shifts, _ = observations(fields, seed)
    across = np.flatnonzero((fields.pairs % 8 < 4).sum(axis=1) == 1)
    misled = selected(only(shifts, across[:1], x_px=-38.0), ~np.isin(np.arange(52), across[1:]))
    found = solved(fields, misled, camera=CameraAxes())
    assert np.sum(found.shifts.doubt == RejectionReason.DISAGREES) == 1
    assert found.group[0] != found.group[7]
    assert found.stage_error_um < 1.4 * STAGE_PX * PIXEL_UM


def test_a_turned_camera_is_found_and_the_surface_lies_along_its_axes():
    shifts, true = observations(WHOLE, 7, turn=1.2e-3, scale=-4e-3)
    found = solved(WHOLE, shifts)
    assert found.camera.turn == pytest.approx(1.2e-3, abs=4 * found.camera.u_turn)
    assert found.camera.scale == pytest.approx(-4e-3, abs=4 * found.camera.u_scale)
    assert rms(off_px(found, true)) <= 0.10
    assert "The camera is turned by 1.2" in found.notes[0]
    assert "anticlockwise against the stage: calibrate its angle." in found.notes[0]
    assert "a pixel is 0.469" in found.notes[1]
    assert "not 0.46729 um" in found.notes[1]
    x_um, y_um = found.camera.from_stage(WHOLE.x_um, WHOLE.y_um)
    assert np.hypot(found.x_um - x_um, found.y_um - y_um).mean() < 2 * found.stage_error_um
    assert found.camera.from_stage(found.camera.middle_x_um, found.camera.middle_y_um) == (
        WHOLE.x_um.mean(),
        WHOLE.y_um.mean(),
    )
    assert CameraAxes.of(found.camera.in_form(Form())) == found.camera


def test_axes_of_a_stage_that_are_not_alike_are_found():
    fields = grid(12, 12)
    axes = {"scale": 7e-4, "stretch": 2e-4, "skew": -1.5e-4}
    shifts, true = observations(fields, 1007, stage_px=1.0, backlash_px=6.0, **axes)
    found = solved(fields, shifts)
    for name, value in axes.items():
        u = getattr(found.camera, f"u_{name}")
        assert getattr(found.camera, name) == pytest.approx(value, abs=3 * u)
        assert 1e-5 < u < 4e-5
    scales, angle = found.notes
    assert re.search(r"lie 0\.09\d% further apart along x and 0\.05\d% further apart along y than by the", scales)
    assert scales.endswith(": calibrate the stage and the pixel size.")
    assert re.search(r"the axes of the stage are 0\.3\d mrad off square .*: calibrate the stage\.", angle)
    assert rms(off_px(found, true)) <= 0.1
    assert CameraAxes.of(found.camera.in_form(Form())) == found.camera


def test_skew_alone_is_no_scale():
    shifts, _ = observations(grid(12, 12), 1010, stage_px=1.0, skew=2e-4)
    (note,) = solved(grid(12, 12), shifts).notes
    assert re.match(r"The overlaps say the axes of the stage are 0\.(3|4)\d mrad off square", note)


@pytest.mark.parametrize("rows", [2, 3, 4])
def test_backlash_of_few_rows_is_no_skew(rows):
    fields = grid(rows, 12)
    shifts, _ = observations(fields, 1008, stage_px=0.5, backlash_px=8.0)
    assert not solved(fields, shifts).notes


def test_scale_that_contradicts_a_calibration_is_told_with_it():
    known = {"pixel_um": PIXEL_UM, "u_z_scale": 1e-3, "made": "2026-03-01", "due": "2027-03-01", "against": "standard"}
    shifts, _ = observations(WHOLE, 1009, scale=2e-3)
    sure, unsure = (Calibration(u_pixel_um=u * PIXEL_UM, **known) for u in (5e-5, 1e-3))
    (note,) = solved(WHOLE, shifts, calibration=sure).notes
    assert "not 0.46729 um, but the calibration of 2026-03-01 gives the pixel size within 0.0001 (k = 2" in note
    (note,) = solved(WHOLE, shifts, calibration=unsure).notes
    assert note.endswith("not 0.46729 um: calibrate the pixel size.")


@pytest.mark.parametrize(("rows", "cols"), [(2, 2), (4, 4), (13, 16)])
def test_a_wrong_pixel_size_is_refused_with_both_sizes(rows, cols):
    fields = grid(rows, cols)
    shifts, _ = observations(fields, 8, scale=0.07)
    with pytest.raises(ComputeError, match=r"a pixel is 0\.43\d+ um, not 0\.46729 um: give the pixel size"):
        solved(fields, shifts)


def test_one_wrong_overlap_is_not_a_wrong_pixel_size():
    fields = grid(1, 2)
    shifts, _ = observations(fields, 9)
    assert not solved(fields, only(shifts, np.array([0]), x_px=60.0)).notes


def test_fields_that_are_fixed_stay_and_others_are_placed_next_to_them():
    shifts, true = observations(WHOLE, 10, turn=2e-3)
    before = solved(WHOLE, shifts)
    late = np.isin(np.arange(len(WHOLE.x_um)), (0, 17, 100, 207))
    neighbour = selected(shifts, late[WHOLE.pairs].any(axis=1))
    start = (np.where(late, np.nan, before.x_um), np.where(late, np.nan, before.y_um))
    found = solved(WHOLE, neighbour, fixed=~late, start=start, camera=before.camera)
    assert np.array_equal(found.x_um[~late], before.x_um[~late])
    assert np.array_equal(found.y_um[~late], before.y_um[~late])
    assert off_px(found, true)[late].max() < 0.3
    assert found.camera == before.camera
    assert np.all(found.u_x_um[~late] == 0)
    assert np.all(found.u_x_um[late] < 0.1 * PIXEL_UM)


def test_a_late_field_without_overlaps_lies_where_the_turned_camera_sees_it():
    shifts, _ = observations(WHOLE, 11, turn=2e-3)
    before = solved(WHOLE, shifts)
    late = np.arange(len(WHOLE.x_um)) == 0
    none = selected(shifts, np.zeros(len(shifts.first), np.bool_))
    found = solved(WHOLE, none, fixed=~late, start=(before.x_um, before.y_um), camera=before.camera)
    expected = before.camera.from_stage(WHOLE.x_um, WHOLE.y_um)
    assert (found.x_um[0], found.y_um[0]) == pytest.approx((expected[0][0], expected[1][0]))


def test_islands_are_each_held_by_the_stage():
    fields = grid(6, 10)
    shifts, true = observations(fields, 12)
    across = (fields.pairs % 10 < 5).sum(axis=1) == 1
    found = solved(fields, selected(shifts, ~across))
    left = np.arange(60) % 10 < 5
    assert len(np.unique(found.group)) == 2
    assert len(np.unique(found.group[left])) == 1
    for island in (left, ~left):
        off = np.column_stack((found.x_um, found.y_um))[island] - true[island]
        assert np.all(np.abs(off.mean(axis=0)) < 4 * found.u_x_um[island].mean())
        assert np.hypot(*(off - off.mean(axis=0)).T).max() < 0.5 * PIXEL_UM


@pytest.mark.parametrize("fields", [grid(1, 30), grid(30, 1), wafer(150), grid(1, 1), grid(1, 2)])
def test_any_list_of_fields_is_placed(fields):
    shifts, true = observations(fields, 13)
    found = solved(fields, shifts)
    assert off_px(found, true).max() < 1.0
    assert np.all(np.isfinite(found.u_x_um))
    assert np.all(found.group == 0)


def test_without_overlaps_fields_lie_where_the_stage_says():
    shifts, _ = observations(WHOLE, 14, blank=1.0)
    found = solved(WHOLE, shifts, stage_error_um=3.0)
    assert np.array_equal(found.x_um, WHOLE.x_um)
    assert len(np.unique(found.group)) == len(WHOLE.x_um)
    assert np.allclose(found.u_x_um, 3.0)
    nobody = solved(Fields(np.zeros(0), np.zeros(0), np.zeros((0, 2), np.int32)), selected(shifts, slice(0)))
    assert len(nobody.x_um) == 0


def test_an_overlap_constraining_one_direction_is_used_for_it():
    fields = grid(6, 6)
    shifts, true = observations(fields, 15)
    neighbour = np.abs(fields.pairs[:, 0] - fields.pairs[:, 1]) == 1
    blind = dataclasses.replace(shifts, u_y_um=np.where(neighbour, np.inf, shifts.u_y_um))
    found = solved(fields, blind)
    off = found.x_um - true[:, 0]
    assert np.abs(off - off.mean()).max() < 0.5 * PIXEL_UM
    assert found.u_y_um.mean() > 1.5 * found.u_x_um.mean()


def test_oblique_lines_hold_a_field_between_two_parts_that_the_stage_has_off():
    """Across the lines the stage is 16 px off there; that is one deviation, though both coordinates show it."""
    turn, n_rejected = 2.65, 0
    fields = grid(6, 3).without(np.isin(np.arange(18), (7, 8)))
    towards = (fields.pairs[:, 1] == 6).astype(float) - (fields.pairs[:, 0] == 6)
    off_px = 16.0 * np.array([-np.sin(turn), np.cos(turn)])
    for seed in range(20):
        shifts, _ = lines(fields, seed, turn)
        x_um, y_um = shifts.x_um + towards * off_px[0] * PIXEL_UM, shifts.y_um + towards * off_px[1] * PIXEL_UM
        found = solved(fields, dataclasses.replace(shifts, x_um=x_um, y_um=y_um))
        n_rejected += not found.shifts.believed.all()
    assert n_rejected <= 2


@pytest.mark.parametrize("seed", range(6))
def test_of_oblique_lines_those_that_contradict_the_others_are_rejected(seed):
    fields = grid(5, 5)
    shifts, true = lines(fields, seed, 0.5)
    wrong = np.flatnonzero((fields.pairs == 12).any(axis=1))[:1]
    found = solved(fields, only(shifts, wrong, x_px=-14.8 * np.sin(0.5), y_px=14.8 * np.cos(0.5)))
    assert np.flatnonzero(~found.shifts.believed).tolist() == wrong.tolist()
    assert across_px(found, true, 0.5).max() < 0.5


@pytest.mark.slow
@pytest.mark.campaign
def test_uncertainties_cover_the_errors():
    fields, ratios = grid(7, 7), []
    for seed in range(60):
        shifts, true = observations(fields, seed)
        found = solved(fields, shifts, stage_error_um=STAGE_PX * PIXEL_UM)
        ratios.append(((found.x_um - true[:, 0]) / found.u_x_um, (found.y_um - true[:, 1]) / found.u_y_um))
    assert 0.85 < rms(np.array(ratios)) < 1.15


@pytest.mark.slow
@pytest.mark.campaign
def test_many_fields_are_solved_like_few(monkeypatch):
    fields = wafer(900)
    shifts, _ = observations(fields, 17, wrong=0.03, blank=0.1, turn=1e-3)
    at_once = solved(fields, shifts)
    monkeypatch.setattr(amg_solver, "DIRECT_FIELDS", 60)
    monkeypatch.setattr(robust_solver, "EXACT_STEPS", 0)
    by_levels = solved(fields, shifts)
    assert np.hypot(by_levels.x_um - at_once.x_um, by_levels.y_um - at_once.y_um).max() < 0.1 * PIXEL_UM
    assert np.array_equal(by_levels.shifts.doubt, at_once.shifts.doubt)
    assert by_levels.stage_error_um == pytest.approx(at_once.stage_error_um, rel=0.05)
    assert by_levels.camera.turn == pytest.approx(at_once.camera.turn, rel=1e-2)
    ratio = by_levels.u_x_um / at_once.u_x_um
    assert 0.8 < ratio.mean() < 1.2
    assert ratio.std() < 0.15
