"""What is known of fields placed earlier: overlaps are looked at once, and what hardly moved stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wafer_viewer.model.surface.field_poses import (
    Poses,
    RejectionReason,
    Shifts,
    no_candidates,
    no_seams,
    unknown_bend,
    unknown_drift,
)
from wafer_viewer.reconstruct.pose_graph.lateral_poses import PreviousSolution, freeze_unmoved_fields
from wafer_viewer.reconstruct.registration.pair_registration import with_own_drift, with_pooled_drift


def _shifts(pairs: np.ndarray) -> Shifts:
    n = len(pairs)
    zero, code = np.zeros(n), np.zeros(n, np.uint8)
    share = np.ones(n, np.float32)
    first, second = pairs.T.astype(np.int32)
    return Shifts(
        first,
        second,
        10.0 * first + second,
        *(zero, zero, zero, share, code, code, share, zero, zero, zero),
        no_candidates(n),
        unknown_drift(n),
        unknown_bend(n),
    )


def _poses(numbers: list[int], marks: list[int], shifts: Shifts) -> Poses:
    zero = np.zeros(len(numbers))
    return Poses(
        np.array(numbers, np.int32),
        np.array(marks),
        *(zero,) * 10,
        np.zeros(len(numbers), np.int32),
        np.zeros(len(numbers), bool),
        shifts,
        no_seams(),
    )


class _Looker:
    def __init__(self) -> None:
        self.requested: list[tuple[int, int]] = []

    def __call__(self, pairs: np.ndarray) -> Shifts:
        self.requested += [tuple(pair) for pair in pairs.tolist()]
        return _shifts(pairs)


def test_only_overlaps_of_new_fields_and_of_those_made_again_are_looked_at():
    earlier = _poses([3, 1, 2], [30, 10, 20], _shifts(np.array([[0, 2], [1, 2]])))
    valid = PreviousSolution.of(earlier, np.array([1, 2, 3, 4], np.int32), np.array([10, 20, 31, 40]))
    assert valid.unchanged.tolist() == [True, True, False, False]

    look = _Looker()
    shifts = valid.shifts(np.array([[0, 1], [1, 2], [2, 3]], np.int32), look)
    assert look.requested == [(1, 2), (2, 3)]
    found = dict(zip(zip(shifts.first.tolist(), shifts.second.tolist(), strict=True), shifts.x_um, strict=True))
    assert found == {(0, 1): 12.0, (1, 2): 12.0, (2, 3): 23.0}  # the first is what field 1 and 2 said earlier


def test_what_an_earlier_solution_did_not_believe_is_judged_anew():
    shifts = _shifts(np.array([[0, 1], [1, 2]]))
    doubted = replace(shifts, doubt=np.array([RejectionReason.DISAGREES, RejectionReason.BLANK], np.uint8))
    valid = PreviousSolution.of(
        _poses([1, 2, 3], [1, 1, 1], doubted), np.array([1, 2, 3], np.int32), np.ones(3, np.int64)
    )
    again = valid.shifts(np.array([[0, 1], [1, 2]], np.int32), _Looker())
    assert again.doubt.tolist() == [RejectionReason.NONE, RejectionReason.BLANK]


def test_an_overlap_is_as_sure_as_it_was_measured_whatever_the_others_showed_earlier():
    pairs = np.array([[0, 1], [1, 2]])
    drift = np.array([[0.001, 0.001, 0.0, 0.02, 2.0], [0.001, 0.001, 0.04, 0.0, 2.0]])
    measured = with_own_drift(replace(_shifts(pairs), drift=drift))
    pooled = with_pooled_drift(measured)
    assert np.all(pooled.u_x_um != measured.u_x_um)
    numbers, marks = np.array([1, 2, 3], np.int32), np.ones(3, np.int64)
    again = PreviousSolution.of(_poses([1, 2, 3], [1, 1, 1], pooled), numbers, marks).shifts(pairs, _Looker())
    np.testing.assert_array_equal(again.u_x_um, measured.u_x_um)
    np.testing.assert_array_equal(again.u_y_um, measured.u_y_um)


def test_a_field_that_hardly_moves_stays_where_it_is_drawn():
    numbers, marks = [1, 2, 3, 4, 5], [1, 1, 1, 1, 1]
    earlier = _poses(numbers, marks, _shifts(np.zeros((0, 2), int)))
    valid = PreviousSolution.of(earlier, np.array(numbers, np.int32), np.array([1, 1, 1, 1, 2]))
    now = replace(
        earlier,
        x_um=np.array([0.04, 0.06, 0.0, 0.0, 0.01]),
        tilt_x=np.array([0.0, 0.0, 3e-5, 0.0, 0.0]),
        left_out=np.array([False, False, False, True, False]),
    )
    held, moved = freeze_unmoved_fields(now, valid, pixel_um=0.5, corner_um=400.0)
    assert moved.tolist() == [False, True, True, True, True]
    assert held.x_um.tolist() == [0.0, 0.06, 0.0, 0.0, 0.01]


def test_without_an_earlier_solution_everything_is_new():
    valid = PreviousSolution.of(None, np.array([1, 2], np.int32), np.ones(2, np.int64))
    assert not valid.unchanged.any()
    poses = _poses([1, 2], [1, 1], _shifts(np.zeros((0, 2), int)))
    assert freeze_unmoved_fields(poses, valid, 0.5, 400.0)[1].all()


def test_what_moved_changed_or_is_gone_is_not_shown_where_it_was():
    earlier = _poses([5, 1, 2, 3], [1, 1, 1, 1], _shifts(np.zeros((0, 2), int)))
    valid = PreviousSolution.of(earlier, np.array([1, 2, 3], np.int32), np.array([1, 1, 2]))
    assert valid.stale(np.array([False, True, True])).tolist() == [0, 2, 3]
