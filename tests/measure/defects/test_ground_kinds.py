"""Plain, uneven and unknown ground of a reference."""

from __future__ import annotations

import numpy as np

from wafer_viewer.measure.defects.golden_die import ReferenceDie
from wafer_viewer.measure.defects.noise_model import coarser, kinds_of

SHAPE = (60, 80)


def golden(z_um: np.ndarray, picture: np.ndarray) -> ReferenceDie:
    one = np.full(SHAPE, 0.1, np.float32)
    return ReferenceDie(z_um.astype(np.float32), one, picture.astype(np.float32), one, 9)


def test_a_wall_and_a_line_in_the_picture_are_uneven_and_the_rest_is_plain() -> None:
    z_um, picture = np.zeros(SHAPE), np.zeros(SHAPE)
    z_um[:, 40:] = 3.0
    picture[20, :20] = 1.0
    kinds = kinds_of(golden(z_um, picture))
    assert kinds[:, 38:42].all()
    assert kinds[18:23, :20].all()
    assert not kinds[:, 45:].any()
    assert not kinds[30:, :35].any()


def test_a_gentle_slope_is_plain() -> None:
    slope = np.tile(np.linspace(0, 4, SHAPE[1]), (SHAPE[0], 1))
    assert not kinds_of(golden(slope, np.zeros(SHAPE))).any()


def test_plain_ground_without_heights_is_a_kind_of_its_own_and_its_lines_are_lines() -> None:
    z_um, picture = np.zeros(SHAPE), np.zeros(SHAPE)
    z_um[:, 40:] = np.nan
    picture[20, 60:] = 1.0
    kinds = kinds_of(golden(z_um, picture))
    assert np.unique(kinds[30:, 45:]).tolist() == [1]
    assert kinds[20, 70] == 2
    assert not kinds[:, :35].any()


def test_nothing_known_at_all_is_even() -> None:
    unknown = np.full(SHAPE, np.nan)
    assert np.unique(kinds_of(golden(unknown, unknown))).tolist() == [1]


def test_a_square_is_uneven_where_one_of_its_pixels_is() -> None:
    kinds = np.zeros((9, 9), np.uint8)
    kinds[5, 2] = 1
    assert coarser(kinds, 4).tolist() == [[0, 0], [1, 0]]
    assert coarser(kinds, 1) is kinds
