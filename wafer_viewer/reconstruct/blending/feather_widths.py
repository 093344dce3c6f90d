"""How far each field fades out towards its borders: over its real overlap with the neighbour on that side."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.grids.rectangle_overlap import Rectangles

Lengths = NDArray[np.float64]
"""[n, 4]: the ramps of n fields at their top, bottom, left and right border, in pixels; 0 without a neighbour."""
TOP, BOTTOM, LEFT, RIGHT = range(4)
DIAGONAL = 0.25
"""Neighbours whose distances along x and y differ by less than this share of a field lie diagonally."""


def ramps(fields: Rectangles) -> Lengths:
    """The lengths of all ramps: from a field's own border to where its nearest neighbour on that side begins.

    A neighbour is on the side on which it is furthest away, measured by the size of the field; one that lies
    diagonally is on both.
    """
    first, second = fields.pairs()
    lengths = np.zeros((fields.top.size, 4))
    _lengthen(lengths, fields, first, second)
    _lengthen(lengths, fields, second, first)
    return lengths


def _lengthen(lengths: Lengths, fields: Rectangles, own: NDArray[np.int64], other: NDArray[np.int64]) -> None:
    """Let each field reach as far as its overlap with another one asks for."""
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
