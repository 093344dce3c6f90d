"""Matrices with a band against dense ones: grids, chains, separate parts and full matrices."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_array, csr_array, eye_array

from wafer_viewer.numerics.banded_matrix import factorise, inverse_diagonal, solve


def linked(n: int, links: np.ndarray, size: int, seed: int) -> csr_array:
    """A positive definite matrix whose blocks are links between n places."""
    random = np.random.default_rng(seed)
    matrix = np.zeros((n * size, n * size))
    for a, b in links:
        part = random.normal(size=(size, 2 * size))
        both = np.r_[a * size : (a + 1) * size, b * size : (b + 1) * size]
        matrix[np.ix_(both, both)] += part.T @ part
    return csr_array(matrix + 0.01 * np.eye(n * size))


def grid(rows: int, cols: int) -> np.ndarray:
    at = np.arange(rows * cols).reshape(rows, cols)
    pairs = [
        np.column_stack((at[:, :-1].ravel(), at[:, 1:].ravel())),
        np.column_stack((at[:-1].ravel(), at[1:].ravel())),
    ]
    return np.vstack(pairs)


LINKS = {
    "grid": (60, grid(6, 10)),
    "chain": (40, grid(1, 40)),
    "two parts": (30, np.vstack((grid(3, 5), 15 + grid(5, 3)))),
    "star": (25, np.column_stack((np.zeros(24, int), np.arange(1, 25)))),
    "full": (12, np.argwhere(np.triu(np.ones((12, 12)), 1))),
    "alone": (1, np.zeros((0, 2), int)),
}


@pytest.mark.parametrize("size", [2, 3])
@pytest.mark.parametrize("name", LINKS)
def test_the_diagonal_of_the_inverse_is_that_of_the_dense_one(name: str, size: int) -> None:
    n, links = LINKS[name]
    places = np.random.default_rng(n).permutation(n)  # the order of fields tells nothing
    matrix = linked(n, places[links], size, n)
    expected = np.diag(np.linalg.inv(matrix.toarray()))
    np.testing.assert_allclose(inverse_diagonal(matrix.tobsr((size, size))), expected, rtol=1e-9)
    np.testing.assert_allclose(inverse_diagonal(matrix.tobsr((1, 1))), expected, rtol=1e-9)
    assert inverse_diagonal(matrix.tobsr((size, size)), most_steps=n * size - 1) is None


@pytest.mark.parametrize("size", [2, 3])
@pytest.mark.parametrize("name", LINKS)
def test_factor_and_solution_are_those_of_the_dense_matrix(name: str, size: int) -> None:
    n, links = LINKS[name]
    matrix, right = linked(n, links, size, n).toarray(), np.random.default_rng(1).normal(size=n * size)
    row, col = np.nonzero(np.tril(matrix))
    band = np.zeros((n * size, int((row - col).max()) + 1))
    band[col, row - col] = matrix[row, col]
    factor = factorise(band)
    dense = np.linalg.cholesky(matrix)
    expected = np.zeros_like(band)
    expected[col, row - col] = dense[row, col]
    filled = expected != 0
    np.testing.assert_allclose(factor[filled], expected[filled], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(solve(factor, right), np.linalg.solve(matrix, right), rtol=1e-9, atol=1e-12)


def test_nothing_has_no_diagonal() -> None:
    assert inverse_diagonal(csr_array((0, 0)).tobsr((2, 2))).shape == (0,)


def test_a_matrix_that_is_not_positive_definite_is_refused() -> None:
    matrix = eye_array(4) - coo_array(([2.0], ([1], [1])), (4, 4))
    with pytest.raises(np.linalg.LinAlgError):
        inverse_diagonal(matrix.tobsr((2, 2)))
