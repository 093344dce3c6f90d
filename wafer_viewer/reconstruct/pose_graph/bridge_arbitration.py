"""Arbitration between contradicting overlaps that no third overlap confirms.

Where a field, or a cluster of fields, is connected to the rest by contradicting overlaps, weights based on residuals
alone accept whichever was accepted first. Here clusters are placed sequentially, from the largest outwards: every edge
to a placed cluster proposes a position, and the proposal that most edges agree with and that has the smallest prior
residual wins. Clusters on which two edges agree are placed first, then those that only the stage confirms; otherwise
the cluster is placed at its stage position.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.field_poses import Numbers
from wafer_viewer.reconstruct.pose_graph.pose_graph import Flags, PoseGraph

Int32s = NDArray[np.int32]
Ints = NDArray[np.intp]


def groups(n: int, first: Int32s, second: Int32s) -> Int32s:
    """Return the component number [n] of each vertex, with components joined by edges (first, second)."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    joined = csr_array((np.ones(len(first), np.int8), (first, second)), (n, n))
    return np.asarray(connected_components(joined, directed=False)[1], np.int32)


def bridges(n: int, first: Int32s, second: Int32s) -> Flags:
    """Return a mask [e] of the edges that lie on no cycle.

    Every edge outside of a spanning tree gets a random number, and every edge of the tree the exclusive or of the
    numbers of the cycles through it; there are none where that is 0 (Pritchard and Thurimella 2011).
    """
    above, depth = _tree(n, first, second)
    below = np.where(above[first] == second, first, np.where(above[second] == first, second, -1))
    in_tree = np.zeros(len(first), np.bool_)
    child, edge = np.unique(below, return_index=True)
    in_tree[edge[child >= 0]] = True
    marks = np.zeros(n + 1, np.uint64)
    numbers = np.random.default_rng(7).integers(1, 2**63, len(first), np.uint64)
    for end in (first, second):
        np.bitwise_xor.at(marks, end[~in_tree], numbers[~in_tree])
    by_depth = np.argsort(depth, kind="stable")
    for level in np.split(by_depth, np.cumsum(np.bincount(depth)))[::-1]:
        np.bitwise_xor.at(marks, above[level], marks[level])
    return in_tree & (marks[below] == 0)


def _tree(n: int, first: Int32s, second: Int32s) -> tuple[Ints, Ints]:
    """Return the parent [n] of each vertex in a spanning tree, and its depth below a common root, vertex n."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import breadth_first_order

    roots = np.unique(groups(n, first, second), return_index=True)[1]
    a, b = np.append(first, np.full(len(roots), n)), np.append(second, roots)
    graph = csr_array((np.ones(len(a)), (a, b)), (n + 1, n + 1))
    order, above = (np.asarray(a, np.intp) for a in breadth_first_order(graph, n, directed=False))
    place = np.empty(n + 1, np.intp)
    place[order] = np.arange(n + 1)
    return above[:n], _depths(place[above[order[1:]]])[place[:n] - 1]


def _depths(parents: Ints) -> Ints:
    """Return the depth of each vertex except the root, in breadth-first order, where parents never decrease."""
    depth = np.zeros(len(parents), np.intp)
    begin, level = 0, 0
    end = int(np.searchsorted(parents, 0, "right"))
    while begin < len(parents):
        depth[begin:end] = level
        begin, end, level = end, int(np.searchsorted(parents, end, "right")), level + 1
    return depth


def count_up(lengths: Ints) -> Ints:
    """Return concatenated ranges 0, 1, ... of the given lengths."""
    return np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)


@dataclass(frozen=True, slots=True)
class ArbitrationParameters:
    """Limits of the arbitration between contradicting edges.

    Parameters
    ----------
    agrees : float
        Log likelihood ratio of an edge that agrees with another: about 3 % are wrong, uniformly within the search
        range.
    alone : float
        Log likelihood ratio of an edge that only the stage confirms: 3.7 standard deviations of the stage.
    slack : float
        Tolerance factor: neighbours of contested clusters are not yet at their final positions.
    most_ties : int
        Largest number of proposals for a cluster that are compared with each other.
    least_degrees : int
        Smallest number of degrees of freedom from which the stage error within cores is estimated.
    most_together : float
        Maximum effective number of averaged stage errors, which are not fully independent.
    """

    agrees: float = 15.0
    alone: float = 7.0
    slack: float = 2.0
    most_ties: int = 64
    least_degrees: int = 8
    most_together: float = 8.0


ARBITRATION = ArbitrationParameters()


def arbitrate_bridges(network: PoseGraph, values: Numbers, shared: Numbers, excess: float, believed: Flags) -> Numbers:
    """Return [e] 1 for contested overlaps to accept, 0 for those to reject, NaN for all others."""
    surprise = network.surprise(values, shared)
    lone = np.zeros(len(believed), np.bool_)
    lone[believed] = bridges(len(values), network.first[believed], network.second[believed])
    core = groups(len(values), network.first[believed & ~lone], network.second[believed & ~lone])
    precision = _stage_precision(surprise, core, network.prior_sigma)
    cluster = _clusters(network, lone, _suspect(network, surprise, core, precision, believed)[core], believed)
    ties = np.flatnonzero((cluster[network.first] != cluster[network.second]) & network.tells.any(axis=1))
    decided = np.full(len(network.first), np.nan)
    if len(ties):
        open_ties = _Ties(
            cluster[network.first[ties]],
            cluster[network.second[ties]],
            network.misfit(values, shared)[ties],
            network.information[ties] / (2 * ARBITRATION.slack * excess**2),
        )
        size = np.bincount(cluster).astype(float)
        size[cluster[~network.ties.free]] = np.inf
        decided[ties] = open_ties.agree(_placed(open_ties, size, _mean_of(surprise, cluster), precision))
    return decided


@dataclass(frozen=True, slots=True, eq=False)
class _Ties:
    """Edges between clusters, [t]: misfit, [t, d], measured minus solved.

    precision: inverse of twice its covariance, [t, d, d], 0 along directions that an edge does not tell, as lines.
    """

    first: Int32s
    second: Int32s
    misfit: Numbers
    precision: Numbers

    def agree(self, moved: Numbers) -> Flags:
        """Return which edges fit once clusters have moved by [clusters, d]."""
        return _weighed(self.misfit - moved[self.second] + moved[self.first], self.precision) < ARBITRATION.agrees

    def proposals(self, placed: Flags, moved: Numbers) -> _Proposals:
        """Return the proposals of edges between placed and unplaced clusters."""
        crossing = np.flatnonzero(placed[self.first] != placed[self.second])
        second_moves = placed[self.first[crossing]]
        mover = np.where(second_moves, self.second[crossing], self.first[crossing])
        anchor = np.where(second_moves, self.first[crossing], self.second[crossing])
        told = np.linalg.pinv(self.precision[crossing], hermitian=True) @ self.precision[crossing]
        by = np.where(second_moves, 1.0, -1.0)[:, None] * self.misfit[crossing]
        move = (told @ (moved[anchor] + by)[:, :, None])[:, :, 0]
        order = np.argsort(mover, kind="stable")
        return _Proposals(mover[order], move[order], self.precision[crossing][order])


@dataclass(frozen=True, slots=True, eq=False)
class _Proposals:
    """Proposed moves, sorted by cluster: cluster [p], displacement [p, d] and precision [p, d, d]."""

    cluster: Int32s
    move: Numbers
    precision: Numbers


@dataclass(frozen=True, slots=True, eq=False)
class _Choice:
    """Best proposal of each cluster, [c]: move, confirmation by another edge, and prior residual cost."""

    cluster: Int32s
    move: Numbers
    confirmed: Flags
    surprise: Numbers


def _stage_precision(surprise: Numbers, core: Int32s, sigma: Numbers) -> Numbers:
    """Return the inverse covariance [d, d] of the stage's error within cores, which errs alike in all directions.

    At most `sigma` is believed, which a misplaced core overestimates. Where overlaps show lines, the error shows across
    them only: the variance is the mean of those along the principal axes, weighted by themselves.
    """
    degrees = len(core) - len(np.unique(core))
    if degrees < ARBITRATION.least_degrees:
        return np.diag(sigma**-2.0)
    inside = surprise - _mean_of(surprise, core)[core]
    covariance = inside.T @ inside / degrees
    variance = np.sum(covariance**2) / max(float(np.trace(covariance)), 1e-30)
    return np.diag(1 / np.minimum(np.maximum(variance, 1e-30), sigma**2))


def _suspect(network: PoseGraph, surprise: Numbers, core: Int32s, precision: Numbers, believed: Flags) -> Flags:
    """Return a mask of cores with rejected edges or implausible stage residuals."""
    far = np.minimum(np.bincount(core), ARBITRATION.most_together) * _weighed(_mean_of(surprise, core), precision) / 2
    rejected = network.tells.any(axis=1) & ~believed
    suspect = far > ARBITRATION.alone
    suspect[core[network.first[rejected]]] = suspect[core[network.second[rejected]]] = True
    return suspect


def _clusters(network: PoseGraph, lone: Flags, suspect: Flags, believed: Flags) -> Int32s:
    """Return the cluster [n] of each field, connected by accepted overlaps; fixed fields form one cluster.

    Contested edges are cut: an edge is contested when it is the only one between its two sides (`lone`, [e]) and one of
    these is suspect, [n].
    """
    first, second = network.first, network.second
    remaining = believed & ~(lone & (suspect[first] | suspect[second]))
    fixed = np.flatnonzero(~network.ties.free).astype(np.int32)
    return groups(len(suspect), np.append(first[remaining], fixed[:-1]), np.append(second[remaining], fixed[1:]))


def _placed(ties: _Ties, size: Numbers, surprise: Numbers, precision: Numbers) -> Numbers:
    """Return the displacement [clusters, d] of each cluster, after placing all of them."""
    moved = np.zeros_like(surprise)
    placed = _largest(ties, size)
    together = np.minimum(size, ARBITRATION.most_together)
    while len((proposals := ties.proposals(placed, moved)).cluster):
        best = _best(proposals, surprise, precision, together)
        first = best.confirmed if np.any(best.confirmed) else _least_prior_residual(best, ties, len(size))
        by_stage = np.where(np.any(first), best.surprise < -1, True)
        chosen = first | by_stage
        moved[best.cluster[chosen]] = np.where(by_stage[:, None], -surprise[best.cluster], best.move)[chosen]
        placed[best.cluster[chosen]] = True
    return moved


def _largest(ties: _Ties, size: Numbers) -> Flags:
    """Return a mask of the largest cluster of each connected set."""
    component = groups(len(size), ties.first, ties.second)
    order = np.lexsort((-size, component))
    largest = np.zeros(len(size), np.bool_)
    largest[order[np.unique(component[order], return_index=True)[1]]] = True
    return largest


def _best(proposals: _Proposals, surprise: Numbers, precision: Numbers, together: Numbers) -> _Choice:
    """Return for each cluster the proposal with the least disagreement of its edges and prior residual."""
    cluster, start, count = np.unique(proposals.cluster, return_index=True, return_counts=True)
    voting = np.minimum(count, ARBITRATION.most_ties)
    some = np.repeat(start, voting) + count_up(voting)
    many = np.repeat(voting, voting)
    one, other = np.repeat(some, many), np.repeat(np.repeat(start, voting), many) + count_up(many)
    distance2 = _weighed(proposals.move[other] - proposals.move[one], proposals.precision[other])
    disagreement = np.bincount(one, np.minimum(distance2, ARBITRATION.agrees), len(proposals.cluster))
    agreeing = np.bincount(one, distance2 < ARBITRATION.agrees, len(proposals.cluster))
    far = together[proposals.cluster] * _weighed(surprise[proposals.cluster] + proposals.move, precision) / 2
    best = some[_least(disagreement[some] + far[some], voting)]
    return _Choice(cluster, proposals.move[best], agreeing[best] > 1, far[best])


def _least_prior_residual(best: _Choice, ties: _Ties, n: int) -> Flags:
    """Return which choices the stage confirms with a prior residual no larger than that of adjacent clusters."""
    of_cluster = np.full(n, np.inf)
    of_cluster[best.cluster] = best.surprise
    least = np.full(n, np.inf)
    np.minimum.at(least, ties.first, of_cluster[ties.second])
    np.minimum.at(least, ties.second, of_cluster[ties.first])
    return (best.surprise < ARBITRATION.alone) & (best.surprise <= least[best.cluster])


def _mean_of(values: Numbers, cluster: Int32s) -> Numbers:
    return np.column_stack([np.bincount(cluster, column) for column in values.T]) / np.bincount(cluster)[:, None]


def _weighed(values: Numbers, precision: Numbers) -> Numbers:
    """Return the squares [n] of vectors [n, d] in the metric of a precision, [d, d] or [n, d, d]."""
    return np.einsum("na,nab,nb->n", values, np.broadcast_to(precision, (len(values), *precision.shape[-2:])), values)


def _least(cost: Numbers, lengths: Ints) -> Ints:
    """Return the index of the least cost of each segment."""
    order = np.lexsort((cost, np.repeat(np.arange(len(lengths)), lengths)))
    return order[np.cumsum(lengths) - lengths]
