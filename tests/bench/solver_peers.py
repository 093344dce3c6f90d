"""The solver of poses beside PyAMG, on the normal equations of seams between fields on a square lattice.

    python tests/bench/solver_peers.py [--quick]        (needs: pip install pyamg)

Per row: seconds to prepare, to solve one right-hand side to 1e-6 and 48 to 1e-2 in the energy norm (the samples that
give the uncertainties of poses; PyAMG solves them one by one, four are timed). PyAMG has the rigid motions as near null
space and a factorised coarsest level; shared unknowns, which it does not know, are left out.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import bsr_matrix, coo_array

from tests.bench.harness import read_options, took
from wafer_viewer.reconstruct.pose_graph.amg_solver import Sparse, System, prepare, rigid

PITCH_UM = 200.0, 150.0
SEAM_UM, SEAM_SLOPE, PRIOR_UM, PRIOR_SLOPE = 0.05, 0.00125, 1.0, 1e-3
"""Standard uncertainties of a seam and of the stage: height in um, slopes."""
RIGHT_SIDES, TIMED = 48, 4


def main() -> None:
    sides = (50,) if read_options(__doc__).quick else (100, 300)
    print(f"{'fields':>7} {'unknowns':>8} | {'ours: set-up':>12} {'one':>6} {'48':>6} | {'PyAMG: set-up':>13} one 48")
    for side in sides:
        for size in (2, 3):
            print(measured(side, size), flush=True)


def measured(side: int, size: int) -> str:
    """A row of the table; size 2: positions, 3: heights and tilts."""
    matrix, x_um, y_um = normal_matrix(side, size)
    n = matrix.shape[0]
    right = matrix @ np.random.default_rng(1).normal(size=(n, RIGHT_SIDES))

    prepared = took(lambda: prepare(System(matrix, np.zeros((n, 0)), np.zeros((0, 0))), x_um, y_um))
    solver = prepared.result
    solved = (took(lambda: solver.solve(right[:, :1], 1e-6)), took(lambda: solver.solve(right, 1e-2)))
    ours = [one.clock_s for one in (prepared, *solved)]
    theirs = of_pyamg(matrix, x_um, y_um, right)
    return (
        f"{side * side:7d} {n:8d} | {ours[0]:12.2f} {ours[1]:6.2f} {ours[2]:6.2f} | "
        f"{theirs[0]:13.2f} {theirs[1]:6.2f} {theirs[2]:6.2f}   in all {sum(theirs) / sum(ours):.1f} times ours"
    )


def of_pyamg(matrix: Sparse, x_um: np.ndarray, y_um: np.ndarray, right: np.ndarray) -> tuple[float, float, float]:
    import pyamg

    size = matrix.blocksize[0]
    near = rigid(x_um - x_um.mean(), y_um - y_um.mean(), size).reshape(-1, size)
    plain = bsr_matrix((matrix.data, matrix.indices, matrix.indptr), shape=matrix.shape)
    prepared = took(
        lambda: pyamg.smoothed_aggregation_solver(
            plain, B=near / np.abs(near).max(0), max_coarse=2000, coarse_solver="splu"
        )
    )
    solver = prepared.result
    one = took(lambda: solver.solve(right[:, 0], tol=1e-8, accel="cg"))
    some = took(lambda: [solver.solve(right[:, k], tol=1e-3, accel="cg") for k in range(TIMED)])
    return prepared.clock_s, one.clock_s, some.clock_s * RIGHT_SIDES / TIMED


def normal_matrix(side: int, size: int) -> tuple[Sparse, np.ndarray, np.ndarray]:
    """Normal equations of all seams and priors, and the places of the fields."""
    n = side * side
    row, col = np.divmod(np.arange(n), side)
    x_um, y_um = col * PITCH_UM[0], row * PITCH_UM[1]
    first = np.concatenate([np.flatnonzero(col < side - 1), np.flatnonzero(row < side - 1)])
    second = first + np.repeat([1, side], [np.count_nonzero(col < side - 1), np.count_nonzero(row < side - 1)])
    mid_x, mid_y = (x_um[first] + x_um[second]) / 2, (y_um[first] + y_um[second]) / 2
    one = rigid(mid_x - x_um[first], mid_y - y_um[first], size)
    other = -rigid(mid_x - x_um[second], mid_y - y_um[second], size)
    sigma = (SEAM_UM, SEAM_SLOPE, SEAM_SLOPE)[:size] if size == 3 else (SEAM_UM, SEAM_UM)
    weight = np.random.default_rng(0).uniform(0.5, 2, (len(first), 1)) / np.square(sigma)
    weighted = one.transpose(0, 2, 1) * weight[:, None], other.transpose(0, 2, 1) * weight[:, None]
    prior = np.zeros((n, size, size))
    prior[:, range(size), range(size)] = 1 / np.square((PRIOR_UM, PRIOR_SLOPE, PRIOR_SLOPE)[:size])
    every = np.arange(n)
    rows = np.concatenate([first, first, second, second, every])
    cols = np.concatenate([first, second, first, second, every])
    blocks = np.concatenate([weighted[0] @ one, weighted[0] @ other, weighted[1] @ one, weighted[1] @ other, prior])
    inner = np.arange(size)
    at_row = np.broadcast_to((rows[:, None] * size + inner)[:, :, None], blocks.shape).ravel()
    at_col = np.broadcast_to((cols[:, None] * size + inner)[:, None, :], blocks.shape).ravel()
    matrix = coo_array((blocks.ravel(), (at_row, at_col)), (n * size, n * size))
    return matrix.tocsr().tobsr((size, size)), x_um, y_um


if __name__ == "__main__":
    main()
