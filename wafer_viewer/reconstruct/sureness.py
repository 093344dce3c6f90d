"""How sure each pose is: standard uncertainties from the inverse of the normal equations.

Up to `DIRECT_FIELDS` fields their diagonal is exact. Beyond, `_SAMPLES` sets of errors are drawn from what overlaps and
priors are unsure of, each is solved like a measurement, and the spread of the solutions is the uncertainty (Papandreou
and Yuille 2010: Gaussian sampling by local perturbations): without bias, and right to 1 / sqrt(2 * samples) = 9 %.
"""

from __future__ import annotations

import numpy as np

from wafer_viewer.model.poses import Numbers
from wafer_viewer.reconstruct.multigrid import Solver
from wafer_viewer.reconstruct.network import Network, normal_equations, pull
from wafer_viewer.reconstruct.settle import Settled

_SAMPLES = 64
_AT_ONCE = 8
_COLUMNS = 256
_TOLERANCE = 1e-3


def standard_uncertainties(network: Network, at: Settled, wanted: tuple[int, ...]) -> Numbers:
    """[n, len(wanted)] of the unknowns `wanted` of each field; 0 where it is fixed."""
    solver, response, covariance = at.solver, at.response, at.covariance
    found = np.zeros((len(network.x_um), len(wanted)))
    free = network.ties.free
    if solver is None or response is None or covariance is None or not np.any(free):
        return found
    if solver.levels:
        variance = _sampled(network, at, solver, response, covariance)
    else:
        variance = _exact(solver, response, covariance, network.size, wanted)
    found[free] = np.sqrt(variance.reshape(-1, network.size)[:, wanted])
    return found


def _exact(solver: Solver, response: Numbers, covariance: Numbers, size: int, wanted: tuple[int, ...]) -> Numbers:
    """The diagonal of the inverse, [free unknowns]; 0 for unknowns that are not wanted."""
    n = len(response)
    variance = np.zeros(n)
    rows = np.concatenate([np.arange(k, n, size) for k in wanted])
    for some in np.split(rows, range(_COLUMNS, len(rows), _COLUMNS)):
        unit = np.zeros((n, len(some)))
        unit[some, np.arange(len(some))] = 1.0
        variance[some] = solver.solve(unit, _TOLERANCE)[some, np.arange(len(some))]
    variance[rows] += np.einsum("na,ab,nb->n", response[rows], covariance, response[rows])
    return variance


def _sampled(network: Network, at: Settled, solver: Solver, response: Numbers, covariance: Numbers) -> Numbers:
    """The mean square of solutions of drawn errors, [free unknowns]."""
    random = np.random.default_rng(5)
    weight = at.weight / at.excess**2
    coupling = normal_equations(network, weight).coupling
    values, vectors = np.linalg.eigh(weight[:, None, None] * network.information)
    root = vectors * np.sqrt(np.maximum(values, 0))[:, None, :]
    variance = np.zeros(len(response))
    for _ in range(_SAMPLES // _AT_ONCE):
        by_overlap = root @ random.normal(size=(len(weight), network.size, _AT_ONCE))
        by_prior = random.normal(size=(len(network.x_um), network.size, _AT_ONCE)) / network.prior_sigma[:, None]
        fields, shared = pull(network, by_overlap, by_prior)
        shared += random.normal(size=shared.shape) / network.shared_sigma[:, None]
        alone = solver.solve(fields, _TOLERANCE)
        drawn = alone - response @ (covariance @ (shared - coupling.T @ alone))
        variance += np.einsum("nk,nk->n", drawn, drawn)
    return variance / _SAMPLES
