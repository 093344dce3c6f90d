"""Least-squares polynomials over grids with unmeasured points, fast for millions of points."""

from __future__ import annotations

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

Floats = NDArray[np.float64]
TOO_FEW = 1e-10
"""Smallest ratio of the extreme eigenvalues at which the normal equations are considered solvable."""


def polynomial(z: Floats, order: int) -> Floats | None:
    """Return the least-squares polynomial of total degree `order` through z [row, col], at every grid point.

    Unmeasured points (NaN) have no weight. None if the measured points do not determine it.
    """
    known = np.isfinite(z)
    down, across = (_basis(n, order) for n in z.shape)
    i, j = (np.array(power) for power in zip(*_powers(order), strict=True))
    # Sums over the lattice of products of Legendre polynomials, first along rows, then along columns.
    pairs_down, pairs_across = (_pairs(basis) for basis in (down, across))
    sums = (pairs_down.T @ (known.astype(np.float64) @ pairs_across)).reshape((order + 1,) * 4)
    normal = sums[i[:, None], i[None, :], j[:, None], j[None, :]]
    wanted = (down.T @ np.where(known, z, 0.0) @ across)[i, j]
    values, vectors = np.linalg.eigh(normal)
    if values[0] <= TOO_FEW * values[-1]:
        return None
    coefficients = np.zeros((order + 1, order + 1))
    coefficients[i, j] = vectors @ ((vectors.T @ wanted) / values)
    return down @ coefficients @ across.T


def _basis(n: int, order: int) -> Floats:
    """Return the Legendre polynomials up to an order at n points over -1 ... 1, [n, order + 1]."""
    return np.asarray(legvander(np.linspace(-1, 1, n) if n > 1 else np.zeros(1), order), np.float64)


def _powers(order: int) -> list[tuple[int, int]]:
    return [(i, total - i) for total in range(order + 1) for i in range(total + 1)]


def _pairs(basis: Floats) -> Floats:
    """Return the products of all pairs of columns of a basis [n, p], as [n, p * p]."""
    return (basis[:, :, None] * basis[:, None, :]).reshape(len(basis), -1)
