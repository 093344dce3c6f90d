"""Offsets and tilts of all fields are solved at once; what only the stage can tell is held to the stage."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.truth.overlaps import FIELD_UM, TILT, Z_UM, Fields, grid, seams_of, wafer
from wafer_viewer.model.surface.field_poses import Form, HeightOffsets, Numbers, selected
from wafer_viewer.reconstruct.pose_graph import amg_solver, robust_solver
from wafer_viewer.reconstruct.pose_graph.vertical_poses import VerticalPoses, solve_heights

WHOLE = grid(13, 16)


def observations(fields: Fields, seed: int, **how: object) -> tuple[HeightOffsets, Numbers]:
    return seams_of(fields, np.random.default_rng(seed), **how)  # type: ignore[arg-type]


def solved(fields: Fields, seams: HeightOffsets, **how: object) -> VerticalPoses:
    requested = {"z_error_um": "auto", "tilt_error": "auto", "field_size_um": FIELD_UM} | how
    return solve_heights(fields.x_um, fields.y_um, seams, **requested)  # type: ignore[arg-type]


def rms(values: Numbers) -> float:
    return float(np.sqrt(np.mean(values**2)))


def terms(fields: Fields, z_um: Numbers) -> Numbers:
    """Height, tilts, bow, twist and saddle at the rim, and below them what is left, rms."""
    x, y = fields.x_um - fields.x_um.mean(), fields.y_um - fields.y_um.mean()
    rim = np.hypot(x, y).max()
    x, y = x / rim, y / rim
    shapes = np.column_stack((np.ones_like(x), x, y, x**2 + y**2, 2 * x * y, x**2 - y**2))
    found = np.linalg.lstsq(shapes, z_um, rcond=None)[0]
    return np.append(found, rms(z_um - shapes @ found))


def test_offsets_and_tilts_of_the_stage_are_found():
    seams, poses = observations(WHOLE, 1)
    found = solved(WHOLE, seams)
    assert terms(WHOLE, found.z_um - poses[:, 0])[-1] < 0.03
    assert rms(found.tilt_x - poses[:, 1]) < 0.4 * TILT
    assert found.z_error_um == pytest.approx(Z_UM, rel=0.15)
    assert found.tilt_error == pytest.approx(TILT, rel=0.15)
    assert np.nanmedian(np.abs(found.seams.step_um)) < 0.003
    assert np.all(found.seams.weight > 0.1)


def test_a_bowed_wafer_is_stitched_without_distortion():
    x, y = WHOLE.x_um - WHOLE.x_um.mean(), WHOLE.y_um - WHOLE.y_um.mean()
    bow = 50 * (x**2 + y**2) / np.max(x**2 + y**2)
    seams, poses = observations(WHOLE, 2, sag_um=(0.05, 0.0, 0.05))
    found = solved(WHOLE, seams)
    corrected = bow + poses[:, 0] - found.z_um
    assert terms(WHOLE, corrected)[3] == pytest.approx(50, abs=found.form.u_um[3] * 1.5)
    assert found.form.u_um[3] < 0.2


def test_a_bowl_in_every_field_does_not_bend_the_whole():
    seams, poses = observations(WHOLE, 3, sag_um=(0.07, 0.02, 0.03))
    found = solved(WHOLE, seams)
    assert found.form.field_form_um == pytest.approx((0.07, 0.02, 0.03), abs=0.005)
    assert found.form.sag_um(np.array(FIELD_UM[0] / 2), np.array(FIELD_UM[1] / 2)) == pytest.approx(0.12, abs=0.01)
    assert np.abs(terms(WHOLE, found.z_um - poses[:, 0])[3:6]).max() < 0.2
    assert np.nanmedian(np.abs(found.seams.step_um)) < 0.003


def test_a_camera_that_leans_does_not_tilt_the_whole():
    seams, poses = observations(WHOLE, 4, lean=(1e-3, -5e-4))
    found = solved(WHOLE, seams)
    assert np.all(np.abs(terms(WHOLE, found.z_um - poses[:, 0])[1:3]) < np.array(found.form.u_um[1:3]) * 1.5)
    assert (found.tilt_x.mean(), found.tilt_y.mean()) == pytest.approx((1e-3, -5e-4), abs=1e-4)
    assert found.tilt_error == pytest.approx(TILT, rel=0.2)


def test_along_a_row_nothing_drifts():
    row = grid(1, 300)
    seams, poses = observations(row, 5)
    found = solved(row, seams)
    off = found.z_um - poses[:, 0]
    assert np.abs(off / found.u_z_um).max() < 4.5
    assert found.u_z_um.max() < Z_UM


def test_wrong_seams_lose_their_weight():
    seams, poses = observations(WHOLE, 6, wrong=0.03)
    clean, _ = observations(WHOLE, 6)
    found = solved(WHOLE, seams)
    wrong = seams.slope_x != clean.slope_x
    assert np.all(found.seams.weight[wrong] < 0.1)
    assert np.mean(found.seams.weight[~wrong] > 0.1) > 0.99
    assert terms(WHOLE, found.z_um - poses[:, 0])[-1] < 0.05


def test_islands_are_each_held_by_the_stage():
    fields = grid(6, 10)
    seams, poses = observations(fields, 7)
    across = (fields.pairs % 10 < 5).sum(axis=1) == 1
    found = solved(fields, selected(seams, ~across))
    left = np.arange(60) % 10 < 5
    for island in (left, ~left):
        off = found.z_um[island] - poses[island, 0]
        assert abs(off.mean()) < 4 * found.u_z_um[island].mean()
        assert off.std() < 0.4


@pytest.mark.parametrize("fields", [grid(1, 1), grid(1, 2), grid(5, 1), wafer(100)])
def test_any_list_of_fields_is_levelled(fields):
    seams, poses = observations(fields, 8)
    found = solved(fields, seams)
    assert np.all(np.isfinite(found.z_um))
    assert np.all(np.abs(found.z_um - poses[:, 0]) < 5 * found.u_z_um)
    assert len(found.form.u_um) == len(found.form.names) == 6


def test_uninformative_seams_leave_the_stage_positions():
    seams, _ = observations(WHOLE, 9)
    nothing = np.full(len(seams.z_um), np.nan)
    empty = dataclasses.replace(
        seams, z_um=nothing, mid_x_um=nothing, mid_y_um=nothing, rms_um=nothing, information=0 * seams.information
    )
    found = solved(WHOLE, empty, z_error_um=2.0)
    assert not np.any(found.z_um)
    assert np.allclose(found.u_z_um, 2.0)
    assert not np.any(found.seams.weight)
    assert np.all(np.isnan(found.seams.step_um))
    assert found.form.field_form_um == (0.0, 0.0, 0.0)


def test_what_is_left_in_a_seam_is_reported():
    seams, _ = observations(WHOLE, 10)
    found = solved(WHOLE, dataclasses.replace(seams, rms_um=np.full(len(seams.z_um), 0.5)))
    assert found.seams.rms_um == pytest.approx(np.hypot(0.5, found.seams.step_um))


def test_fields_that_are_fixed_stay_and_others_join_them():
    seams, _ = observations(WHOLE, 11, sag_um=(0.05, 0.0, 0.05))
    before = solved(WHOLE, seams)
    late = np.isin(np.arange(len(WHOLE.x_um)), (0, 17, 100, 207))
    neighbour = selected(seams, late[WHOLE.pairs].any(axis=1))
    start = tuple(np.where(late, np.nan, a) for a in (before.z_um, before.tilt_x, before.tilt_y))
    valid = dataclasses.replace(before.form, camera_turn=1e-3)
    found = solved(WHOLE, neighbour, fixed=~late, start=start, form=valid, z_error_um=1.0, tilt_error=1e-4)
    assert np.array_equal(found.z_um[~late], before.z_um[~late])
    assert np.array_equal(found.tilt_x[~late], before.tilt_x[~late])
    assert np.abs(found.z_um - before.z_um)[late].max() < 0.03
    assert found.form.field_form_um == before.form.field_form_um
    assert found.form.camera_turn == 1e-3


@pytest.mark.slow
@pytest.mark.campaign
def test_uncertainties_cover_the_errors():
    fields, of_fields, of_form = grid(7, 7), [], []
    for seed in range(60):
        seams, poses = observations(fields, seed)
        found = solved(fields, seams, z_error_um=Z_UM, tilt_error=TILT)
        off = found.z_um - poses[:, 0]
        of_fields.append(off / found.u_z_um)
        of_form.append(2 * terms(fields, off)[:6] / np.array(found.form.u_um))
    assert 0.85 < rms(np.array(of_fields)) < 1.15
    assert np.all(rms_of_columns(np.array(of_form)) < 1.4)


def rms_of_columns(values: Numbers) -> Numbers:
    return np.sqrt(np.mean(values**2, axis=0))


@pytest.mark.slow
@pytest.mark.campaign
def test_many_fields_are_solved_like_few(monkeypatch):
    fields = wafer(600)
    seams, _ = observations(fields, 12, wrong=0.02, sag_um=(0.05, 0.0, 0.05), lean=(1e-3, 0.0))
    at_once = solved(fields, seams)
    monkeypatch.setattr(amg_solver, "DIRECT_FIELDS", 60)
    monkeypatch.setattr(robust_solver, "EXACT_STEPS", 0)
    monkeypatch.setattr(robust_solver, "_ROOM", 0)  # errors are drawn and solved one set at a time
    by_levels = solved(fields, seams)
    assert np.abs(by_levels.z_um - at_once.z_um).max() < 0.3 * at_once.u_z_um.max()
    assert by_levels.form.field_form_um == pytest.approx(at_once.form.field_form_um, abs=1e-3)
    ratio = by_levels.u_z_um / at_once.u_z_um
    assert 0.85 < ratio.mean() < 1.15
    assert ratio.std() < 0.15


def test_a_form_without_a_sag_takes_nothing_off():
    assert not np.any(Form().sag_um(np.arange(3.0), np.arange(3.0)))
