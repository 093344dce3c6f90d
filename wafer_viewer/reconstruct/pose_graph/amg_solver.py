"""Solver for the large sparse systems of poses: conjugate gradients with smoothed aggregation.

Neighbouring fields are aggregated into one coarse field, which moves them like a rigid plate; coarse fields are
aggregated again, until few enough are left to be factorised (Vanek, Mandel, Brezina 1996: Algebraic multigrid by
smoothed aggregation). A small system is factorised directly, so that the same code serves one field and a million. It
solves all right-hand sides at once and takes a half to a fifth of the time of PyAMG (tests/bench/solver_peers.py).

A block row of the result stays in the processor's cache, and each block is read once for all vectors. Blocks are 2 x 2
(shifts of fields) or 3 x 3 (their height and tilt).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.surface.field_poses import Numbers
from wafer_viewer.numerics.jit import fast_kernel

# ------------------------------------------------------------------------------------------------------- block products


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


# ----------------------------------------------------------------------------------------------------------- amg solver


DIRECT_FIELDS = 2000
"""Systems of up to this many fields are factorised directly."""


@dataclass(frozen=True, slots=True)
class MultigridParameters:
    """Sizes and limits of the solver of large systems.

    Parameters
    ----------
    cell_fields : float
        Side of the cell that becomes one coarse field, in typical distances between fields.
    jacobi : float
        Damping of smoothed aggregation, divided by the largest eigenvalue.
    power_steps : int
        Number of steps of the power iteration for the largest eigenvalue.
    most_steps : int
        Largest number of steps of conjugate gradients.
    most_unknowns : int
        Largest number of unknowns that are factorised directly where those steps do not suffice.
    """

    cell_fields: float = 3.0
    jacobi: float = 4 / 3
    power_steps: int = 12
    most_steps: int = 200
    most_unknowns: int = 500_000


MULTIGRID = MultigridParameters()
Apply = Callable[[Numbers], Numbers]


def rigid(dx: Numbers, dy: Numbers, size: int) -> Numbers:
    """Return the motion [n, size, size] of a rigid plate at (dx, dy) from its reference point.

    size 2: shift along x and y, equal everywhere; size 3: height, tilt along x and y.
    """
    moves = np.zeros((len(dx), size, size))
    moves[:, range(size), range(size)] = 1.0
    if size == 3:
        moves[:, 0, 1], moves[:, 0, 2] = dx, dy
    return moves


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """Symmetric positive definite system [blocks, border; border^T, corner] with m shared unknowns.

    blocks: sparse blocks of fields (scipy BSR); border: [n, m]; corner: [m, m]; vectors are [n + m, k], the shared
    unknowns last.
    """

    blocks: Sparse
    border: Numbers
    corner: Numbers

    def __matmul__(self, x: Numbers) -> Numbers:
        n = len(self.border)
        x = np.ascontiguousarray(x)
        out = np.empty_like(x)
        multiply(self.blocks, x, out)
        out[n:] = self.corner @ x[n:]
        add_border(self.border, x[:n], x[n:], out)
        return out

    def residual(self, right: Numbers, x: Numbers) -> Numbers:
        """Return ``right - self @ x``."""
        out = self @ x
        return np.subtract(right, out, out=out)


@dataclass(frozen=True, slots=True, eq=False)
class _Level:
    """One level of the hierarchy: damped inverse of the diagonal blocks, prolongation and restriction."""

    system: System
    jacobi: Sparse
    up: Sparse
    down: Sparse

    def smooth(self, x: Numbers, right: Numbers) -> None:
        """Apply one smoothing step to `x`, which reduces errors that differ between neighbours."""
        n = len(self.system.border)
        x[:n] += product(self.jacobi, self.system.residual(right, x)[:n])

    def lower(self, x: Numbers) -> Numbers:
        """Restrict a residual to the coarser level."""
        n = len(self.system.border)
        return np.vstack((product(self.down, x[:n]), x[n:]))

    def prolongate(self, x: Numbers) -> Numbers:
        """Prolongate a correction from the coarser level."""
        n = self.up.shape[1]
        return np.vstack((product(self.up, x[:n]), x[n:]))


@dataclass(frozen=True, slots=True, eq=False)
class Solver:
    """A prepared system that can be solved for any number of right-hand sides."""

    system: System
    levels: tuple[_Level, ...]
    coarsest: Apply

    def solve(
        self, right: Numbers, tolerance: Numbers | float, start: Numbers | None = None, enough: Numbers | float = 0.0
    ) -> Numbers:
        """Return x of system @ x = right, all [n + m, k], starting from the multiple of `start` that is nearest to it.

        tolerance: of the error in the energy norm, relative to x, [k]; enough: energy of the error, x^T system x, that
        is sufficiently small however small x is, [k]. Raises ComputeError when it does not converge.
        """
        if not self.levels:
            return self.coarsest(right)
        begun = np.zeros_like(right) if start is None else start
        x, found = _conjugate_gradients(self.system, self._cycle, right, (tolerance, enough), begun)
        return x if found else self._solve_direct(right)

    def _solve_direct(self, right: Numbers) -> Numbers:
        """Solve by direct factorisation: long rows of fields converge slowly but are cheap to factorise."""
        if len(right) > MULTIGRID.most_unknowns:
            raise ComputeError(
                f"The poses of the fields ({len(right)} unknowns) did not converge in {MULTIGRID.most_steps} steps: "
                "stitch fewer fields at a time."
            )
        return _factorised(self.system)(right)

    def _cycle(self, right: Numbers, at: int = 0) -> Numbers:
        """Apply one symmetric V cycle: smooth, correct on the coarser level, smooth."""
        if at == len(self.levels):
            return self.coarsest(right)
        level = self.levels[at]
        n = len(level.system.border)
        x = np.vstack((product(level.jacobi, right[:n]), np.zeros_like(right[n:])))
        x += level.prolongate(self._cycle(level.lower(level.system.residual(right, x)), at + 1))
        level.smooth(x, right)
        return x


def prepare(system: System, x_um: Numbers, y_um: Numbers) -> Solver:
    """Build the hierarchy for a system whose blocks belong to fields at (x_um, y_um)."""
    levels: list[_Level] = []
    coarse = system
    while len(x_um) > DIRECT_FIELDS:
        level, x_um, y_um = _coarsened(coarse, x_um, y_um)
        levels.append(level)
        coarse = System(level.down @ (coarse.blocks @ level.up), level.down @ coarse.border, coarse.corner)
    return Solver(system, tuple(levels), _factorised(coarse))


def _factorised(system: System) -> Apply:
    """Return a direct solver: eliminate the fields, solve the shared unknowns, substitute back."""
    from scipy.sparse.linalg import splu

    n = len(system.border)
    options = {"SymmetricMode": True}
    fields: Apply = splu(system.blocks.tocsc(), "MMD_AT_PLUS_A", 0.0, options=options).solve if n else np.copy
    response = fields(system.border)
    shared = np.linalg.inv(system.corner - system.border.T @ response)

    def solve(right: Numbers) -> Numbers:
        alone = fields(right[:n])
        q = shared @ (right[n:] - system.border.T @ alone)
        return np.vstack((alone - response @ q, q))

    return solve


def _coarsened(system: System, x_um: Numbers, y_um: Numbers) -> tuple[_Level, Numbers, Numbers]:
    """Return a level, and the positions of its coarse fields."""
    blocks = system.blocks
    cell, mid_x_um, mid_y_um = _cells(x_um, y_um)
    inverse = _inverse_diagonal(blocks)
    jacobi = inverse * (MULTIGRID.jacobi / _largest_eigenvalue(blocks, inverse))
    size = blocks.blocksize[0]
    lumped = _bsr(rigid(x_um - mid_x_um[cell], y_um - mid_y_um[cell], size), cell, len(mid_x_um))
    up = (lumped - jacobi @ (blocks @ lumped)).tobsr((size, size))
    return _Level(system, jacobi, up, up.T.tobsr((size, size))), mid_x_um, mid_y_um


def _cells(x_um: Numbers, y_um: Numbers) -> tuple[NDArray[np.intp], Numbers, Numbers]:
    """Return the cell of each field and the mean position per cell; at most half as many cells as fields."""
    side = MULTIGRID.cell_fields * _typical_distance(x_um, y_um)
    while True:
        cols, rows = (np.floor((a - a.min()) / side) for a in (x_um, y_um))
        _, cell, count = np.unique(rows * (cols.max() + 1) + cols, return_inverse=True, return_counts=True)
        if len(count) <= len(x_um) / 2:
            return cell, np.bincount(cell, x_um) / count, np.bincount(cell, y_um) / count
        side *= 2


def _typical_distance(x_um: Numbers, y_um: Numbers) -> float:
    """Return the median distance between a field and its nearest neighbour at another position."""
    from scipy.spatial import KDTree

    points = np.column_stack((x_um, y_um))
    some = points[:: 1 + len(points) // 2000]
    distance, _ = KDTree(points).query(some, k=5)
    nearest = np.where(distance > 0, distance, np.inf).min(axis=1)
    other = nearest[np.isfinite(nearest)]
    return float(np.median(other)) if len(other) else 1.0


def _inverse_diagonal(matrix: Sparse) -> Sparse:
    size = matrix.blocksize[0]
    rows = np.repeat(np.arange(len(matrix.indptr) - 1), np.diff(matrix.indptr))
    diagonal = np.zeros((len(matrix.indptr) - 1, size, size))
    on_it = rows == matrix.indices
    diagonal[rows[on_it]] = matrix.data[on_it]
    inverse = np.asarray(np.linalg.inv(diagonal), np.float64)
    return _bsr(inverse, np.arange(len(diagonal)), len(diagonal))


def _bsr(blocks: Numbers, cols: NDArray[Any], n_cols: int) -> Sparse:
    """Return a BSR matrix with one block per row."""
    from scipy.sparse import bsr_array

    n, size, _ = blocks.shape
    return bsr_array((blocks, cols.astype(np.int32), np.arange(n + 1, dtype=np.int32)), (n * size, n_cols * size))


def _largest_eigenvalue(matrix: Sparse, inverse: Sparse) -> float:
    """Estimate the largest eigenvalue of inverse @ matrix, slightly overestimated."""
    vector = np.random.default_rng(1).normal(size=matrix.shape[0])
    largest = 1.0
    for _ in range(MULTIGRID.power_steps):
        vector = inverse @ (matrix @ (vector / _length(vector)))
        largest = _length(vector)
    return 1.1 * largest


def _length(vector: Numbers) -> float:
    """Return the length without BLAS, whose threads wait for each other on a busy machine: a thousandfold time."""
    return float(np.sqrt(np.einsum("n,n->", vector, vector)))


def _conjugate_gradients(
    system: System, precondition: Apply, right: Numbers, goals: tuple[Numbers | float, Numbers | float], start: Numbers
) -> tuple[Numbers, bool]:
    """Solve all right-hand sides at once, each with its own step sizes; also return whether they converged."""
    pushed = system @ start
    nearest = _ratio(_dots(start, right), _dots(start, pushed))
    x, residual = nearest * start, right - nearest * pushed
    ahead = precondition(residual)
    direction, energy = ahead, _dots(residual, ahead)
    goal = np.maximum(np.square(goals[0]) * _dots(right, precondition(right)), goals[1])
    for _ in range(MULTIGRID.most_steps):
        if np.all(energy <= goal):
            return x, True
        pushed = system @ direction
        step = _ratio(energy, _dots(direction, pushed))
        x += step * direction
        pushed *= step
        residual -= pushed
        ahead = precondition(residual)
        energy, before = _dots(residual, ahead), energy
        direction *= _ratio(energy, before)
        direction += ahead
    return x, False


def _dots(a: Numbers, b: Numbers) -> Numbers:
    return np.einsum("nk,nk->k", a, b)


def _ratio(a: Numbers, b: Numbers) -> Numbers:
    return np.divide(a, b, out=np.zeros_like(a), where=b > 0)
