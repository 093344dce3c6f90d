"""Connected components of a height map: neighbours are connected if their heights differ little."""

from __future__ import annotations

import numpy as np

from wafer_viewer.numerics.array_types import Bools, Float32s, Int32s, Real, Whole
from wafer_viewer.numerics.jit import lean_kernel


def small_components(z: Float32s, max_step: Real, min_pixels: Whole) -> Bools:
    """Return a mask of finite pixels in components of fewer than `min_pixels`; bool [row, col].

    4-connectivity; two neighbours are connected if they differ by at most `max_step`.
    """
    root = np.arange(z.size, dtype=np.int32)
    _join_alike(z, np.float32(max_step), root)
    size = np.bincount(root, minlength=z.size)
    return np.isfinite(z) & (size[root] < min_pixels).reshape(z.shape)


def narrow_parts(z: Float32s, max_step: Real, side: Whole) -> Bools:
    """Return a mask of finite pixels in no fully connected square of side x side finite pixels; bool [row, col].

    The map is extended by its edge values, so a component cut by the border does not count as narrow for that.
    """
    wider = np.pad(z, side, mode="edge")
    covered = np.zeros(wider.shape, np.bool_)
    _cover(wider, np.float32(max_step), side, np.zeros((2, wider.shape[1]), np.int32), covered)
    return np.isfinite(z) & ~covered[side:-side, side:-side]


@lean_kernel
def _join_alike(z: Float32s, max_step: Real, root: Int32s) -> None:
    """Union-find with path halving; a root is the first pixel of its component, so the last sweep needs no search."""
    n_cols = z.shape[1]
    for r in range(z.shape[0]):
        for c in range(n_cols):
            for back in range(2):
                r2, c2 = r - back, c - 1 + back
                if r2 >= 0 and c2 >= 0 and abs(z[r, c] - z[r2, c2]) <= max_step:
                    a, b = r * n_cols + c, r2 * n_cols + c2
                    while root[a] != a:
                        root[a] = root[root[a]]
                        a = root[a]
                    while root[b] != b:
                        root[b] = root[root[b]]
                        b = root[b]
                    root[max(a, b)] = min(a, b)
    for n in range(root.size):
        root[n] = root[root[n]]


@lean_kernel
def _cover(z: Float32s, max_step: Real, side: Whole, scratch: Int32s, covered: Bools) -> None:
    """Mark the pixels covered by connected squares: from their lower right pixels leftward, then upward.

    squares: side of the largest connected square with its lower right pixel at each pixel of the row.
    """
    n_rows, n_cols = z.shape
    for r in range(n_rows):
        above, squares = scratch[(r + 1) % 2], scratch[r % 2]
        for c in range(n_cols):
            v = z[r, c]
            squares[c] = v == v
            if r and c:
                joined = abs(v - z[r - 1, c]) <= max_step and abs(v - z[r, c - 1]) <= max_step
                if joined and abs(v - z[r - 1, c - 1]) <= max_step:
                    squares[c] = 1 + min(above[c], squares[c - 1], above[c - 1])
        left = 0
        for c in range(n_cols - 1, -1, -1):
            left = side if squares[c] >= side else max(left - 1, 0)
            covered[r, c] = left > 0
    up = scratch[0]
    up[:] = 0
    for r in range(n_rows - 1, -1, -1):
        for c in range(n_cols):
            up[c] = side if covered[r, c] else max(up[c] - 1, 0)
            covered[r, c] = up[c] > 0
