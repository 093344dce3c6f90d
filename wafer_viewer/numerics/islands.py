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
