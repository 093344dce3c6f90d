"""How far parts of pictures are displaced is a property of a scan: its overlaps share it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.truth.overlaps import grid, shifts_of
from wafer_viewer.model.surface.field_poses import RejectionReason, Shifts, joined, no_shifts, selected, unknown_drift
from wafer_viewer.reconstruct.registration.pair_registration import with_own_drift, with_pooled_drift

SCATTER_UM2, DRIFT_UM2 = 0.001, 0.01


def overlaps(freedom: float, drift_um2: float = DRIFT_UM2, noise_um2: float = 0.0, seed: int = 1) -> Shifts:
    """287 overlaps that show a drift with some degrees of freedom, and noise on top of it."""
    random = np.random.default_rng(seed)
    shifts, _ = shifts_of(grid(12, 13), random)
    n = len(shifts.first)
    shown = drift_um2 * random.chisquare(freedom, (n, 2)) / freedom + noise_um2 * random.normal(size=(n, 2))
    drift = np.column_stack((np.full((n, 2), SCATTER_UM2), shown, np.full(n, freedom)))
    return with_own_drift(replace(shifts, drift=drift))


def by_drift_um2(shifts: Shifts) -> np.ndarray:
    return np.column_stack((shifts.u_x_um, shifts.u_y_um)) ** 2 - SCATTER_UM2


@pytest.mark.parametrize("freedom", [2.0, 4.0, 20.0])
def test_the_drift_of_a_scan_is_right_and_no_overlap_has_much_less(freedom):
    own, pooled = (by_drift_um2(f(overlaps(freedom))) for f in (with_own_drift, with_pooled_drift))
    expected = by_drift_um2(with_own_drift(replace(overlaps(freedom), drift=_all_alike(freedom)))).mean()
    assert pooled.mean() == pytest.approx(expected, rel=0.1)
    assert pooled.min() > 0.4 * expected > own.min()
    assert pooled.std() < 0.8 * own.std()


def _all_alike(freedom: float) -> np.ndarray:
    return np.tile([SCATTER_UM2, SCATTER_UM2, DRIFT_UM2, DRIFT_UM2, freedom], (len(overlaps(freedom).first), 1))


def test_x_and_y_are_pooled_apart():
    shifts = overlaps(2.0)
    shifts.drift[:, 2] = 0.0
    pooled = with_pooled_drift(shifts)
    np.testing.assert_allclose(pooled.u_x_um**2, SCATTER_UM2)
    assert np.all(pooled.u_y_um**2 > 3 * SCATTER_UM2)


def test_nothing_is_added_where_nothing_drifts():
    shifts = overlaps(2.0, drift_um2=0.0, noise_um2=0.002)
    assert by_drift_um2(with_pooled_drift(shifts)).mean() <= by_drift_um2(shifts).mean()


def test_neither_the_order_of_overlaps_nor_an_earlier_pooling_matters():
    shifts = overlaps(2.0)
    pooled, order = with_pooled_drift(shifts), np.random.default_rng(2).permutation(len(shifts.first))
    for other in (selected(with_pooled_drift(selected(shifts, order)), np.argsort(order)), with_pooled_drift(pooled)):
        np.testing.assert_array_equal(other.u_x_um, pooled.u_x_um)
        np.testing.assert_array_equal(other.u_y_um, pooled.u_y_um)
    np.testing.assert_array_equal(with_own_drift(pooled).u_x_um, shifts.u_x_um)


def test_rejected_overlaps_do_not_count_and_wrong_ones_hardly():
    shifts = overlaps(2.0)
    n = len(shifts.first)
    alone = with_pooled_drift(selected(shifts, np.arange(n // 2)))
    shifts.drift[n // 2 :, 2:4] = 1.0
    rejected = replace(shifts, doubt=np.where(np.arange(n) < n // 2, 0, RejectionReason.UNLIKE).astype(np.uint8))
    np.testing.assert_array_equal(with_pooled_drift(rejected).u_x_um[: n // 2], alone.u_x_um)
    few = selected(shifts, np.arange(n // 2 + n // 20))
    assert np.all(with_pooled_drift(few).u_x_um[: n // 2] < 1.2 * alone.u_x_um)


def test_few_overlaps_are_rather_too_unsure():
    """The root mean square of errors over their uncertainties, of scans of four overlaps each."""
    random = np.random.default_rng(3)
    own, pooled = [], []
    for seed in range(200):
        four = selected(overlaps(2.0, seed=seed), np.arange(4))
        error_um = np.sqrt(SCATTER_UM2 + by_drift_um2(with_own_drift(replace(four, drift=_all_alike(2.0)[:4]))))
        error_um = error_um * random.normal(size=(4, 2))
        own.append(error_um[:, 0] / with_own_drift(four).u_x_um)
        pooled.append(error_um[:, 0] / with_pooled_drift(four).u_x_um)
    assert np.mean(np.abs(own) > 3) > 0.02
    assert np.mean(np.abs(pooled) > 3) < 0.01


def test_an_overlap_of_unknown_drift_keeps_its_uncertainty():
    shifts = overlaps(2.0)
    shifts = replace(shifts, drift=np.where(np.arange(len(shifts.first))[:, None] < 5, np.nan, shifts.drift))
    assert np.array_equal(with_pooled_drift(shifts).u_x_um[:5], shifts.u_x_um[:5])
    unknown = replace(shifts, drift=unknown_drift(len(shifts.first)))
    assert np.array_equal(with_pooled_drift(unknown).u_x_um, shifts.u_x_um)
    assert len(with_pooled_drift(joined([no_shifts()])).first) == 0
