"""Linear model of the pose graph: overlap measurements and priors of the fields.

Field i has the unknowns p_i (shift along x and y; or height and tilts), all fields share the unknowns q. An overlap of
i and j measured y = B p_j - A p_i + K q, with an inverse covariance. The prior of p_i - E_i q is 0 with standard
deviations that all fields have in common, and so is that of q. Everything here is linear and works on all fields and
overlaps at once.

Offset, scale, turn and the backlash of rows and columns that are scanned in alternating directions are estimated from
the fields that overlaps place. A field beside them lies where the stage says, corrected by these errors, and by the
errors of its neighbours as far as those of neighbours are alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.field_poses import Numbers
from wafer_viewer.numerics.jit import lean_kernel
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA
from wafer_viewer.reconstruct.pose_graph.amg_solver import Sparse, System

# --------------------------------------------------------------------------------------------------------- stage errors


N_SHARED = 6
"""Number of shared errors of the stage: offset along x and y, scale, turn, backlash of rows and of columns."""
LEAST_TIED = 9
"""Number of fields placed by overlaps from which shared errors are estimated for those that are not."""
LEAST_NEIGHBOURS = 8
"""Number of pairs of neighbours from which the correlation of their errors is estimated."""
OFFSET_PX, TURN, BACKLASH_PX = 30.0, 0.005, 6.0
"""Standard deviations, before they are estimated, of an offset and a backlash (px), and of turn (rad) and scale."""
SIGNIFICANT = 2.5
"""Smallest shared error that is applied, in its standard uncertainties; few fields show large ones by chance."""
_ROUNDS, _FAR2 = 5, 18.0
"""Rounds of reweighting; square of the residual, in standard deviations, at which a field has half of its weight."""


def shared_effects(stage: Numbers) -> Numbers:
    """Return the effect of the shared errors on fields at [n, 2], [n, 2, 6]."""
    arm = stage - stage.mean(axis=0)
    by = np.zeros((len(stage), 2, N_SHARED))
    by[:, 0, 0] = by[:, 1, 1] = 1
    by[:, :, 2] = arm
    by[:, 0, 3], by[:, 1, 3] = arm[:, 1], -arm[:, 0]
    by[:, 0, 4], by[:, 1, 5] = parity(stage[:, 1]), parity(stage[:, 0])
    return by


def parity(along: Numbers) -> Numbers:
    """Return 1/2 and -1/2 for every second line of fields at about the same coordinate."""
    order = np.argsort(along, kind="stable")
    gaps = np.diff(along[order])
    line = np.concatenate(([0], np.cumsum(gaps > max(0.5 * gaps.max(initial=0), 1e-9))))
    parity = np.empty(len(along))
    parity[order] = line % 2 - 0.5
    return parity


@dataclass(frozen=True, slots=True, eq=False)
class StageErrors:
    """Errors of the stage: what fields have in common, and what is left, in the unit of the positions.

    shared: [6]; covariance: of these, [6, 6]; scatter: standard deviation along x and y of what is left; correlation:
    of what is left between neighbours, 0 to 1.
    """

    shared: Numbers
    covariance: Numbers
    scatter: Numbers
    correlation: float

    @classmethod
    def of(cls, off: Numbers, by: Numbers, pairs: NDArray[np.int32], pixel_um: float) -> StageErrors:
        """Estimate them from the errors [n, 2] of fields, their effects [n, 2, 6] and pairs of neighbours, [p, 2].

        Those that are not significant are 0.
        """
        sigma = np.array((OFFSET_PX * pixel_um, OFFSET_PX * pixel_um, TURN, TURN, *2 * (BACKLASH_PX * pixel_um,)))
        every = cls._fitted(off, by, sigma, pairs, pixel_um)
        significant = np.abs(every.shared) > SIGNIFICANT * np.sqrt(np.diag(every.covariance))
        return cls._fitted(off, by, np.where(significant, sigma, 1e-9 * sigma), pairs, pixel_um)

    @classmethod
    def _fitted(
        cls, off: Numbers, by: Numbers, sigma: Numbers, pairs: NDArray[np.int32], pixel_um: float
    ) -> StageErrors:
        rest, weight, scatter = off, np.ones(len(off)), np.maximum(off.std(axis=0), pixel_um)
        shared, covariance = np.zeros(N_SHARED), np.diag(sigma**2)
        for _ in range(_ROUNDS):
            precision = weight[:, None] / scatter**2
            covariance = np.linalg.inv(np.einsum("nam,na,nak->mk", by, precision, by) + np.diag(sigma**-2.0))
            shared = covariance @ np.einsum("nam,na,na->m", by, precision, off)
            rest = off - by @ shared
            freedom = max(1.0, len(off) - N_SHARED / 2)
            scatter = MAD_TO_SIGMA * np.median(np.abs(rest), axis=0) * np.sqrt(len(off) / freedom)
            scatter = np.maximum(scatter, 1e-3 * pixel_um)
            weight = 1 / (1 + np.sum((rest / scatter) ** 2, axis=1) / _FAR2)
        near = np.clip(rest, -3 * scatter, 3 * scatter)
        return cls(shared, np.asarray(covariance, np.float64), scatter, _correlation(near, pairs))


def _correlation(rest: Numbers, pairs: NDArray[np.int32]) -> float:
    """Return the correlation of errors [n, 2] between neighbours, less its uncertainty, at least 0."""
    if len(pairs) < LEAST_NEIGHBOURS:
        return 0.0
    found = np.mean(rest[pairs[:, 0]] * rest[pairs[:, 1]]) / max(float(np.mean(rest**2)), 1e-30)
    return float(np.clip(found - 1 / np.sqrt(2 * len(pairs)), 0.0, 0.98))


def between_neighbours(
    stage: Numbers, place: Numbers, u: Numbers, group: NDArray[np.int32], pairs: NDArray[np.int32], pixel_um: float
) -> tuple[Numbers, Numbers]:
    """Place the fields that overlaps do not tie to the largest group by its errors; return places and uncertainties.

    stage, place, u: positions by the stage, solved ones and their standard uncertainties, [n, 2]; group: fields tied
    by accepted overlaps have one number, [n]; pairs: of neighbours, [p, 2]. A group that is moved is moved as a whole.
    """
    leading = int(np.bincount(group).argmax()) if len(group) else 0
    tied = group == leading
    if tied.all() or tied.sum() < LEAST_TIED:
        return place, u
    by = shared_effects(stage)
    number = np.cumsum(tied) - 1
    inside = pairs[tied[pairs].all(axis=1)]
    errors = StageErrors.of((place - stage)[tied], by[tied], number[inside].astype(np.int32), pixel_um)
    expected, variance = _expected(stage, place, by, errors, tied, pairs)
    placed, known = place.copy(), u.copy()
    for one in np.unique(group[~tied]):
        those = np.flatnonzero(group == one)
        precision = 1 / variance[those]
        placed[those] += np.sum(precision * (expected - place)[those], axis=0) / precision.sum(axis=0)
        known[those] = np.sqrt(np.maximum(1 / precision.sum(axis=0), errors.scatter**2 / len(those)))
    by_shared = np.sqrt(np.einsum("nam,mk,nak->na", by, errors.covariance, by))
    return placed, np.where(tied[:, None], u, np.maximum(u, np.hypot(known, by_shared)))


def _expected(
    stage: Numbers, place: Numbers, by: Numbers, errors: StageErrors, tied: Flags, pairs: NDArray[np.int32]
) -> tuple[Numbers, Numbers]:
    """Return where fields are expected, and the variance, [n, 2] each, from the stage and their tied neighbours."""
    expected = stage + by @ errors.shared
    rest, rho = place - expected, errors.correlation
    total, count = np.zeros_like(rest), np.zeros(len(rest))
    for one, other in (pairs.T, pairs.T[::-1]):
        known = tied[other]
        np.add.at(total, one[known], rest[other[known]])
        np.add.at(count, one[known], 1)
    common = 1 + np.maximum(count - 1, 0) * rho**2
    expected = expected + (rho / common)[:, None] * total
    return expected, errors.scatter**2 * (1 - count * rho**2 / common)[:, None]


# ----------------------------------------------------------------------------------------------------------- pose graph


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
    """Return the normal equations of overlaps with weights [e] and priors, for free fields and shared unknowns.

    They are summed overlap by overlap: a product of all of them at once would need room for ten such tables.
    """
    (n, d, m), ties, precision = network.prior_shared.shape, network.ties, network.prior_sigma**-2.0
    expected = precision[:, None] * network.prior_shared
    diagonal, coupling = np.tile(np.diag(precision), (n, 1, 1)), np.negative(expected, order="C")
    right_of_it, room = np.empty((len(weight), d, d)), np.zeros((4, d, max(d, m)))
    among = np.ascontiguousarray(_gram(network.prior_shared, expected) + np.diag(network.shared_sigma**-2.0))
    _sum_overlaps(
        *(_read_only(network.first), _read_only(network.second), _read_only(weight), _read_only(network.information)),
        *(_read_only(network.at_first), _read_only(network.at_second), _read_only(network.at_shared)),
        *(diagonal, right_of_it, coupling, among, room),
    )
    return System(_matrix(ties, diagonal, right_of_it), flatten_blocks(coupling[ties.free]), among)


def _read_only(part: NDArray[Any]) -> NDArray[Any]:
    """Return contiguous memory that is not written: one type of array, so that one kernel is compiled for all."""
    view = np.ascontiguousarray(part).view()
    view.flags.writeable = False
    return view


@lean_kernel
def _sum_overlaps(
    first: Int32s,
    second: Int32s,
    weight: Numbers,
    information: Numbers,
    at_first: Numbers,
    at_second: Numbers,
    at_shared: Numbers,
    diagonal: Numbers,
    right_of_it: Numbers,
    coupling: Numbers,
    among: Numbers,
    room: Numbers,
) -> None:
    """Add each overlap to the blocks of its fields, their coupling to the shared unknowns, and these among them.

    right_of_it: [e, d, d], filled with its block between both fields; room: [4, d, max(d, m)].
    """
    d, m = information.shape[1], at_shared.shape[2]
    seen_first, seen_second, seen_shared = room[0], room[1], room[2]
    for e in range(weight.size):
        i, j = first[e], second[e]
        for a in range(d):
            for c in range(d):
                seen_first[a, c] = seen_second[a, c] = 0.0
                for b in range(d):
                    told = weight[e] * information[e, a, b]
                    seen_first[a, c] += told * at_first[e, b, c]
                    seen_second[a, c] += told * at_second[e, b, c]
            for c in range(m):
                seen_shared[a, c] = 0.0
                for b in range(d):
                    seen_shared[a, c] += weight[e] * information[e, a, b] * at_shared[e, b, c]
        for a in range(d):
            for c in range(d):
                between = 0.0
                for b in range(d):
                    diagonal[i, a, c] += at_first[e, b, a] * seen_first[b, c]
                    diagonal[j, a, c] += at_second[e, b, a] * seen_second[b, c]
                    between += at_first[e, b, a] * seen_second[b, c]
                right_of_it[e, a, c] = -between
            for c in range(m):
                for b in range(d):
                    coupling[i, a, c] -= at_first[e, b, a] * seen_shared[b, c]
                    coupling[j, a, c] += at_second[e, b, a] * seen_shared[b, c]
        for a in range(m):
            for c in range(m):
                for b in range(d):
                    among[a, c] += at_shared[e, b, a] * seen_shared[b, c]


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

    n, size = len(ties.row_ends) - 1, diagonal.shape[1]
    blocks = np.empty((len(ties.order), size, size))
    _put_in_order(ties.order, diagonal, right_of_it, blocks)
    return bsr_array((blocks, ties.cols, ties.row_ends), (n * size, n * size))


@lean_kernel
def _put_in_order(order: NDArray[np.intp], diagonal: Numbers, right_of_it: Numbers, blocks: Numbers) -> None:
    n, e = diagonal.shape[0], right_of_it.shape[0]
    for k in range(order.size):
        source = order[k]
        for a in range(blocks.shape[1]):
            for c in range(blocks.shape[1]):
                if source < n:
                    blocks[k, a, c] = diagonal[source, a, c]
                elif source < n + e:
                    blocks[k, a, c] = right_of_it[source - n, a, c]
                else:
                    blocks[k, a, c] = right_of_it[source - n - e, c, a]
