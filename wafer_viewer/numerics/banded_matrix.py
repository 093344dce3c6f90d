"""Symmetric positive definite matrices with a band: their Cholesky factor, solutions, the diagonal of their inverse.

A band is an array [n, width]: entry [j, k] is that of row j + k and column j of the matrix. Of the inverse, only those
inside the band are needed to work from its last row to its first: K. Takahashi, J. Fagan, M.-S. Chin, Proc. 8th PICA
Conf. (1973) 63. This takes as many steps as the factorisation, n width^2, where n solutions take n^2 width. Kernels of
our own, since the threads of LAPACK wait for each other on a busy machine: up to forty times the processor time.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from wafer_viewer.numerics.jit import Float64s, fast_kernel, lean_kernel


def factorise(band: Float64s) -> Float64s:
    """Return the band of the Cholesky factor L, of L L^T; `band` is overwritten with it.

    Raises numpy.linalg.LinAlgError where the matrix is not positive definite.
    """
    if not _factorise(band):
        raise np.linalg.LinAlgError("The matrix is not positive definite.")
    return band


def solve(factor: Float64s, right: Float64s) -> Float64s:
    """Return x of L L^T x = right, [n], for the band of L."""
    x = np.array(right, np.float64)
    _solve(factor, x)
    return x


def inverse_diagonal(matrix: Any, most_steps: float = np.inf) -> Float64s | None:
    """Return the diagonal [n] of the inverse of a scipy BSR matrix [n, n] with square blocks, whose order is free.

    None where it would take more steps, n width^2, even in the order of the smallest band. Raises
    numpy.linalg.LinAlgError where the matrix is not positive definite.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    n, size, n_blocks = matrix.shape[0], matrix.blocksize[0], len(matrix.indptr) - 1
    if n == 0:
        return np.zeros(0)
    links = csr_array((np.ones(len(matrix.indices), np.int8), matrix.indices, matrix.indptr), (n_blocks, n_blocks))
    place = np.empty(n_blocks, np.intp)
    place[reverse_cuthill_mckee(links, symmetric_mode=True)] = np.arange(n_blocks)
    rows, cols = np.repeat(place, np.diff(matrix.indptr)), place[matrix.indices]
    lower = rows >= cols
    below = (rows - cols)[lower]
    width = size * (int(below.max(initial=0)) + 1)
    if n * width**2 > most_steps:
        return None
    band, column, blocks = np.zeros((n, width)), cols[lower], matrix.data[lower]
    for i, j in np.ndindex(size, size):
        under = size * below + i - j
        inside = under >= 0
        band[size * column[inside] + j, under[inside]] = blocks[inside, i, j]
    inverse = np.zeros_like(band)
    _invert(factorise(band), inverse)
    return inverse[:, 0].reshape(n_blocks, size)[place].ravel()


@lean_kernel
def _factorise(band: Float64s) -> bool:
    n, width = band.shape
    for j in range(n):
        reach, column = min(width - 1, n - 1 - j), band[j]
        if not column[0] > 0:
            return False
        column[0] = np.sqrt(column[0])
        for k in range(1, reach + 1):
            column[k] /= column[0]
        for k in range(1, reach + 1):
            later, of_k = band[j + k], column[k]
            for i in range(reach - k + 1):
                later[i] -= of_k * column[k + i]
    return True


@lean_kernel
def _solve(factor: Float64s, x: Float64s) -> None:
    n, width = factor.shape
    for j in range(n):
        column = factor[j]
        x[j] /= column[0]
        for k in range(1, min(width, n - j)):
            x[j + k] -= column[k] * x[j]
    for j in range(n - 1, -1, -1):
        column, total = factor[j], x[j]
        for k in range(1, min(width, n - j)):
            total -= column[k] * x[j + k]
        x[j] = total / column[0]


@fast_kernel
def _invert(factor: Float64s, inverse: Float64s) -> None:
    """Fill the band of the inverse, from zeros."""
    n, width = factor.shape
    for j in range(n - 1, -1, -1):
        reach, column, found = min(width - 1, n - 1 - j), factor[j], inverse[j]
        for k in range(1, reach + 1):
            known, of_k = inverse[j + k], column[k]
            total = known[0] * of_k
            for i in range(1, reach - k + 1):
                found[k + i] += known[i] * of_k
                total += known[i] * column[k + i]
            found[k] += total
        total = 0.0
        for k in range(1, reach + 1):
            found[k] /= -column[0]
            total += found[k] * column[k]
        found[0] = (1 / column[0] - total) / column[0]
