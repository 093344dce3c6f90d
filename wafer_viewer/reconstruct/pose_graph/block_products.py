"""Products of block matrices with many vectors at once, several times as fast as those of scipy.

A block row of the result stays in the processor's cache, and each block is read once for all vectors. Blocks are 2 x 2
(shifts of fields) or 3 x 3 (their height and tilt).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.field_poses import Numbers
from wafer_viewer.numerics.jit import fast_kernel

Sparse = Any
Indices = NDArray[np.int32]
_FEW_VECTORS = 4
"""Number of vectors from which one vector after the other is slower."""


def multiply(matrix: Sparse, x: Numbers, out: Numbers) -> None:
    """Write ``matrix @ x`` to the first rows of `out`; matrix: scipy BSR with square blocks, x, out: [n, k]."""
    parts = (matrix.indptr, matrix.indices, matrix.data, x, out)
    (_product_of_pairs if matrix.blocksize[0] == 2 else _product_of_triples)(*parts)


def product(matrix: Sparse, x: Numbers) -> Numbers:
    """Return ``matrix @ x``, [n, k]."""
    out = np.empty((matrix.shape[0], x.shape[1]))
    multiply(matrix, np.ascontiguousarray(x), out)
    return out


@fast_kernel
def _product_of_pairs(indptr: Indices, indices: Indices, blocks: Numbers, x: Numbers, out: Numbers) -> None:
    for row in range(indptr.size - 1):
        out_0, out_1 = out[2 * row], out[2 * row + 1]
        for c in range(out_0.size):
            out_0[c] = out_1[c] = 0.0
        for at in range(indptr[row], indptr[row + 1]):
            first, block = 2 * indices[at], blocks[at]
            x_0, x_1 = x[first], x[first + 1]
            b_00, b_01, b_10, b_11 = block[0, 0], block[0, 1], block[1, 0], block[1, 1]
            for c in range(out_0.size):
                v_0, v_1 = x_0[c], x_1[c]
                out_0[c] += b_00 * v_0 + b_01 * v_1
                out_1[c] += b_10 * v_0 + b_11 * v_1


@fast_kernel
def _product_of_triples(indptr: Indices, indices: Indices, blocks: Numbers, x: Numbers, out: Numbers) -> None:
    for row in range(indptr.size - 1):
        out_0, out_1, out_2 = out[3 * row], out[3 * row + 1], out[3 * row + 2]
        for c in range(out_0.size):
            out_0[c] = out_1[c] = out_2[c] = 0.0
        for at in range(indptr[row], indptr[row + 1]):
            first, block = 3 * indices[at], blocks[at]
            x_0, x_1, x_2 = x[first], x[first + 1], x[first + 2]
            b_00, b_01, b_02 = block[0, 0], block[0, 1], block[0, 2]
            b_10, b_11, b_12 = block[1, 0], block[1, 1], block[1, 2]
            b_20, b_21, b_22 = block[2, 0], block[2, 1], block[2, 2]
            for c in range(out_0.size):
                v_0, v_1, v_2 = x_0[c], x_1[c], x_2[c]
                out_0[c] += b_00 * v_0 + b_01 * v_1 + b_02 * v_2
                out_1[c] += b_10 * v_0 + b_11 * v_1 + b_12 * v_2
                out_2[c] += b_20 * v_0 + b_21 * v_1 + b_22 * v_2


def add_border(border: Numbers, x: Numbers, shared: Numbers, out: Numbers) -> None:
    """Add the products of the border [n, m] of a system to `out` [n + m, k]; x: [n, k], shared: [m, k].

    BLAS threads that wait for each other would take half of the time of a solution.
    """
    if x.shape[1] < _FEW_VECTORS:
        sums = np.zeros((x.shape[1], border.shape[1]))
        _add_border_to_few(border, x, np.ascontiguousarray(shared.T), out, sums)
        out[len(border) :] += sums.T
    else:
        _add_border_to_many(border, x, shared, out)


@fast_kernel
def _add_border_to_few(border: Numbers, x: Numbers, shared: Numbers, out: Numbers, sums: Numbers) -> None:
    """Add the products to the fields' rows of `out`, and write those of the shared unknowns to `sums`; both [k, m]."""
    for i in range(border.shape[0]):
        weights = border[i]
        for c in range(shared.shape[0]):
            shared_c, sums_c, x_ic, total = shared[c], sums[c], x[i, c], 0.0
            for j in range(weights.size):
                total += weights[j] * shared_c[j]
                sums_c[j] += weights[j] * x_ic
            out[i, c] += total


@fast_kernel
def _add_border_to_many(border: Numbers, x: Numbers, shared: Numbers, out: Numbers) -> None:
    n, m = border.shape
    for i in range(n):
        out_i, x_i = out[i], x[i]
        for j in range(m):
            weight, shared_j, out_j = border[i, j], shared[j], out[n + j]
            for c in range(x_i.size):
                out_i[c] += weight * shared_j[c]
            for c in range(x_i.size):
                out_j[c] += weight * x_i[c]
