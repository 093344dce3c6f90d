"""The solver of large systems of poses: what it starts from."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.sparse import bsr_array, kron

from wafer_viewer.model.errors import ComputeError
from wafer_viewer.reconstruct.pose_graph import amg_solver
from wafer_viewer.reconstruct.pose_graph.amg_solver import System, prepare

ROWS, COLS = 30, 40


@pytest.fixture
def system(monkeypatch: pytest.MonkeyPatch) -> System:
    """Shifts between neighbours on a lattice, and a weak prior; solved in at most two steps, never directly."""
    monkeypatch.setattr(amg_solver, "DIRECT_FIELDS", 60)
    hasty = dataclasses.replace(amg_solver.MULTIGRID, most_steps=2, most_unknowns=0)
    monkeypatch.setattr(amg_solver, "MULTIGRID", hasty)
    chain = [2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1) for n in (ROWS, COLS)]
    lattice = np.kron(chain[0], np.eye(COLS)) + np.kron(np.eye(ROWS), chain[1]) + 1e-3 * np.eye(ROWS * COLS)
    blocks = bsr_array(kron(lattice, np.eye(2)), blocksize=(2, 2))
    return System(blocks, np.zeros((2 * ROWS * COLS, 0)), np.zeros((0, 0)))


def test_a_start_that_is_too_large_is_as_good_as_one_of_the_right_size(system: System):
    y, x = (a.ravel().astype(float) for a in np.mgrid[:ROWS, :COLS])
    solution = np.random.default_rng(0).normal(size=(2 * ROWS * COLS, 3))
    right = system @ solution
    with pytest.raises(ComputeError, match="did not converge"):
        prepare(system, x, y).solve(right, 1e-6)
    for scale in (1.0, 50.0, -0.02):
        found = prepare(system, x, y).solve(right, 1e-6, start=scale * solution)
        np.testing.assert_allclose(found, solution, atol=1e-9)


def test_each_solution_is_as_exact_as_was_asked(system: System):
    y, x = (a.ravel().astype(float) for a in np.mgrid[:ROWS, :COLS])
    right = system @ np.random.default_rng(0).normal(size=(2 * ROWS * COLS, 2))
    prepare(system, x, y).solve(right, np.array([0.9, 0.9]))
    for strict in ([1e-6, 0.9], [0.9, 1e-6]):
        with pytest.raises(ComputeError, match="did not converge"):
            prepare(system, x, y).solve(right, np.array(strict))
