"""Pieces of a height map that hang together: neighbours belong together when their heights are alike."""

from __future__ import annotations

import numpy as np

from wafer_viewer.numerics.arrays import Bools, Float32s, Int32s, Real, Whole
from wafer_viewer.numerics.jit import kernel


@kernel
def small_islands(z: Float32s, max_step: Real, min_pixels: Whole) -> Bools:
    """Which finite pixels are in a piece of fewer than `min_pixels`; bool [row, col].

    Two of four neighbours are joined when they differ by at most `max_step`; union-find with path halving.
    """
    n_rows, n_cols = z.shape
    root = np.arange(z.size).astype(np.int32)
    for r in range(n_rows):
        for c in range(n_cols):
            if c and abs(z[r, c] - z[r, c - 1]) <= max_step:
                _join(root, r * n_cols + c, r * n_cols + c - 1)
            if r and abs(z[r, c] - z[r - 1, c]) <= max_step:
                _join(root, r * n_cols + c, (r - 1) * n_cols + c)
    size = np.zeros(z.size, np.int32)
    for n in range(z.size):
        size[_find(root, n)] += 1
    small = np.empty(z.shape, np.bool_)
    for r in range(n_rows):
        for c in range(n_cols):
            small[r, c] = z[r, c] == z[r, c] and size[_find(root, r * n_cols + c)] < min_pixels
    return small


@kernel
def _find(root: Int32s, n: Whole) -> Whole:
    while root[n] != n:
        root[n] = root[root[n]]
        n = root[n]
    return n


@kernel
def _join(root: Int32s, a: Whole, b: Whole) -> None:
    a, b = _find(root, a), _find(root, b)
    if a != b:
        root[max(a, b)] = min(a, b)


@kernel
def narrow_parts(z: Float32s, max_step: Real, side: Whole) -> Bools:
    """Which finite pixels lie in no square of side x side finite pixels that are joined throughout; bool [row, col]."""
    covered = np.zeros(z.shape, np.bool_)
    above, here = np.zeros(z.shape[1], np.int32), np.zeros(z.shape[1], np.int32)
    for r in range(z.shape[0]):
        _squares(z, r, max_step, above, here)
        _cover(here, side, covered[r])
        above, here = here, above
    narrow = np.empty(z.shape, np.bool_)
    left = np.zeros(z.shape[1], np.int32)
    for r in range(z.shape[0] - 1, -1, -1):
        for c in range(z.shape[1]):
            left[c] = side if covered[r, c] else max(left[c] - 1, 0)
            narrow[r, c] = z[r, c] == z[r, c] and left[c] == 0
    return narrow


@kernel
def _squares(z: Float32s, r: Whole, max_step: Real, above: Int32s, here: Int32s) -> None:
    """The side of the largest joined square whose lower right pixel is each pixel of row r."""
    for c in range(here.size):
        v = z[r, c]
        here[c] = 1 if v == v else 0
        if r and c:
            up, left, across = abs(v - z[r - 1, c]), abs(v - z[r, c - 1]), abs(v - z[r - 1, c - 1])
            if up <= max_step and left <= max_step and across <= max_step:
                here[c] = 1 + min(above[c], here[c - 1], above[c - 1])


@kernel
def _cover(squares: Int32s, side: Whole, covered: Bools) -> None:
    """The columns that the large squares of a row reach to, from their lower right pixels leftward."""
    left = 0
    for c in range(squares.size - 1, -1, -1):
        left = side if squares[c] >= side else max(left - 1, 0)
        covered[c] = left > 0
