"""Robust least squares on a pose graph, with rejection of contradicting overlaps and standard uncertainties.

Weights decrease with the square of the residual (Geman and McClure), first at the scale of the largest residual, then
at half of it and so on (graduated non-convexity: Black and Rangarajan 1996), so that no bad overlap determines the
solution.

Standard uncertainties come from the inverse of the normal equations. Up to some 10 000 fields its diagonal is exact.
Beyond, `_SAMPLES` sets of errors are drawn from the uncertainties of overlaps and priors, each is solved like a
measurement, and the spread of the solutions is the uncertainty (Papandreou and Yuille 2010: Gaussian sampling by local
perturbations): unbiased, with a relative error of 1 / sqrt(2 * samples) = 10 %.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.field_poses import Numbers
from wafer_viewer.numerics.banded_matrix import inverse_diagonal
from wafer_viewer.reconstruct.pose_graph.amg_solver import DIRECT_FIELDS, Solver, prepare
from wafer_viewer.reconstruct.pose_graph.bridge_arbitration import groups
from wafer_viewer.reconstruct.pose_graph.pose_graph import PoseGraph, gradient, normal_equations

REJECTED = 0.1
"""An overlap with less weight is rejected."""


@dataclass(frozen=True, slots=True)
class RobustSolverParameters:
    """Limits of the robust solution and of its iterations.

    Parameters
    ----------
    misfits : float
        Residual, in standard deviations, at which a weight has fallen to a quarter.
    most_excess : float
        Maximum inflation of the overlap uncertainties; beyond it the overlap itself is wrong.
    least_redundancy : float
        Smallest redundancy of the overlaps from which their inflation is estimated.
    most_rounds : int
        Largest number of rounds of solving and reweighting.
    most_verdicts : int
        Largest number of decisions on overlaps that residuals alone cannot determine.
    steady : float
        Change of a weight, or of the logarithm of a prior's width, that is no longer followed.
    restless_fraction : float
        Largest fraction of overlaps with a larger change in the last round.
    intermediate : float
        Relative error of an intermediate solution that only determines weights.
    trace : float
        Relative error of the solutions from which the traces of the priors are estimated.
    enough_each : float, variances per unknown
        Negligible energy of the error of an intermediate solution.
    enough : float, variances
        Negligible energy of the error of the result, in total.
    probes : int
        Number of random sign vectors for each estimated prior, in systems that are factorised directly.
    far : float
        Residuals beyond this many standard deviations are clipped when the prior is estimated.
    usually : int, fields
        Weight of the initial guess of a prior.
    """

    misfits: float = 3.0
    most_excess: float = 5.0
    least_redundancy: float = 0.1
    most_rounds: int = 30
    most_verdicts: int = 8
    steady: float = 0.05
    restless_fraction: float = 1e-3
    intermediate: float = 3e-2
    trace: float = 0.1
    enough_each: float = 1e-4
    enough: float = 1e-2
    probes: int = 4
    far: float = 4.0
    usually: int = 4


ROBUST = RobustSolverParameters()
_MEDIAN_CHI2 = (1.0, 0.455, 0.693, 0.789)
"""Median of chi squared per degree of freedom, indexed by the degrees of freedom."""


@dataclass(frozen=True, slots=True, eq=False)
class RobustSolution:
    """Values [n, d] of the fields and shared unknowns [m], with weights and solver state.

    weight: [e], 0 ... 1; excess: factor by which residuals exceed their uncertainties; scale: residual in standard
    deviations where a weight has fallen to a quarter; solver: of the last least squares step; echoes: [unknowns,
    probes], solutions for `_probes`.
    """

    values: Numbers
    shared: Numbers
    weight: Numbers
    excess: float = 1.0
    scale: float = np.inf
    solver: Solver | None = None
    echoes: Numbers | None = None

    @property
    def without_solver(self) -> RobustSolution:
        """The same without the solver: that of a million fields takes a gigabyte, and the next step makes its own."""
        return dataclasses.replace(self, solver=None)


Decide = Callable[[PoseGraph, RobustSolution], Numbers]


def solve_robust(
    network: PoseGraph, values: Numbers, decide: Decide | None = None, like: RobustSolution | None = None
) -> tuple[PoseGraph, RobustSolution]:
    """Estimate the most probable values, starting from `values` [n, d]; fields that are not free stay fixed.

    decide: returns the weights [e] of overlaps that residuals alone cannot determine, NaN for others; like: solution of
    a similar graph, used as a faster start. The graph is returned with the estimated standard deviations of its priors.
    """
    constants = _Constants.of(network)
    shared = np.zeros(len(network.shared_sigma))
    solution = RobustSolution(values.copy(), shared, (constants.telling > 0).astype(float))
    if like is not None:
        solution = RobustSolution(like.values, shared, like.weight, like.excess, like.scale)
    decided = np.full(len(network.first), np.nan)
    for _ in range(ROBUST.most_verdicts if decide else 1):
        network, solution = _rounds(network, solution, constants, decided)
        decided, before = decide(network, solution) if decide else decided, decided
        solution = solution.without_solver
        if np.array_equal(decided, before, equal_nan=True):
            break
    return network, _least_squares_step(network, solution)


@dataclass(frozen=True, slots=True, eq=False)
class _Constants:
    """Parts of a solution that no round changes.

    telling: number of directions that each overlap determines, [e]; redundancy: fraction of these beyond the unknowns;
    probes: random sign vectors [unknowns, probes] for each group of unknowns with an estimated prior.
    """

    telling: NDArray[np.intp]
    redundancy: float
    probes: Numbers

    @classmethod
    def of(cls, network: PoseGraph) -> _Constants:
        telling = np.linalg.matrix_rank(network.information, hermitian=True) if len(network.first) else np.zeros(0, int)
        return cls(telling, _redundancy(network, telling), _probes(network))


def _rounds(
    network: PoseGraph, solution: RobustSolution, constants: _Constants, decided: Numbers
) -> tuple[PoseGraph, RobustSolution]:
    """Solve and reweight until the weights converge, except those that are `decided` (not NaN)."""
    for _ in range(ROBUST.most_rounds):
        before, sigma, solution = solution.weight, network.prior_sigma, solution.without_solver
        solution = _least_squares_step(network, solution, constants.probes)
        network = _with_estimated_priors(network, solution, constants.probes)
        solution = _reweighted(network, solution, constants, decided)
        restless = np.count_nonzero(np.abs(solution.weight - before) > ROBUST.steady)
        moved = np.abs(np.log(network.prior_sigma / sigma)).max()
        if (
            solution.scale <= ROBUST.misfits * solution.excess
            and restless <= ROBUST.restless_fraction * len(before)
            and moved < ROBUST.steady
        ):
            break
    return network, solution


def _least_squares_step(network: PoseGraph, solution: RobustSolution, probes: Numbers | None = None) -> RobustSolution:
    """Perform one least squares step with the current weights; probes: of an intermediate step, which is less exact."""
    weight = solution.weight / solution.excess**2
    free = network.ties.free
    solver = prepare(normal_equations(network, weight), network.x_um[free], network.y_um[free])
    downhill = _gradient(network, solution, weight)
    intermediate = probes is not None
    probes = downhill[:, :0] if probes is None else probes
    begun = np.hstack(
        (np.zeros_like(downhill), 0 * probes if solution.echoes is None else solution.echoes[:, : probes.shape[1]])
    )
    enough = np.zeros(begun.shape[1])
    enough[0] = ROBUST.enough_each * len(downhill) if intermediate else ROBUST.enough
    tolerance = np.full(begun.shape[1], ROBUST.trace)
    tolerance[0] = ROBUST.intermediate if intermediate else 0.0
    solved = solver.solve(np.hstack((downhill, probes)), tolerance, begun, enough)
    step, shared_step = np.split(solved[:, 0], (network.size * int(free.sum()),))
    values = solution.values.copy()
    values[free] += step.reshape(-1, network.size)
    return RobustSolution(
        values, solution.shared + shared_step, solution.weight, solution.excess, solution.scale, solver, solved[:, 1:]
    )


def _gradient(network: PoseGraph, solution: RobustSolution, weight: Numbers) -> Numbers:
    """Return the gradient of residuals and priors, [unknowns, 1]."""
    by_overlap = weight[:, None, None] * (
        network.information @ network.misfit(solution.values, solution.shared)[:, :, None]
    )
    by_prior = -network.surprise(solution.values, solution.shared) / network.prior_sigma**2
    by_shared = -solution.shared / network.shared_sigma**2
    return gradient(network, by_overlap, by_prior[:, :, None], by_shared[:, None])


def _probes(network: PoseGraph) -> Numbers:
    """Return random sign vectors [unknowns, probes] for each group of unknowns with an estimated prior.

    The product of a probe with its solution is, on average, the trace of the inverse (Hutchinson 1990); in large
    systems one probe suffices.
    """
    each = 1 if np.count_nonzero(network.ties.free) > DIRECT_FIELDS else ROBUST.probes
    n, d, m = len(network.x_um), network.size, len(network.shared_sigma)
    signs = np.zeros((n, d, each * len(network.auto)))
    random = np.random.default_rng(3)
    for k, group in enumerate(network.auto):
        signs[:, group, k * each : (k + 1) * each] = random.choice((-1.0, 1.0), (n, len(group), each))
    nothing = np.zeros((len(network.first), d, signs.shape[2]))
    return gradient(network, nothing, signs, np.zeros((m, signs.shape[2])))


def _with_estimated_priors(network: PoseGraph, solution: RobustSolution, probes: Numbers) -> PoseGraph:
    """Update the prior widths from prior residuals and their uncertainty (EM, Dempster 1977)."""
    if not network.auto or solution.echoes is None:
        return network
    surprise = np.clip(
        network.surprise(solution.values, solution.shared), *ROBUST.far * np.outer((-1, 1), network.prior_sigma)
    )
    traces = np.einsum("nk,nk->k", probes, solution.echoes).reshape(len(network.auto), -1).mean(axis=1)
    sigma = network.prior_sigma.copy()
    for group, trace in zip(network.auto, traces, strict=True):
        total = np.sum(surprise[:, group] ** 2) + trace + ROBUST.usually * np.sum(network.prior_guess[list(group)] ** 2)
        sigma[list(group)] = np.sqrt(total / ((len(surprise) + ROBUST.usually) * len(group)))
    return dataclasses.replace(network, prior_sigma=sigma)


def _reweighted(
    network: PoseGraph, solution: RobustSolution, constants: _Constants, decided: Numbers
) -> RobustSolution:
    """Compute new weights at the next smaller scale, and the inflation of the residuals."""
    telling = constants.telling
    counts = telling > 0
    if not np.any(counts):
        return dataclasses.replace(solution, scale=0.0)
    misfit = network.misfit(solution.values, solution.shared)
    chi2 = np.einsum("ea,eab,eb->e", misfit, network.information, misfit) / np.maximum(telling, 1)
    excess = _variance_inflation(constants, chi2)
    scale = max(ROBUST.misfits * excess, min(solution.scale, float(np.sqrt(chi2[counts].max()))) / 2)
    weight = np.where(np.isnan(decided), counts / (1 + chi2 / scale**2) ** 2, decided)
    return dataclasses.replace(solution, weight=weight, excess=excess, scale=scale)


def _redundancy(network: PoseGraph, telling: NDArray[np.intp]) -> float:
    """Return the fraction of what overlaps tell that exceeds the unknowns they determine; 0 if they tell nothing."""
    counts, free = telling > 0, network.ties.free
    if not np.any(counts):
        return 0.0
    group = groups(len(free), network.first[counts], network.second[counts])
    loose = len(np.setdiff1d(group[free], group[~free]))
    unknowns = network.size * (int(free.sum()) - loose)
    return float(1 - unknowns / telling.sum())


def _variance_inflation(constants: _Constants, chi2: Numbers) -> float:
    """Return the variance inflation, at least 1, from the median residual and the redundancy."""
    if constants.redundancy < ROBUST.least_redundancy:
        return 1.0
    counts = constants.telling > 0
    expected = _MEDIAN_CHI2[round(float(np.median(constants.telling[counts])))] * constants.redundancy
    return float(np.clip(np.sqrt(np.median(chi2[counts]) / expected), 1.0, ROBUST.most_excess))


EXACT_STEPS = 5e9
"""Largest number of steps in which uncertainties are computed exactly, those of 10 000 fields of a wafer.

Their band and its inverse take 150 MB; both grow faster than the number of fields, and samples do not.
"""
_SAMPLES = 48
"""Number of sets of errors that are drawn for the uncertainties of many fields."""
_AT_ONCE = 8
"""Largest number of drawn sets of errors that are solved together."""
_ROOM = 64 * 2**20
"""Bytes of a solution of those sets; solving them takes about ten times as much."""
_TOLERANCE = 3e-2
"""Relative error of the solutions from which uncertainties are computed, which become smaller by less than 1 %."""


def standard_uncertainties(network: PoseGraph, solution: RobustSolution, wanted: tuple[int, ...]) -> Numbers:
    """Return the uncertainties [n, len(wanted)] of the unknowns `wanted` of each field; 0 if it is fixed."""
    solver, free = solution.solver, network.ties.free
    found = np.zeros((len(network.x_um), len(wanted)))
    if solver is None or not np.any(free):
        return found
    variance = _exact(solver)
    if variance is None:
        variance = _sampled(network, solution, solver)
    found[free] = np.sqrt(variance.reshape(-1, network.size)[:, wanted])
    return found


def shared_covariance(solution: RobustSolution, m: int) -> tuple[Numbers, Numbers]:
    """Return the first m shared unknowns, fewer if there are not as many, and their covariance."""
    if solution.solver is None:
        return solution.shared[:m], np.diag(np.full(len(solution.shared[:m]), np.inf))
    return solution.shared[:m], _inverse_of_shared(solution.solver)[1][:m, :m]


def _inverse_of_shared(solver: Solver) -> tuple[Numbers, Numbers]:
    """Return the columns of the inverse for the shared unknowns: rows of the fields [n, m], and their own [m, m]."""
    n, m = solver.system.border.shape
    if m == 0:
        return np.zeros((n, 0)), np.zeros((0, 0))
    inverse = solver.solve(np.eye(n + m, m, -n), _TOLERANCE)
    return inverse[:n], inverse[n:]


def _exact(solver: Solver) -> Numbers | None:
    """Return the diagonal [n] of the inverse for the fields, or None if it takes too long.

    It is that of their blocks alone, and what shared unknowns add.
    """
    alone = inverse_diagonal(solver.system.blocks, EXACT_STEPS)
    if alone is None:
        return None
    across, shared = _inverse_of_shared(solver)
    return alone + np.einsum("nk,nk->n", across @ np.linalg.inv(shared), across)


def _sampled(network: PoseGraph, solution: RobustSolution, solver: Solver) -> Numbers:
    """Return the mean square [n] of the solutions of drawn errors."""
    n, random = len(solver.system.border), np.random.default_rng(5)
    values, vectors = np.linalg.eigh((solution.weight / solution.excess**2)[:, None, None] * network.information)
    vectors *= np.sqrt(np.maximum(values, 0))[:, None, :]
    variance, at_once = np.zeros(n), _AT_ONCE
    while at_once > 1 and at_once * variance.nbytes > _ROOM:
        at_once //= 2
    for _ in range(_SAMPLES // at_once):
        by_overlap = vectors @ random.normal(size=(*values.shape, at_once))
        by_prior = random.normal(size=(len(network.x_um), network.size, at_once)) / network.prior_sigma[:, None]
        by_shared = random.normal(size=(len(solution.shared), at_once)) / network.shared_sigma[:, None]
        drawn = solver.solve(gradient(network, by_overlap, by_prior, by_shared), _TOLERANCE)[:n]
        variance += np.einsum("nk,nk->n", drawn, drawn)
    return variance / _SAMPLES
