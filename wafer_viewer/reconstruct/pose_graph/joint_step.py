"""Motion of all fields together to where chosen candidates and the stage say.

Fields that are sorted by rows are tied to others near them in the list only: the matrix has a band, which is decomposed
in less time than a general sparse matrix takes to be put together.
"""

from __future__ import annotations

import numpy as np

from wafer_viewer.model.surface.field_poses import Numbers
from wafer_viewer.numerics.banded_matrix import factorise, solve
from wafer_viewer.numerics.jit import lean_kernel
from wafer_viewer.reconstruct.pose_graph.amg_solver import Sparse, System, prepare
from wafer_viewer.reconstruct.pose_graph.candidate_graph import Ints
from wafer_viewer.reconstruct.pose_graph.pose_graph import Flags

BANDED = 20_000_000
"""Largest product of the fields and the square of the band up to which motions are solved in a band."""
RELAXED_TOLERANCE = 1e-4
"""Relative error of the motions in very large grids, which are not solved directly."""


def joint_step(
    ends: tuple[Ints, Ints],
    precision: Numbers,
    off: Numbers,
    prior: Numbers,
    scatter: Numbers,
    free: Flags,
    stage: Numbers,
) -> Numbers:
    """Return the step [free, 2] to the least squares of overlaps and the stage.

    off: [e, 2], difference of the places of both ends less the measured one; prior: gradient of the stage's, [n, 2].
    """
    a, b = ends
    xx, xy, yy = precision.T
    push = np.column_stack((xx * off[:, 0] + xy * off[:, 1], xy * off[:, 0] + yy * off[:, 1]))
    gradient = prior.copy()
    np.add.at(gradient, b, push)
    np.add.at(gradient, a, -push)
    order = np.flatnonzero(free)
    order = order[np.lexsort(stage[order].T)]
    place = np.full(len(free), -1)
    place[order] = np.arange(len(order))
    both = (place[a] >= 0) & (place[b] >= 0)
    width = 2 * (int(np.abs(place[a] - place[b])[both].max(initial=0)) + 1)
    if len(order) * width**2 > BANDED:
        matrix = _sparse(ends, precision, scatter, free)
        system = System(matrix, np.zeros((matrix.shape[0], 0)), np.zeros((0, 0)))
        return -prepare(system, *stage[free].T).solve(gradient[free].reshape(-1, 1), RELAXED_TOLERANCE).reshape(-1, 2)
    band = np.zeros((2 * len(order), width))
    _fill_band(place[a], place[b], precision, 1 / scatter**2, band)
    solved = solve(factorise(band), gradient[order].ravel())
    return -solved.reshape(-1, 2)[np.argsort(order)]


def _sparse(ends: tuple[Ints, Ints], precision: Numbers, scatter: Numbers, free: Flags) -> Sparse:
    """Return the matrix of the least squares of free fields, in blocks."""
    from scipy.sparse import coo_array, csr_array

    n, (a, b), (xx, xy, yy) = len(free), ends, precision.T
    rows, cols, values = [np.arange(2 * n)], [np.arange(2 * n)], [np.tile(1 / scatter**2, n)]
    for first, second, sign in ((a, a, 1.0), (b, b, 1.0), (a, b, -1.0), (b, a, -1.0)):
        for i, j, value in ((0, 0, xx), (0, 1, xy), (1, 0, xy), (1, 1, yy)):
            rows.append(2 * first + i)
            cols.append(2 * second + j)
            values.append(sign * value)
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(cols)))
    both = np.repeat(free, 2)
    return csr_array(coo_array(entries, (2 * n, 2 * n)))[both][:, both].tobsr((2, 2))


@lean_kernel
def _fill_band(first: Ints, second: Ints, precision: Numbers, prior: Numbers, band: Numbers) -> None:
    """Fill the lower band of the same matrix, [col, row - col]; fields below 0 do not move."""
    for i in range(band.shape[0]):
        band[i, 0] = prior[i % 2]
    for e in range(first.size):
        a, b = max(first[e], second[e]), min(first[e], second[e])
        for i in range(2):
            for j in range(2):
                value = precision[e, i + j]
                for field in (a, b):
                    if field >= 0 and j <= i:
                        band[2 * field + j, i - j] += value
                if b >= 0:
                    band[2 * b + j, 2 * (a - b) + i - j] -= value
