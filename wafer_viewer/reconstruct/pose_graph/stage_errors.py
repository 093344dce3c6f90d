"""Errors of the stage that fields have in common, and with them the places of fields that no overlap ties down.

Offset, scale, turn and the backlash of rows and columns that are scanned in alternating directions are estimated from
the fields that overlaps place. A field beside them lies where the stage says, corrected by these errors, and by the
errors of its neighbours as far as those of neighbours are alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.field_poses import Numbers
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA

Flags = NDArray[np.bool_]
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
    by[:, 0, 4], by[:, 1, 5] = _parity(stage[:, 1]), _parity(stage[:, 0])
    return by


def _parity(along: Numbers) -> Numbers:
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
