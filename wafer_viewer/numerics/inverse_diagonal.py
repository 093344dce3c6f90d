"""Diagonal of the inverse of a sparse positive definite matrix, without the rest of the inverse.

Of the inverse, only entries inside the band of the matrix are needed to work from its last row to its first: K.
Takahashi, J. Fagan, M.-S. Chin, Proc. 8th PICA Conf. (1973) 63. For n unknowns and a bandwidth w this takes n w^2
steps, as many as the factorisation, where n solutions take n^2 w.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from wafer_viewer.numerics.jit import Float64s, fast_kernel


def inverse_diagonal(matrix: Any) -> Float64s:
    """Return the diagonal [n] of the inverse of a symmetric positive definite matrix, scipy sparse [n, n].

    Raises numpy.linalg.LinAlgError where it is not positive definite.
    """
    from scipy.linalg import cholesky_banded
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    n = matrix.shape[0]
    if n == 0:
        return np.zeros(0)
    order = reverse_cuthill_mckee(matrix.tocsr(), symmetric_mode=True)
    place = np.empty(n, np.intp)
    place[order] = np.arange(n)
    entries = matrix.tocoo()
    row, col = place[entries.row], place[entries.col]
    lower = row >= col
    row, col = row[lower], col[lower]
    band = np.zeros((int((row - col).max(initial=0)) + 1, n), order="F")  # [below the diagonal, column]
    band[row - col, col] = entries.data[lower]
    factor: Any = cholesky_banded(band, overwrite_ab=True, lower=True, check_finite=False)
    return _diagonal(np.ascontiguousarray(factor.T))[place]


@fast_kernel
def _diagonal(factor: Float64s) -> Float64s:
    """Return the diagonal of the inverse from its Cholesky factor, [column, below the diagonal]."""
    n, wide = factor.shape
    inverse = np.zeros((n, wide))
    for j in range(n - 1, -1, -1):
        reach = min(wide - 1, n - 1 - j)
        column, found = factor[j], inverse[j]
        for k in range(1, reach + 1):
            known, of_k = inverse[j + k], column[k]
            total = known[0] * of_k
            for i in range(1, reach - k + 1):
                found[k + i] += known[i] * of_k
                total += known[i] * column[k + i]
            found[k] += total
        pivot, total = column[0], 0.0
        for k in range(1, reach + 1):
            found[k] /= -pivot
            total += found[k] * column[k]
        found[0] = (1 / pivot - total) / pivot
    return inverse[:, 0].copy()
