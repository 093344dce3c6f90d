"""Standard uncertainties of poses from the inverse of the normal equations.

Up to `DIRECT_FIELDS` fields their diagonal is exact. Beyond, `_SAMPLES` sets of errors are drawn from the uncertainties
of overlaps and priors, each is solved like a measurement, and the spread of the solutions is the uncertainty
(Papandreou and Yuille 2010: Gaussian sampling by local perturbations): unbiased, with a relative error of 1 / sqrt(2 *
samples) = 10 %.
"""

from __future__ import annotations

import numpy as np

from wafer_viewer.model.surface.field_poses import Numbers
from wafer_viewer.reconstruct.pose_graph.amg_solver import Solver
from wafer_viewer.reconstruct.pose_graph.pose_graph import PoseGraph, gradient
from wafer_viewer.reconstruct.pose_graph.robust_solver import RobustSolution

_SAMPLES = 48
_AT_ONCE = 4
_COLUMNS = 256
_TOLERANCE = 1e-2


def standard_uncertainties(network: PoseGraph, at: RobustSolution, wanted: tuple[int, ...]) -> Numbers:
    """Return the uncertainties [n, len(wanted)] of the unknowns `wanted` of each field; 0 if it is fixed."""
    solver, free = at.solver, network.ties.free
    found = np.zeros((len(network.x_um), len(wanted)))
    if solver is None or not np.any(free):
        return found
    n = network.size * int(free.sum())
    variance = _sampled(network, at, solver, n) if solver.levels else _exact(solver, n, network.size, wanted)
    found[free] = np.sqrt(variance.reshape(-1, network.size)[:, wanted])
    return found


def shared_uncertainties(at: RobustSolution) -> Numbers:
    """Return the uncertainties [m] of the shared unknowns; infinite without a solver."""
    m = len(at.shared)
    if at.solver is None or m == 0:
        return np.full(m, np.inf)
    n = len(at.solver.system.border)
    unit = np.vstack((np.zeros((n, m)), np.eye(m)))
    return np.sqrt(np.diag(at.solver.solve(unit, _TOLERANCE)[n:]))


def _exact(solver: Solver, n: int, size: int, wanted: tuple[int, ...]) -> Numbers:
    """Return the diagonal [n] of the inverse for the fields; 0 for unknowns that are not wanted."""
    variance = np.zeros(n)
    rows = np.concatenate([np.arange(k, n, size) for k in wanted])
    for some in np.split(rows, range(_COLUMNS, len(rows), _COLUMNS)):
        unit = np.zeros((n + len(solver.system.corner), len(some)))
        unit[some, np.arange(len(some))] = 1.0
        variance[some] = solver.solve(unit, _TOLERANCE)[some, np.arange(len(some))]
    return variance


def _sampled(network: PoseGraph, at: RobustSolution, solver: Solver, n: int) -> Numbers:
    """Return the mean square [n] of the solutions of drawn errors."""
    random = np.random.default_rng(5)
    values, vectors = np.linalg.eigh((at.weight / at.excess**2)[:, None, None] * network.information)
    root = vectors * np.sqrt(np.maximum(values, 0))[:, None, :]
    variance = np.zeros(n)
    for _ in range(_SAMPLES // _AT_ONCE):
        by_overlap = root @ random.normal(size=(*values.shape, _AT_ONCE))
        by_prior = random.normal(size=(len(network.x_um), network.size, _AT_ONCE)) / network.prior_sigma[:, None]
        by_shared = random.normal(size=(len(at.shared), _AT_ONCE)) / network.shared_sigma[:, None]
        drawn = solver.solve(gradient(network, by_overlap, by_prior, by_shared), _TOLERANCE)[:n]
        variance += np.einsum("nk,nk->n", drawn, drawn)
    return variance / _SAMPLES
