"""What the microscope saw at one height."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.reconstruct.blending.stitched_mosaic import picture_at, stitched_picture

MakeStack = Callable[..., FieldStack]


def _stack(x_um: float, grey: int, rows: int = 20, cols: int = 40) -> FieldStack:
    field = Field(number=1, row=0, col=0, x_um=x_um, y_um=0.0, z_start_um=0.0)
    images = np.full((5, rows, cols), grey, np.uint8) + np.arange(5, dtype=np.uint8)[:, None, None]
    return FieldStack(field, images, np.arange(5) * 4.0, np.array([1, 1, 0, 1, 1], bool), 0.5)


def test_the_nearest_frame_that_is_there_is_shown() -> None:
    stack = _stack(0.0, 100)
    assert picture_at(stack, 3.0)[0, 0] == 101
    assert picture_at(stack, 8.5)[0, 0] == 103
    assert picture_at(stack, -50.0)[0, 0] == 100


def test_pictures_of_neighbours_are_blended_over_their_overlap() -> None:
    picture, lattice = stitched_picture([_stack(0.0, 100), _stack(15.0, 200)], 0.0)
    assert picture.shape == lattice.shape == (20, 70)
    np.testing.assert_array_equal(picture[5, :30], 100)
    np.testing.assert_array_equal(picture[5, 40:], 200)
    np.testing.assert_array_equal(picture[5, 30:40], np.rint(np.linspace(100, 200, 10)))


def test_a_window_of_the_stitched_picture_is_the_same_part_of_it() -> None:
    stacks = [_stack(0.0, 100), _stack(15.3, 180)]
    full, _ = stitched_picture(stacks, 12.0)
    part, _ = stitched_picture(stacks, 12.0, slice(3, 9), slice(25, 55))
    np.testing.assert_array_equal(part, full[3:9, 25:55])
