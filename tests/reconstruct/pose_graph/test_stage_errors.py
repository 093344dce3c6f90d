"""Fields that no overlap ties down lie where the errors of the stage at the other fields put them."""

from __future__ import annotations

import numpy as np
import pytest

from tests.truth.overlaps import PIXEL_UM, STAGE_PX, Fields, grid, shifts_of
from wafer_viewer.model.surface.field_poses import RejectionReason
from wafer_viewer.reconstruct.pose_graph.lateral_poses import solve_positions
from wafer_viewer.reconstruct.pose_graph.pose_graph import LEAST_TIED, between_neighbours

UM = STAGE_PX * PIXEL_UM


def placed(
    fields: Fields, moved: np.ndarray, untied: list[int], pixel_um: float = PIXEL_UM
) -> tuple[np.ndarray, np.ndarray]:
    """Errors [k, 2] and uncertainties of untied fields, where all others are known; `moved`: off the stage, [n, 2]."""
    stage = np.column_stack((fields.x_um, fields.y_um))
    true = stage + moved
    place, u = true.copy(), np.full_like(true, 0.01)
    place[untied], u[untied] = stage[untied], UM
    group = np.zeros(len(stage), np.int32)
    group[untied] = np.arange(1, len(untied) + 1)
    found, known = between_neighbours(stage, place, u, group, fields.pairs, pixel_um)
    tied = group == 0
    np.testing.assert_array_equal(found[tied], place[tied])
    return (found - true)[untied], known[untied]


def test_backlash_and_turn_of_the_stage_hold_for_untied_fields_too():
    fields, rng = grid(6, 6), np.random.default_rng(1)
    moved = rng.normal(0, 0.1, (36, 2))
    moved[:, 0] += 4.0 * (np.unique(fields.y_um, return_inverse=True)[1] % 2) + 2e-3 * fields.y_um
    moved[:, 1] -= 2e-3 * fields.x_um
    error, u = placed(fields, moved, [9, 22])
    assert np.abs(error).max() < 0.5
    assert (u >= UM).all()  # never surer than the solver had it


def test_errors_that_neighbours_share_are_taken_from_them_and_others_are_not():
    fields = grid(9, 9)
    smooth = np.column_stack((6 * np.sin(fields.x_um / 700), 6 * np.cos(fields.y_um / 600)))
    by_stage = np.abs(smooth - smooth.mean(axis=0))[[30, 50]].max()
    error, _ = placed(fields, smooth, [30, 50])
    assert np.abs(error).max() < 0.6 * by_stage
    alike, worse = [], []
    for seed in range(20):
        moved = np.random.default_rng(seed).normal(0, UM, (81, 2))
        error, _ = placed(fields, moved, [30, 50])
        alike.append(np.square(error).mean())
        worse.append(np.square(moved[[30, 50]]).mean())
    assert np.mean(alike) < 1.15 * np.mean(worse)


def test_few_fields_show_nothing_of_the_stage():
    fields = grid(2, 4)
    assert len(fields.x_um) <= LEAST_TIED
    moved = np.random.default_rng(2).normal(5, 1, (8, 2))
    error, _ = placed(fields, moved, [3])
    np.testing.assert_allclose(error, -moved[[3]])


@pytest.mark.parametrize("seed", range(3))
def test_a_field_without_overlaps_is_placed_by_the_errors_that_all_fields_share(seed: int):
    """The whole stage is turned: raw positions put the corner far off, and its uncertainty covers what is left."""
    fields = grid(6, 6)
    shifts, true = shifts_of(fields, np.random.default_rng(seed), turn=1.5e-2)
    lost = (fields.pairs == 0).any(axis=1)
    shifts.doubt[lost] = RejectionReason.BLANK
    shifts.u_x_um[lost] = shifts.u_y_um[lost] = np.inf
    found = solve_positions(fields.x_um, fields.y_um, shifts, PIXEL_UM)
    off = np.column_stack((found.x_um, found.y_um)) - true
    off -= np.median(off[1:], axis=0)
    assert np.abs(off[0]).max() < 4 * max(found.u_x_um[0], found.u_y_um[0])
    assert found.u_x_um[0] > 1.5 * found.u_x_um[20]
