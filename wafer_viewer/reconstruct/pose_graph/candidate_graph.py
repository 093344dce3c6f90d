"""Overlaps with all the offsets at which they fit, as a graph of fields, and the limits of the choice among these.

Fields that are sorted by rows are tied to others near them in the list only: the matrix has a band, which is decomposed
in less time than a general sparse matrix takes to be put together.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.field_poses import Numbers, RejectionReason, Shifts
from wafer_viewer.numerics.banded_matrix import factorise, solve
from wafer_viewer.numerics.jit import lean_kernel
from wafer_viewer.reconstruct.pose_graph.amg_solver import Sparse, System, prepare
from wafer_viewer.reconstruct.pose_graph.pose_graph import Flags

# ------------------------------------------------------------------------------------------------------ candidate graph


Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class ChoiceParameters:
    """Prior of the stage's errors and limits of the choice.

    Parameters
    ----------
    scatter_px : float, px
        Scatter of the stage before it is estimated.
    scatter_of_pitch : float
        The same, as the largest part of the spacing of the candidates.
    usually : int, fields
        Weight of that scatter where it is estimated.
    enough_fields : int
        Number of fields from which it is estimated, and limited by the pitch; fewer do not show how good a stage is.
    least_scatter_px : float, px
        Smallest scatter of the stage.
    offset_px : float, px
        Standard deviation of an offset that all fields share.
    turn : float, rad, and fraction
        Standard deviation of the turn and of the scale of the stage against the camera.
    backlash_px : float, px
        Standard deviation of the offset of every second row and column.
    backlash_of_pitch : float
        The same, as the largest part of the spacing of the candidates: one period more would be as good.
    slack_px : float, px
        Uncertainty added to a candidate: it was compared at half of the resolution, and neighbours may still move.
    most_candidate_nats : float
        Largest misfit of a candidate.
    most_overlap_nats : float
        Largest cost of an overlap: one that fits nowhere says no more.
    sure_nats : float
        Log odds of a field's place against any other above which it is believed: 55 to 1.
    near_px : float, px
        Largest distance between a candidate and the places of its fields.
    most_of_pitch : float
        Scatter of the stage, relative to the spacing of the candidates, above which nothing is chosen.
    decides_nats : float
        Misfit of the second best candidate above which pictures decide without the stage.
    most_sweeps : int
        Largest number of times that all fields are placed again.

    Notes
    -----
    `tests/bench/bench_grids.py` shows the errors that remain; its seeds below 1000 set the limits.
    """

    scatter_px: float = 6.0
    scatter_of_pitch: float = 0.15
    usually: int = 4
    enough_fields: int = 8
    least_scatter_px: float = 0.3
    offset_px: float = 30.0
    turn: float = 0.005
    backlash_px: float = 6.0
    backlash_of_pitch: float = 0.2
    slack_px: float = 0.3
    most_candidate_nats: float = 6.0
    most_overlap_nats: float = 12.0
    sure_nats: float = 4.0
    near_px: float = 2.5
    most_of_pitch: float = 0.18
    decides_nats: float = 3.0
    most_sweeps: int = 8


CHOICE = ChoiceParameters()
_SOME_OVERLAPS = 4000
"""Number of overlaps that show the spacing of the candidates."""
_LOCATED = 2.0
"""Smallest precision, added up along x and y, of a candidate that shows the spacing: that of a pixel, in 1/px^2."""


@dataclass(frozen=True, eq=False)
class CandidateGraph:
    """Overlaps with their candidates, in pixels.

    first, second: fields, [e]; offset: [e, k, 2]; precision: [e, k, 3] of (xx, xy, yy);
    misfit: [e, k] in nats, infinite where there is no candidate; ends, edges: the overlaps of each field, as in a
    sparse matrix.
    """

    first: Ints
    second: Ints
    offset: Numbers
    precision: Numbers
    misfit: Numbers
    ends: Ints
    edges: Ints

    @classmethod
    def of(cls, n: int, shifts: Shifts, pixel_um: float) -> CandidateGraph:
        """Return the overlaps that fit anywhere; those at one offset only have one candidate."""
        fits = np.isin(shifts.doubt, (RejectionReason.NONE, RejectionReason.DISAGREES)) | shifts.repeats
        rows = np.flatnonzero(fits & np.isfinite(shifts.x_um) & (np.isfinite(shifts.u_x_um) | shifts.repeats))
        table = _with_single(shifts, rows).astype(np.float64)
        offset = table[:, :, :2] / pixel_um
        precision = _with_slack(table[:, :, 2:5] * pixel_um**2)
        misfit = np.where(np.isfinite(table[:, :, 5]), np.minimum(table[:, :, 5], CHOICE.most_candidate_nats), np.inf)
        first, second = shifts.first[rows].astype(np.int64), shifts.second[rows].astype(np.int64)
        both, number = np.concatenate((first, second)), np.tile(np.arange(len(rows)), 2)
        order = np.argsort(both, kind="stable")
        ends = np.concatenate(([0], np.cumsum(np.bincount(both, minlength=n))))
        return cls(first, second, np.nan_to_num(offset), np.nan_to_num(precision), misfit, ends, number[order])

    @property
    def pictures_differ(self) -> bool:
        """True if any candidate fits better than another of the same overlap."""
        return bool((self.misfit[np.isfinite(self.misfit)] > 0).any())

    def without_misfits(self) -> CandidateGraph:
        """Return the same candidates, all equally likely.

        Between binned pixels a pattern finer than these fits better or worse by chance, in all overlaps alike.
        """
        return replace(self, misfit=np.where(np.isfinite(self.misfit), 0.0, np.inf))

    @cached_property
    def located(self) -> NDArray[np.bool_]:
        """Mask of the candidates whose place is known along any direction, [e, k]: not to search pixels only."""
        return np.isfinite(self.misfit) & (self.precision[..., 0] + self.precision[..., 2] > _LOCATED)

    @cached_property
    def spacing_px(self) -> float:
        """Median distance of the nearest two candidates of the overlaps with several; infinite without."""
        known = self.located
        several = np.flatnonzero(known.sum(axis=1) > 1)
        if not len(several):
            return np.inf
        some = several[:: 1 + len(several) // _SOME_OVERLAPS]
        offset = np.where(known[some, :, None], self.offset[some], np.nan)
        apart = np.hypot(*np.moveaxis(offset[:, :, None] - offset[:, None], -1, 0))
        apart[:, np.arange(apart.shape[1]), np.arange(apart.shape[1])] = np.inf
        return float(np.median(np.nanmin(apart, axis=(1, 2))))

    @cached_property
    def periods_px(self) -> Numbers:
        """Median of the shortest steps between candidates, mostly along x and mostly along y, [2, 2]; NaN without."""
        known = self.located
        several = np.flatnonzero(known.sum(axis=1) > 1)
        some = several[:: 1 + len(several) // _SOME_OVERLAPS]
        offset = np.where(known[some, :, None], self.offset[some], np.nan)
        steps = offset[:, :, None] - offset[:, None]
        found = np.full((2, 2), np.nan)
        for axis in range(2):
            forward, across = steps[..., axis], np.abs(steps[..., 1 - axis])
            length = np.where((forward > 2 * across) & (forward > CHOICE.near_px), forward, np.inf)
            length = length.reshape(len(length), length.shape[1] ** 2)
            nearest = length.argmin(axis=1) if length.size else np.zeros(0, np.intp)
            rows = np.arange(len(nearest))
            there = np.isfinite(length[rows, nearest]) if length.size else np.zeros(0, np.bool_)
            if there.any():
                found[axis] = np.median(steps.reshape(len(length), -1, 2)[rows, nearest][there], axis=0)
        return found

    @property
    def decided_by_pictures(self) -> float:
        """Median misfit of the second best candidate, in nats."""
        several = np.isfinite(self.misfit).sum(axis=1) > 1
        return float(np.median(np.sort(self.misfit[several], axis=1)[:, 1])) if several.any() else np.inf


def _with_single(shifts: Shifts, rows: NDArray[np.intp]) -> Numbers:
    """Return the candidates of some overlaps, [e, k, 6], with the measured offset where a pattern does not repeat."""
    table = shifts.candidates[rows].astype(np.float64)
    single = ~shifts.repeats[rows]
    only = rows[single]
    covariance = np.empty((len(only), 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = shifts.u_x_um[only] ** 2, shifts.u_y_um[only] ** 2
    covariance[:, 0, 1] = covariance[:, 1, 0] = shifts.covariance_um2[only]
    precision = np.linalg.inv(covariance)
    table[single, 0] = np.column_stack(
        (
            *(shifts.x_um[only], shifts.y_um[only]),
            *(precision[:, 0, 0], precision[:, 0, 1], precision[:, 1, 1]),
            np.zeros(len(only)),
        )
    )
    return table


def _with_slack(precision: Numbers) -> Numbers:
    """Return precisions (xx, xy, yy) with `ChoiceParameters.slack_px` added to the uncertainty."""
    known = np.isfinite(precision).all(axis=-1, keepdims=True)
    xx, xy, yy = np.moveaxis(np.where(known, precision, 0), -1, 0)
    variance = CHOICE.slack_px**2
    both = variance * (xx * yy - xy**2)
    determinant = 1 + variance * (xx + yy + both)
    return np.stack((xx + both, xy, yy + both), axis=-1) / determinant[..., None]


# ----------------------------------------------------------------------------------------------------------- joint step


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
