"""Motion of all fields together: in a band, and as a sparse matrix."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.reconstruct.pose_graph import candidate_graph as module
from wafer_viewer.reconstruct.pose_graph.candidate_graph import joint_step


@pytest.mark.parametrize(("rows", "cols"), [(1, 5), (3, 4), (7, 6)])
def test_the_step_solves_the_least_squares_of_overlaps_and_stage(rows, cols, monkeypatch):
    rng = np.random.default_rng(rows)
    n = rows * cols
    row, col = np.divmod(np.arange(n), cols)
    stage = np.column_stack((90.0 * col, 70.0 * row)) + rng.normal(0, 3, (n, 2))
    right, down = np.flatnonzero(col < cols - 1), np.flatnonzero(row < rows - 1)
    ends = np.concatenate((right, down)), np.concatenate((right + 1, down + cols))
    free = rng.random(n) < 0.8
    root = rng.normal(size=(len(ends[0]), 2, 2))
    information = root @ root.swapaxes(1, 2)
    precision = np.column_stack((information[:, 0, 0], information[:, 0, 1], information[:, 1, 1]))
    off, scatter = rng.normal(size=(len(ends[0]), 2)), np.array([3.0, 2.0])
    place = rng.normal(size=(n, 2))

    design = np.zeros((len(ends[0]), 2, n, 2))
    for e, (a, b) in enumerate(zip(*ends, strict=True)):
        design[e, :, b], design[e, :, a] = np.eye(2), -np.eye(2)
    design = design[:, :, free].reshape(len(ends[0]), 2, -1)
    normal = np.einsum("eim,eij,ejk->mk", design, information, design) + np.diag(np.tile(scatter**-2, free.sum()))
    gradient = np.einsum("eim,eij,ej->m", design, information, off) + (place / scatter**2)[free].ravel()
    expected = -np.linalg.solve(normal, gradient).reshape(-1, 2)

    for banded in (module.BANDED, 0):
        monkeypatch.setattr(module, "BANDED", banded)
        step = joint_step(ends, precision, off, place / scatter**2, scatter, free, stage)
        np.testing.assert_allclose(step, expected, atol=1e-10)
