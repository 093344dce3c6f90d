"""Products of block matrices: those of scipy, for blocks of both sizes and few or many vectors."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import bsr_array

from wafer_viewer.reconstruct.pose_graph.amg_solver import add_border, multiply, product

EMPTY_ROW = 3


def random_blocks(random: np.random.Generator, size: int, rows: int, cols: int) -> bsr_array:
    """Blocks at a quarter of the places, none in one row."""
    there = random.random((rows, cols)) < 0.25
    there[EMPTY_ROW] = False
    row, col = np.nonzero(there)
    starts = np.searchsorted(row, np.arange(rows + 1)).astype(np.int32)
    blocks = random.normal(size=(len(row), size, size))
    return bsr_array((blocks, col.astype(np.int32), starts), (rows * size, cols * size))


@pytest.mark.parametrize("size", [2, 3])
@pytest.mark.parametrize("n_vectors", [1, 2, 3, 8, 17])
def test_the_product_is_that_of_the_dense_matrix(size: int, n_vectors: int) -> None:
    random = np.random.default_rng(size)
    matrix = random_blocks(random, size, 20, 30)
    x = random.normal(size=(30 * size, n_vectors))
    expected = matrix.toarray() @ x
    np.testing.assert_allclose(product(matrix, x), expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(product(matrix, np.asfortranarray(x)), expected, rtol=0, atol=1e-12)
    out = np.full((20 * size + 2, n_vectors), 7.0)
    multiply(matrix, x, out)
    np.testing.assert_allclose(out[: 20 * size], expected, rtol=0, atol=1e-12)
    assert (out[20 * size :] == 7.0).all()


@pytest.mark.parametrize("n_shared", [0, 1, 2, 5])
@pytest.mark.parametrize("n_vectors", [1, 3, 4, 8])
def test_the_border_adds_to_fields_and_to_shared_unknowns(n_shared: int, n_vectors: int) -> None:
    random = np.random.default_rng(n_shared)
    border, x = random.normal(size=(12, n_shared)), random.normal(size=(12, n_vectors))
    shared, before = random.normal(size=(n_shared, n_vectors)), random.normal(size=(12 + n_shared, n_vectors))
    out = before.copy()
    add_border(border, x, shared, out)
    np.testing.assert_allclose(out[:12] - before[:12], border @ shared, rtol=0, atol=1e-12)
    np.testing.assert_allclose(out[12:] - before[12:], border.T @ x, rtol=0, atol=1e-12)
