"""Settles a network: robust least squares that rejects what the rest contradicts, and how sure the result is.

Weights fall off with the square of the misfit (Geman and McClure), first at the scale of the largest, then at half of
it and so on (graduated non-convexity: Black and Rangarajan 1996): no bad overlap decides where the rest settles.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.field_poses import Numbers
from wafer_viewer.reconstruct.pose_graph.amg_solver import Solver, prepare
from wafer_viewer.reconstruct.pose_graph.graph_components import groups
from wafer_viewer.reconstruct.pose_graph.pose_graph import PoseGraph, normal_equations, pull

REJECTED = 0.1
"""An overlap with less weight is not believed."""

_MISFITS = 3.0
"""Weights fall to a quarter at so many standard deviations."""

_MOST_EXCESS = 5.0
"""Uncertainties of overlaps are not taken for more wrong than this: it is the overlap that is wrong then."""

_MOST_ROUNDS = 30
_MOST_VERDICTS = 8
_STEADY, _RESTLESS_FRACTION = 0.05, 1e-3
_ON_THE_WAY = 3e-2
"""Relative error of a solution that is only to find weights."""

_ENOUGH_EACH, _ENOUGH = 1e-4, 1e-2
"""Energy of an error, in variances, that does not show in misfits (for each unknown), nor anywhere (for all)."""

_LEAST_REDUNDANCY = 0.1
_PROBES = 4
_FAR = 4.0
"""A field that is further off, in standard deviations, does not tell how far fields are off as a rule."""

_USUALLY = 4
"""The first guess of a prior counts like so many fields."""

_MEDIAN_CHI2 = (1.0, 0.455, 0.693, 0.789)
"""Median of chi squared over its degrees of freedom, by these."""


@dataclass(frozen=True, slots=True, eq=False)
class RobustSolution:
    """Values [n, d] of the fields, shared unknowns [m], and how they came about.

    weight: [e], 0 ... 1; excess: by how much misfits are larger than their uncertainties; scale: misfit in standard
    deviations where a weight has fallen to a quarter; solver: of the last least squares; echoes: [unknowns, probes],
    answers to `_probes`.
    """

    values: Numbers
    shared: Numbers
    weight: Numbers
    excess: float = 1.0
    scale: float = np.inf
    solver: Solver | None = None
    echoes: Numbers | None = None


Decide = Callable[[PoseGraph, RobustSolution], Numbers]


def settle(
    network: PoseGraph, values: Numbers, decide: Decide | None = None, like: RobustSolution | None = None
) -> tuple[PoseGraph, RobustSolution]:
    """The most probable values, begun at `values` [n, d], where fields that are not free stay.

    decide: says, [e], the weights of overlaps that misfits alone cannot tell, NaN of others; like: what nearly
    the same network came to, which is quicker than anew. The network comes back with the standard
    deviations of its priors as found.
    """
    telling = np.linalg.matrix_rank(network.information, hermitian=True) if len(network.first) else np.zeros(0, int)
    shared = np.zeros(len(network.shared_sigma))
    at = RobustSolution(values.copy(), shared, (telling > 0).astype(float))
    if like is not None:
        at = RobustSolution(like.values, shared, like.weight, like.excess, like.scale)
    decided = np.full(len(telling), np.nan)
    for _ in range(_MOST_VERDICTS if decide else 1):
        network, at = _rounds(network, at, telling, decided)
        decided, before = decide(network, at) if decide else decided, decided
        if np.array_equal(decided, before, equal_nan=True):
            break
    return network, _improved(network, at, on_the_way=False)


def _rounds(
    network: PoseGraph, at: RobustSolution, telling: NDArray[np.intp], decided: Numbers
) -> tuple[PoseGraph, RobustSolution]:
    """Solve, see what does not fit, and solve again until the weights rest, those that are not `decided` (NaN)."""
    for _ in range(_MOST_ROUNDS):
        before, sigma = at.weight, network.prior_sigma
        at = _improved(network, at, on_the_way=True)
        network = _with_priors_found(network, at)
        at = _weighed(network, at, telling, decided)
        restless = np.count_nonzero(np.abs(at.weight - before) > _STEADY)
        moved = np.abs(np.log(network.prior_sigma / sigma)).max()
        if at.scale <= _MISFITS * at.excess and restless <= _RESTLESS_FRACTION * len(before) and moved < _STEADY:
            break
    return network, at


def _improved(network: PoseGraph, at: RobustSolution, on_the_way: bool) -> RobustSolution:
    """One step of least squares with the weights as they are."""
    weight = at.weight / at.excess**2
    free = network.ties.free
    solver = prepare(normal_equations(network, weight), network.x_um[free], network.y_um[free])
    downhill = _gradient(network, at, weight)
    probes = _probes(network, solver) if on_the_way else downhill[:, :0]
    begun = np.hstack((np.zeros_like(downhill), 0 * probes if at.echoes is None else at.echoes[:, : probes.shape[1]]))
    enough = np.zeros(begun.shape[1])
    enough[0] = _ENOUGH_EACH * len(downhill) if on_the_way else _ENOUGH
    solved = solver.solve(np.hstack((downhill, probes)), _ON_THE_WAY if on_the_way else 0.0, begun, enough)
    step, shared_step = np.split(solved[:, 0], (network.size * int(free.sum()),))
    values = at.values.copy()
    values[free] += step.reshape(-1, network.size)
    return RobustSolution(values, at.shared + shared_step, at.weight, at.excess, at.scale, solver, solved[:, 1:])


def _gradient(network: PoseGraph, at: RobustSolution, weight: Numbers) -> Numbers:
    """Where misfits and priors pull, [unknowns, 1]."""
    by_overlap = weight[:, None, None] * (network.information @ network.misfit(at.values, at.shared)[:, :, None])
    by_prior = -network.surprise(at.values, at.shared) / network.prior_sigma**2
    by_shared = -at.shared / network.shared_sigma**2
    return pull(network, by_overlap, by_prior[:, :, None], by_shared[:, None])


def _probes(network: PoseGraph, solver: Solver) -> Numbers:
    """[unknowns, probes] random signs at all fields, for each group of unknowns whose prior is to be found.

    The product of a probe with its answer is, on average, the trace of the inverse (Hutchinson 1990): of large systems
    one says enough.
    """
    each = 1 if solver.levels else _PROBES
    n, d, m = len(network.x_um), network.size, len(network.shared_sigma)
    signs = np.zeros((n, d, each * len(network.auto)))
    random = np.random.default_rng(3)
    for k, group in enumerate(network.auto):
        signs[:, group, k * each : (k + 1) * each] = random.choice((-1.0, 1.0), (n, len(group), each))
    nothing = np.zeros((len(network.first), d, signs.shape[2]))
    return pull(network, nothing, signs, np.zeros((m, signs.shape[2])))


def _with_priors_found(network: PoseGraph, at: RobustSolution) -> PoseGraph:
    """Priors as wide as what was found and how unsure it is (expectation maximisation, Dempster 1977)."""
    if not network.auto or at.solver is None or at.echoes is None:
        return network
    surprise = np.clip(network.surprise(at.values, at.shared), *_FAR * np.outer((-1, 1), network.prior_sigma))
    traces = np.einsum("nk,nk->k", _probes(network, at.solver), at.echoes).reshape(len(network.auto), -1).mean(axis=1)
    sigma = network.prior_sigma.copy()
    for group, trace in zip(network.auto, traces, strict=True):
        total = np.sum(surprise[:, group] ** 2) + trace + _USUALLY * np.sum(network.prior_guess[list(group)] ** 2)
        sigma[list(group)] = np.sqrt(total / ((len(surprise) + _USUALLY) * len(group)))
    return dataclasses.replace(network, prior_sigma=sigma)


def _weighed(network: PoseGraph, at: RobustSolution, telling: NDArray[np.intp], decided: Numbers) -> RobustSolution:
    """New weights at the next smaller scale, and how far misfits go beyond what their uncertainties say."""
    counts = telling > 0
    if not np.any(counts):
        return dataclasses.replace(at, scale=0.0)
    misfit = network.misfit(at.values, at.shared)
    chi2 = np.einsum("ea,eab,eb->e", misfit, network.information, misfit) / np.maximum(telling, 1)
    excess = _excess(network, chi2, telling)
    scale = max(_MISFITS * excess, min(at.scale, float(np.sqrt(chi2[counts].max()))) / 2)
    weight = np.where(np.isnan(decided), counts / (1 + chi2 / scale**2) ** 2, decided)
    return dataclasses.replace(at, weight=weight, excess=excess, scale=scale)


def _excess(network: PoseGraph, chi2: Numbers, telling: NDArray[np.intp]) -> float:
    """From the median misfit and how many observations there are for each unknown, at least 1."""
    counts, free = telling > 0, network.ties.free
    group = groups(len(free), network.first[counts], network.second[counts])
    loose = len(np.setdiff1d(group[free], group[~free]))
    unknowns = network.size * (int(free.sum()) - loose)
    redundancy = 1 - unknowns / telling.sum()
    if redundancy < _LEAST_REDUNDANCY:
        return 1.0
    expected = _MEDIAN_CHI2[round(float(np.median(telling[counts])))] * redundancy
    return float(np.clip(np.sqrt(np.median(chi2[counts]) / expected), 1.0, _MOST_EXCESS))
