"""Nothing that is reconstructed or stitched depends on what lay in its memory before."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.truth.drawn_grids import drawn, made
from wafer_viewer.numerics.block_gradients import BlockGradients, lag_errors
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.reconstruct.stitching import stitch

Dirty = Callable[[float], None]
KINDS = {"random": 29, "lines": 1, "dusty dies": 10, "dies": 33}
"""Grids of at most 28 fields, by seed."""


@pytest.fixture
def dirty(monkeypatch: pytest.MonkeyPatch) -> Dirty:
    """Let arrays that numpy does not fill hold a value instead of what happens to be there."""
    empty = np.empty

    def fill_with(value: float) -> None:
        def filled(shape: Any, dtype: Any = float, *args: Any, **kwargs: Any) -> NDArray[Any]:
            array = empty(shape, dtype, *args, **kwargs)
            if array.dtype.kind in "fc":
                array.fill(value)
            return array

        monkeypatch.setattr(np, "empty", filled)

    return fill_with


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("seed", KINDS.values(), ids=KINDS.keys())
def test_poses_of_fields(dirty: Dirty, seed: int) -> None:
    grid, found = made(drawn(seed)), []
    for value in (1e9, -3.0):
        dirty(value)
        found.append(stitch(grid.heights).poses)
    for name in ("x_um", "y_um", "z_um", "u_x_um", "u_y_um", "left_out"):
        np.testing.assert_array_equal(getattr(found[0], name), getattr(found[1], name), name)
    for name in ("x_um", "y_um", "u_x_um", "u_y_um", "covariance_um2", "correlation"):
        np.testing.assert_array_equal(getattr(found[0].shifts, name), getattr(found[1].shifts, name), name)


def test_heights_of_a_field(dirty: Dirty, plane_stack: Any) -> None:
    found = []
    for value in (1e9, -3.0):
        dirty(value)
        found.append(reconstruct(plane_stack))
    for name in ("z_um", "z_raw_um", "origin", "confidence", "all_in_focus"):
        np.testing.assert_array_equal(getattr(found[0], name), getattr(found[1], name), name)


def test_the_covariance_of_blocks_without_neighbours(dirty: Dirty) -> None:
    index = np.array([(0, 0), (0, 2), (2, 0), (2, 2), (1, 1)], np.int64)
    table = np.zeros((5, 13))
    table[:, 6:8] = [(0.1, 0.2), (-0.1, 0.1), (0.2, -0.2), (-0.2, -0.1), (0.0, 0.1)]
    table[:, 8], table[:, 11] = 4.0, 5.0
    blocks = BlockGradients(index, table, np.concatenate((table[:, 6:12].sum(0), np.zeros(3))), (3, 3))
    found = []
    for value in (1e9, -3.0):
        dirty(value)
        found.append(lag_errors(blocks, blocks.total_stiffness, np.eye(2)).covariance)
    np.testing.assert_array_equal(*found)
    assert np.all(np.linalg.eigvalsh(found[0]) > 0)
