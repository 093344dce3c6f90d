"""The plane through what is left of a die."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.measure.dies.die_cells import DiePlane

SHAPE = (90, 130)


def tilted() -> np.ndarray:
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return (0.02 * rows - 0.01 * cols + 3).astype(np.float32)


def test_a_tilted_die_is_levelled_despite_a_tall_object_on_it() -> None:
    z_um = tilted()
    z_um[10:25, 30:50] += 40
    z_um[60:, 100:] = np.nan
    plane = DiePlane.of(z_um)
    assert (plane.down, plane.right) == (pytest.approx(0.02, abs=1e-5), pytest.approx(-0.01, abs=1e-5))
    left = plane.off(tilted())
    assert np.abs(left).max() < 1e-3


def test_a_part_of_a_die_is_taken_off_the_same_plane() -> None:
    z_um = tilted()
    plane = DiePlane.of(z_um)
    assert np.abs(plane.seen_from(40, 70).off(z_um[40:, 70:])).max() < 1e-3
    assert plane.at(40, 70) == pytest.approx(float(z_um[40, 70]), abs=1e-3)


def test_a_die_of_which_hardly_anything_is_known_is_taken_to_be_level() -> None:
    z_um = np.full(SHAPE, np.nan, np.float32)
    z_um[0, :20] = 5
    assert DiePlane.of(z_um) == DiePlane()
