"""Decides about overlaps that no third one confirms.

Where a field, or a cluster of fields, is tied to the rest in ways that contradict each other, weights that look at
misfits alone believe whatever won first. Here clusters are placed one after the other, from the largest outwards: every
tie to what is placed proposes a place, and that one wins which most ties agree with and the stage finds least
surprising. What two ties agree on is placed first, then what only the stage confirms; where it does not, the cluster
goes to where the stage has it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.field_poses import Numbers
from wafer_viewer.reconstruct.pose_graph.graph_components import Whole32s, bridges, count_up, groups
from wafer_viewer.reconstruct.pose_graph.pose_graph import Flags, PoseGraph

Wholes = NDArray[np.intp]

_AGREES = 15.0
"""Log likelihood ratio of a tie that agrees with another: some 3 % are wrong, and lie anywhere within the search."""

_ALONE = 7.0
"""The same of a tie that only the stage confirms: so much surprise is 3.7 standard deviations of the stage."""

_SLACK = 2.0
"""Neighbours of what is contested are not yet quite where they belong."""

_MOST_TIES = 64
_LEAST_DEGREES = 8
_MOST_TOGETHER = 8.0
"""Errors of a stage are not as independent as averaging more of them would have it."""


def verdicts(network: PoseGraph, values: Numbers, shared: Numbers, excess: float, believed: Flags) -> Numbers:
    """[e] 1 for contested overlaps that are to be believed, 0 for those that are not, NaN for all others."""
    surprise = network.surprise(values, shared)
    lone = np.zeros(len(believed), np.bool_)
    lone[believed] = bridges(len(values), network.first[believed], network.second[believed])
    core = groups(len(values), network.first[believed & ~lone], network.second[believed & ~lone])
    sigma = _scatter(surprise, core, network.prior_sigma)
    cluster = _clusters(network, lone, _suspect(network, surprise, core, sigma, believed)[core], believed)
    ties = np.flatnonzero((cluster[network.first] != cluster[network.second]) & network.tells.any(axis=1))
    decided = np.full(len(network.first), np.nan)
    if len(ties):
        of = _Ties(
            cluster[network.first[ties]],
            cluster[network.second[ties]],
            network.misfit(values, shared)[ties],
            np.einsum("eaa->ea", network.information[ties]) / (2 * _SLACK * excess**2),
        )
        size = np.bincount(cluster).astype(float)
        size[cluster[~network.ties.free]] = np.inf
        decided[ties] = of.agree(_placed(of, size, _mean_of(surprise, cluster), sigma))
    return decided


@dataclass(frozen=True, slots=True, eq=False)
class _Ties:
    """Between clusters, [t]: misfit, [t, d], measured minus solved; precision: inverse of twice its variance."""

    first: Whole32s
    second: Whole32s
    misfit: Numbers
    precision: Numbers

    def agree(self, moved: Numbers) -> Flags:
        """Which ties fit once clusters have moved by [clusters, d]."""
        left = self.misfit - moved[self.second] + moved[self.first]
        return np.sum(self.precision * left**2, axis=1) < _AGREES

    def proposals(self, placed: Flags, moved: Numbers) -> _Proposals:
        """Ties of clusters that are not placed to such that are."""
        at = np.flatnonzero(placed[self.first] != placed[self.second])
        second_moves = placed[self.first[at]]
        mover = np.where(second_moves, self.second[at], self.first[at])
        anchor = np.where(second_moves, self.first[at], self.second[at])
        move = moved[anchor] + np.where(second_moves, 1.0, -1.0)[:, None] * self.misfit[at]
        order = np.argsort(mover, kind="stable")
        return _Proposals(mover[order], move[order], self.precision[at][order])


@dataclass(frozen=True, slots=True, eq=False)
class _Proposals:
    """[p] which cluster is to move, by how much [p, d], how precisely this is known; in the order of clusters."""

    cluster: Whole32s
    move: Numbers
    precision: Numbers


@dataclass(frozen=True, slots=True, eq=False)
class _Choice:
    """The best proposal of each cluster, [c]: its move, whether another tie agrees, how the stage is surprised."""

    cluster: Whole32s
    move: Numbers
    confirmed: Flags
    surprise: Numbers


def _scatter(surprise: Numbers, core: Whole32s, sigma: Numbers) -> Numbers:
    """[d] what the stage errs by inside of cores: no more than `sigma`, which a misplaced core makes too large."""
    degrees = len(core) - len(np.unique(core))
    if degrees < _LEAST_DEGREES:
        return sigma
    inside = surprise - _mean_of(surprise, core)[core]
    return np.minimum(sigma, np.sqrt(np.sum(inside**2, axis=0) / degrees))


def _suspect(network: PoseGraph, surprise: Numbers, core: Whole32s, sigma: Numbers, believed: Flags) -> Flags:
    """Which cores have ties that were rejected, or lie where the stage says that they can hardly be."""
    far = np.minimum(np.bincount(core), _MOST_TOGETHER) * _chi2(_mean_of(surprise, core), sigma) / 2
    rejected = network.tells.any(axis=1) & ~believed
    suspect = far > _ALONE
    suspect[core[network.first[rejected]]] = suspect[core[network.second[rejected]]] = True
    return suspect


def _clusters(network: PoseGraph, lone: Flags, suspect: Flags, believed: Flags) -> Whole32s:
    """[n] fields that believed overlaps tie together, with contested ties cut; what is fixed is one cluster.

    A tie is contested when it is the only one between its two sides, [e], and one of these is suspect, [n].
    """
    first, second = network.first, network.second
    kept = believed & ~(lone & (suspect[first] | suspect[second]))
    fixed = np.flatnonzero(~network.ties.free).astype(np.int32)
    return groups(len(suspect), np.append(first[kept], fixed[:-1]), np.append(second[kept], fixed[1:]))


def _placed(ties: _Ties, size: Numbers, surprise: Numbers, sigma: Numbers) -> Numbers:
    """[clusters, d] by how much each has to move, once they are all placed."""
    moved = np.zeros_like(surprise)
    placed = _largest(ties, size)
    together = np.minimum(size, _MOST_TOGETHER)
    while len((proposals := ties.proposals(placed, moved)).cluster):
        best = _best(proposals, surprise, sigma, together)
        first = best.confirmed if np.any(best.confirmed) else _least_surprised(best, ties, len(size))
        by_stage = np.where(np.any(first), best.surprise < -1, True)
        chosen = first | by_stage
        moved[best.cluster[chosen]] = np.where(by_stage[:, None], -surprise[best.cluster], best.move)[chosen]
        placed[best.cluster[chosen]] = True
    return moved


def _largest(ties: _Ties, size: Numbers) -> Flags:
    """The largest cluster of all that hang together."""
    whole = groups(len(size), ties.first, ties.second)
    order = np.lexsort((-size, whole))
    largest = np.zeros(len(size), np.bool_)
    largest[order[np.unique(whole[order], return_index=True)[1]]] = True
    return largest


def _best(of: _Proposals, surprise: Numbers, sigma: Numbers, together: Numbers) -> _Choice:
    """For each cluster the proposal with the least disagreement of its ties and surprise of the stage."""
    cluster, start, count = np.unique(of.cluster, return_index=True, return_counts=True)
    voting = np.minimum(count, _MOST_TIES)
    some = np.repeat(start, voting) + count_up(voting)
    many = np.repeat(voting, voting)
    one, other = np.repeat(some, many), np.repeat(np.repeat(start, voting), many) + count_up(many)
    apart = np.sum(of.precision[other] * (of.move[other] - of.move[one]) ** 2, axis=1)
    disagreement = np.bincount(one, np.minimum(apart, _AGREES), len(of.cluster))
    agreeing = np.bincount(one, apart < _AGREES, len(of.cluster))
    far = together[of.cluster] * _chi2(surprise[of.cluster] + of.move * (of.precision > 0), sigma) / 2
    best = some[_least(disagreement[some] + far[some], voting)]
    return _Choice(cluster, of.move[best], agreeing[best] > 1, far[best])


def _least_surprised(best: _Choice, ties: _Ties, n: int) -> Flags:
    """Which choices the stage confirms, and finds less surprising than those of clusters that they are tied to."""
    of_cluster = np.full(n, np.inf)
    of_cluster[best.cluster] = best.surprise
    beside = np.full(n, np.inf)
    np.minimum.at(beside, ties.first, of_cluster[ties.second])
    np.minimum.at(beside, ties.second, of_cluster[ties.first])
    return (best.surprise < _ALONE) & (best.surprise <= beside[best.cluster])


def _mean_of(values: Numbers, cluster: Whole32s) -> Numbers:
    return np.column_stack([np.bincount(cluster, column) for column in values.T]) / np.bincount(cluster)[:, None]


def _chi2(values: Numbers, sigma: Numbers) -> Numbers:
    return np.sum((values / sigma) ** 2, axis=1)


def _least(cost: Numbers, lengths: Wholes) -> Wholes:
    """Where the least cost of each stretch is."""
    order = np.lexsort((cost, np.repeat(np.arange(len(lengths)), lengths)))
    return order[np.cumsum(lengths) - lengths]
