"""Feather widths of each field: its actual overlap with the neighbour on each side."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.grids.rectangle_overlap import Rectangles

Lengths = NDArray[np.float64]
"""[n, 4]: ramp lengths of n fields at their top, bottom, left and right border, in pixels; 0 without a neighbour."""
TOP, BOTTOM, LEFT, RIGHT = range(4)
DIAGONAL = 0.25
"""Neighbours whose distances along x and y differ by less than this fraction of a field are diagonal."""


def feather_widths(fields: Rectangles) -> Lengths:
    """Return the lengths of all ramps, from a field's border to the start of its nearest neighbour on that side.

    A neighbour belongs to the side on which it is furthest away, relative to the size of the field; a diagonal
    neighbour belongs to both.
    """
    first, second = fields.pairs()
    lengths = np.zeros((fields.top.size, 4))
    _lengthen(lengths, fields, first, second)
    _lengthen(lengths, fields, second, first)
    return lengths


def _lengthen(lengths: Lengths, fields: Rectangles, own: NDArray[np.int64], other: NDArray[np.int64]) -> None:
    """Extend the ramps of each field to its overlap with another one."""
    height, width = fields.bottom[own] - fields.top[own] + 1, fields.right[own] - fields.left[own] + 1
    down = (fields.top[other] + fields.bottom[other] - fields.top[own] - fields.bottom[own]) / 2 / height
    right = (fields.left[other] + fields.right[other] - fields.left[own] - fields.right[own]) / 2 / width
    upright, across = np.abs(down) >= np.abs(right) - DIAGONAL, np.abs(right) >= np.abs(down) - DIAGONAL
    for side, counts, overlap in (
        (TOP, upright & (down < 0), fields.bottom[other] - fields.top[own]),
        (BOTTOM, upright & (down > 0), fields.bottom[own] - fields.top[other]),
        (LEFT, across & (right < 0), fields.right[other] - fields.left[own]),
        (RIGHT, across & (right > 0), fields.right[own] - fields.left[other]),
    ):
        np.maximum.at(lengths[:, side], own[counts], overlap[counts])
