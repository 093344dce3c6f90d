"""Linear model of the pose graph: overlap measurements and priors of the fields.

Field i has the unknowns p_i (shift along x and y; or height and tilts), all fields share the unknowns q. An overlap of
i and j measured y = B p_j - A p_i + K q, with an inverse covariance. The prior of p_i - E_i q is 0 with standard
deviations that all fields have in common, and so is that of q. Everything here is linear and works on all fields and
overlaps at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.field_poses import Numbers
from wafer_viewer.reconstruct.pose_graph.amg_solver import Sparse, System

Int32s = NDArray[np.int32]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class GraphEdges:
    """Edges of the pose graph and the block structure of its system, computed once per graph.

    from_first, from_second: [n, e] sparse, sum over the overlaps of each first and second field; free: mask of the
    fields to be solved for; order, cols, row_ends: blocks of the free fields, as they are generated (diagonal, then
    right, then left of it), in the order of the matrix.
    """

    from_first: Sparse
    from_second: Sparse
    free: Flags
    order: NDArray[np.intp]
    cols: Int32s
    row_ends: Int32s

    @classmethod
    def of(cls, first: Int32s, second: Int32s, free: Flags) -> GraphEdges:
        """Return the edges of overlaps between `first` and `second`, without the fields that are not free."""
        to, none = np.cumsum(free) - 1, -1
        a, b = (np.where(free[at], to[at], none) for at in (first, second))
        index = np.where(free, to, none)
        rows, cols = np.concatenate((index, a, b)), np.concatenate((index, b, a))
        order = np.lexsort((cols, rows))
        order = order[(rows[order] >= 0) & (cols[order] >= 0)]
        ends = np.cumsum(np.bincount(rows[order], minlength=int(free.sum())))
        return cls(
            _adder(first, len(free)),
            _adder(second, len(free)),
            free,
            order,
            cols[order].astype(np.int32),
            np.concatenate(([0], ends)).astype(np.int32),
        )


def _adder(field: Int32s, n: int) -> Sparse:
    from scipy.sparse import csr_array

    return csr_array((np.ones(len(field)), (field, np.arange(len(field)))), (n, len(field)))


@dataclass(frozen=True, slots=True, eq=False)
class PoseGraph:
    """A pose graph of n fields with d unknowns, e overlaps and m shared unknowns.

    The letters are those of the module's equations. x_um, y_um: positions of the fields, [n]; at_first (A), at_second
    (B), information: [e, d, d]; at_shared (K): [e, d, m]; measured (y): [e, d]; prior_shared (E): [n, d, m];
    prior_sigma: [d], shared_sigma: [m]. auto: groups of unknowns whose common prior_sigma is to be estimated, starting
    from prior_guess.
    """

    x_um: Numbers
    y_um: Numbers
    first: Int32s
    second: Int32s
    at_first: Numbers
    at_second: Numbers
    at_shared: Numbers
    measured: Numbers
    information: Numbers
    prior_sigma: Numbers
    prior_shared: Numbers
    shared_sigma: Numbers
    ties: GraphEdges
    prior_guess: Numbers
    auto: tuple[tuple[int, ...], ...]

    @property
    def size(self) -> int:
        """Number of unknowns of a field."""
        return len(self.prior_sigma)

    @property
    def tells(self) -> Flags:
        """Mask [e, d] of the unknowns that each overlap measures."""
        return np.einsum("eaa->ea", self.information) > 0

    def misfit(self, values: Numbers, shared: Numbers) -> Numbers:
        """Return the residuals [e, d] of overlaps: measured minus solved."""
        solved = _times(self.at_second, values[self.second]) - _times(self.at_first, values[self.first])
        return self.measured - solved - self.at_shared @ shared

    def surprise(self, values: Numbers, shared: Numbers) -> Numbers:
        """Return the prior residuals [n, d]: solved minus expected."""
        return values - self.prior_shared @ shared


def normal_equations(network: PoseGraph, weight: Numbers) -> System:
    """Return the normal equations of overlaps with weights [e] and priors, for free fields and shared unknowns."""
    ties, precision = network.ties, network.prior_sigma**-2.0
    weighted = weight[:, None, None] * network.information
    from_a, from_b = _turned(network.at_first) @ weighted, _turned(network.at_second) @ weighted
    diagonal = _add(ties.from_first, from_a @ network.at_first) + _add(ties.from_second, from_b @ network.at_second)
    expected = precision[:, None] * network.prior_shared
    coupling = _add(ties.from_second, from_b @ network.at_shared) - _add(ties.from_first, from_a @ network.at_shared)
    among = _gram(network.at_shared, weighted @ network.at_shared) + _gram(network.prior_shared, expected)
    return System(
        _matrix(ties, diagonal + np.diag(precision), -from_a @ network.at_second),
        flatten_blocks((coupling - expected)[ties.free]),
        among + np.diag(network.shared_sigma**-2.0),
    )


def gradient(network: PoseGraph, by_overlap: Numbers, by_prior: Numbers, by_shared: Numbers) -> Numbers:
    """Return the gradient of k cases with respect to the unknowns of the system, [free unknowns + m, k].

    Arguments are the weighted residuals of overlaps, [e, d, k], of the priors of fields, [n, d, k], and of the priors
    of shared unknowns, [m, k].
    """
    ties = network.ties
    fields = _add(ties.from_second, _turned(network.at_second) @ by_overlap)
    fields -= _add(ties.from_first, _turned(network.at_first) @ by_overlap)
    shared = _gram(network.at_shared, by_overlap) - _gram(network.prior_shared, by_prior)
    return np.vstack((flatten_blocks((fields + by_prior)[ties.free]), shared + by_shared))


def flatten_blocks(of_fields: Numbers) -> Numbers:
    """Reshape [n, d, k] to rows of unknowns, [n * d, k]."""
    return of_fields.reshape(of_fields.shape[0] * of_fields.shape[1], of_fields.shape[2])


def _times(matrices: Numbers, vectors: Numbers) -> Numbers:
    return np.einsum("eab,eb->ea", matrices, vectors)


def _turned(matrices: Numbers) -> Numbers:
    return np.swapaxes(matrices, 1, 2)


def _gram(a: Numbers, b: Numbers) -> Numbers:
    return flatten_blocks(a).T @ flatten_blocks(b)


def _add(adder: Sparse, of_overlaps: Numbers) -> Numbers:
    """Sum arrays [e, a, b] of overlaps for each field."""
    e, a, b = of_overlaps.shape
    return (adder @ of_overlaps.reshape(e, a * b)).reshape(adder.shape[0], a, b)


def _matrix(ties: GraphEdges, diagonal: Numbers, right_of_it: Numbers) -> Sparse:
    from scipy.sparse import bsr_array

    blocks = np.concatenate((diagonal, right_of_it, _turned(right_of_it)))[ties.order]
    n, size = len(ties.row_ends) - 1, diagonal.shape[1]
    return bsr_array((blocks, ties.cols, ties.row_ends), (n * size, n * size))
