"""Joint choice among the offsets at which repeating patterns fit, with the stage as prior.

An overlap of a pattern that repeats fits at many offsets, one pitch apart, and its pictures alone do not tell which is
right. Together with the stage, the overlaps of all fields do: a wrong offset of one contradicts those around it. Fields
are placed one by one, from the middle of the grid outwards, the surest next, each where the candidates of its placed
neighbours and the stage together say; then all of them are placed again in turn, until nothing changes. This is done
from several beginnings, since a part of the grid may lock in one period beside the rest; the most probable end counts.

What the errors of the stage have in common (offset, scale, turn, and the backlash of rows and columns that are scanned
in alternating directions) is estimated along the way, with its uncertainty, as is the scatter about it. Patterns cannot
be told apart by a stage whose scatter reaches a good part of their pitch: then nothing is chosen.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, fields, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.field_poses import Numbers, RejectionReason, Shifts, selected
from wafer_viewer.numerics.jit import lean_kernel
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA
from wafer_viewer.reconstruct.pose_graph.bridge_arbitration import groups
from wafer_viewer.reconstruct.pose_graph.pose_graph import Flags

Ints = NDArray[np.int64]
Float32s = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class ChoiceParameters:
    """Prior of the stage's errors and limits of the choice.

    Parameters
    ----------
    scatter_px, scatter_of_pitch : float, px, and fraction
        Scatter of the stage before it is estimated, at most this part of the spacing of the candidates.
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
    slack_px : float, px
        Uncertainty added to a candidate: it was compared at half of the resolution, and neighbours may still move.
    most_candidate_nats, most_overlap_nats : float
        Largest misfit of a candidate, and largest cost of an overlap: one that fits nowhere says no more.
    sure_nats : float
        Log odds of a field's place against any other above which it is believed: 150 to 1.
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
    enough_fields: int = 12
    least_scatter_px: float = 0.3
    offset_px: float = 30.0
    turn: float = 0.005
    backlash_px: float = 6.0
    slack_px: float = 0.3
    most_candidate_nats: float = 6.0
    most_overlap_nats: float = 12.0
    sure_nats: float = 5.0
    near_px: float = 2.5
    most_of_pitch: float = 0.18
    decides_nats: float = 3.0
    most_sweeps: int = 8


CHOICE = ChoiceParameters()
BEGINNINGS = ((1.0, 0.0), (0.5, 0.0), (1.0, 0.3), (0.5, 0.6), (0.7, 1.0))
"""Beginnings: part of the expected scatter, and where the first field lies, from the middle (0) to the rim (1)."""
MANY_FIELDS = 20_000
"""Number of fields above which only the first beginning is tried."""
RELAXED_PX = (6.0, 2.0, 1.0)
"""Residuals at which overlaps have lost three quarters of their weight, when all fields are moved together, px."""
N_SHARED = 6
"""Number of shared errors of the stage: offset along x and y, scale, turn, backlash of rows and of columns."""
N_UNSETTLED = 4
"""Number of these that count while fields are placed for the first time."""


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """The chosen offsets.

    shifts: patterns that are open or not measured yet are ambiguous; to_measure: mask of the overlaps to be measured
    at the offsets (x, y) `expected_um`, [e, 2]; sure: fields whose place is believed; scatter_um: of the stage;
    spacing_px: of the candidates; refused: whether patterns were left open because the stage is too coarse for them.
    """

    shifts: Shifts
    to_measure: Flags
    expected_um: Numbers
    sure: Flags
    scatter_um: float
    spacing_px: float
    refused: bool

    def notes(self, pixel_um: float) -> tuple[str, ...]:
        """Return why patterns were left open, in a sentence, or nothing."""
        if not self.refused:
            return ()
        return (
            f"Overlaps show a pattern that repeats every {self.spacing_px * pixel_um:.3g} um, and the stage is off by "
            f"{self.scatter_um:.3g} um: no period was chosen, as that takes a stage within "
            f"{CHOICE.most_of_pitch:.0%} of the pitch. Calibrate the stage, or scan with more overlap.",
        )

    def with_measured(self, measured: Shifts) -> Shifts:
        """Return the overlaps with the measurements of those that were to be measured, where they fit."""
        rows = np.flatnonzero(self.to_measure)[measured.believed]
        found = selected(measured, measured.believed)
        columns = {}
        for item in fields(Shifts):
            column = getattr(self.shifts, item.name).copy()
            if item.name not in ("first", "second", "candidates"):
                column[rows] = getattr(found, item.name)
            columns[item.name] = column
        return Shifts(**columns)


def choose_candidates(
    stage_x_um: Numbers,
    stage_y_um: Numbers,
    shifts: Shifts,
    pixel_um: float,
    *,
    stage_error_um: float | Literal["auto"] = "auto",
    fixed: Flags | None = None,
    start: tuple[Numbers, Numbers] | None = None,
) -> Choice | None:
    """Choose one offset of each overlap that fits at several, or none where that is unsure.

    stage_x_um, stage_y_um: positions of the fields by the stage, [n]; stage_error_um: its standard deviation along an
    axis, estimated if ``auto``; fixed, start: fields with known positions, and these. None where no pattern repeats.
    """
    if not shifts.repeats.any():
        return None
    stage = np.column_stack((stage_x_um, stage_y_um)) / pixel_um
    graph = _Graph.of(len(stage), shifts, pixel_um)
    begun = None if start is None else np.column_stack(start) / pixel_um
    ends: list[_Placing] = []
    for share, out in BEGINNINGS[:1] if len(stage) > MANY_FIELDS else BEGINNINGS:
        placing = _Placing.begin(graph, stage, fixed, begun)
        if stage_error_um != "auto":
            placing.scatter[:] = max(stage_error_um / pixel_um, CHOICE.least_scatter_px)
            placing.knows_scatter = True
        placing.scatter *= share
        placing.grow(out)
        placing.scatter /= share
        placing.sweep()
        ends.append(placing)
    return _chosen(min(ends, key=_Placing.cost_nats), shifts, pixel_um)


@dataclass(frozen=True, slots=True, eq=False)
class _Graph:
    """Overlaps with their candidates, in pixels.

    overlap: rows of `Shifts`, [e]; first, second: fields, [e]; offset: [e, k, 2]; precision: [e, k, 3] of (xx, xy, yy);
    misfit: [e, k] in nats, infinite where there is no candidate; ends, edges: the overlaps of each field, as in a
    sparse matrix.
    """

    overlap: NDArray[np.intp]
    first: Ints
    second: Ints
    offset: Numbers
    precision: Numbers
    misfit: Numbers
    ends: Ints
    edges: Ints

    @classmethod
    def of(cls, n: int, shifts: Shifts, pixel_um: float) -> _Graph:
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
        return cls(rows, first, second, np.nan_to_num(offset), np.nan_to_num(precision), misfit, ends, number[order])

    @property
    def spacing_px(self) -> float:
        """Median distance of the nearest two candidates of the overlaps with several; infinite without."""
        known = np.isfinite(self.misfit)
        several = known.sum(axis=1) > 1
        offset = np.where(known[several, :, None], self.offset[several], np.nan)
        apart = np.hypot(*np.moveaxis(offset[:, :, None] - offset[:, None], -1, 0))
        apart[:, np.arange(apart.shape[1]), np.arange(apart.shape[1])] = np.inf
        return float(np.median(np.nanmin(apart, axis=(1, 2)))) if several.any() else np.inf

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
    known = np.isfinite(precision).all(axis=-1)
    full = np.zeros((*precision.shape[:-1], 2, 2))
    full[..., 0, 0], full[..., 1, 1] = np.where(known, precision[..., 0], 0), np.where(known, precision[..., 2], 0)
    full[..., 0, 1] = full[..., 1, 0] = np.where(known, precision[..., 1], 0)
    slack = full @ np.linalg.inv(np.eye(2) + CHOICE.slack_px**2 * full)
    return np.stack((slack[..., 0, 0], slack[..., 0, 1], slack[..., 1, 1]), axis=-1)


@dataclass(slots=True, eq=False)
class _Placing:
    """Fields on their way to their places, in pixels.

    stage, place: [n, 2]; placed, fixed: masks; odds: log odds of a place against any other, [n]; shared_by: effect of
    the shared errors on a field, [n, 2, m]; shared, shared_covariance: what is known of them;     scatter: of the stage
    along x and y about these; knows_scatter: whether it was given.
    """

    graph: _Graph
    stage: Numbers
    place: Numbers
    placed: Flags
    fixed: Flags
    odds: Numbers
    shared_by: Numbers
    shared: Numbers
    shared_covariance: Numbers
    scatter: Numbers
    knows_scatter: bool = False

    @classmethod
    def begin(cls, graph: _Graph, stage: Numbers, fixed: Flags | None, start: Numbers | None) -> _Placing:
        """Return fields of which only the fixed ones have a place."""
        n = len(stage)
        is_fixed = np.zeros(n, np.bool_) if fixed is None or start is None else fixed.copy()
        place = stage.copy()
        if start is not None:
            place[is_fixed] = start[is_fixed]
        sigma = _shared_sigma(N_UNSETTLED)
        return cls(
            graph,
            stage,
            place,
            is_fixed.copy(),
            is_fixed,
            np.where(is_fixed, np.inf, 0.0),
            _shared_by(stage),
            np.zeros(N_SHARED),
            np.diag(sigma**2),
            np.full(2, _usual_scatter(graph, n)),
        )

    def grow(self, out: float) -> None:
        """Place all fields that have candidates for the first time, the surest next.

        out: where to begin, from the middle (0) to the rim (1).
        """
        graph, n = self.graph, len(self.stage)
        component = groups(n, graph.first.astype(np.int32), graph.second.astype(np.int32))
        seeds = self._seeds(component, out)
        for seed in seeds:
            self.placed[seed] = True
            self.odds[seed] = np.inf
        heap: list[tuple[float, int]] = []
        version = np.zeros(n)
        for field in np.flatnonzero(self.placed).tolist():
            self._push_neighbours(heap, field, version)
        n_refit, n_placed = 4, int(self.placed.sum())
        while heap:
            known, field = heapq.heappop(heap)
            if self.placed[field] or -known != version[field]:
                continue
            self._put(field)
            self.placed[field] = True
            n_placed += 1
            if n_placed >= n_refit:
                self._refit(N_UNSETTLED, with_scatter=False)
                n_refit = int(1.25 * n_placed) + 1
            self._push_neighbours(heap, field, version)

    def _seeds(self, component: NDArray[np.int32], out: float) -> list[int]:
        """Return a field of each connected set of fields without a fixed one, the most central or further out."""
        has_overlap = np.diff(self.graph.ends) > 0
        known = np.isin(component, component[self.placed])
        open_fields = np.flatnonzero(has_overlap & ~known)
        if not len(open_fields):
            return []
        n_sets = int(component.max()) + 1
        count = np.maximum(np.bincount(component, minlength=n_sets), 1)
        middle = np.column_stack([np.bincount(component, axis, n_sets) / count for axis in self.stage.T])
        far = np.hypot(*(self.stage - middle[component]).T)
        order = open_fields[np.lexsort((far[open_fields], component[open_fields]))]
        _, first, count = np.unique(component[order], return_index=True, return_counts=True)
        return [int(n) for n in order[first + (out * (count - 1)).astype(np.intp)]]

    def _push_neighbours(self, heap: list[tuple[float, int]], field: int, version: Numbers) -> None:
        graph = self.graph
        for edge in graph.edges[graph.ends[field] : graph.ends[field + 1]]:
            other = int(graph.first[edge] + graph.second[edge] - field)
            if not self.placed[other]:
                _, odds = self._best(other)
                version[other] = odds
                heapq.heappush(heap, (-odds, other))

    def sweep(self) -> None:
        """Place all fields again, with the scatter of the stage and its backlash, until none moves."""
        movable = np.flatnonzero(self.placed & ~self.fixed & (np.diff(self.graph.ends) > 0))
        for n in range(CHOICE.most_sweeps):
            self._refit(N_UNSETTLED if n == 0 else N_SHARED, with_scatter=True)
            before = self.place.copy()
            self._relax()
            for field in movable.tolist():
                self._put(field)
            if n > 1 and np.abs(self.place - before).max(initial=0) < CHOICE.near_px / 2:
                break

    def cost_nats(self) -> float:
        """Return minus the log likelihood of all places, apart from a constant."""
        graph, used = self.graph, self.placed[self.graph.first] & self.placed[self.graph.second]
        moved = self.place - self.stage
        off = (moved[graph.second] - moved[graph.first])[used, None] - graph.offset[used]
        xx, xy, yy = np.moveaxis(graph.precision[used], -1, 0)
        misfit = (xx * off[..., 0] ** 2 + 2 * xy * off[..., 0] * off[..., 1] + yy * off[..., 1] ** 2) / 2
        by_overlaps = np.minimum((misfit + graph.misfit[used]).min(axis=1), CHOICE.most_overlap_nats).sum()
        rest = ((moved - self.shared_by @ self.shared)[self.placed & ~self.fixed]) / self.scatter
        by_stage = np.sum(rest**2) / 2 + len(rest) * np.log(self.scatter).sum()
        return float(by_overlaps + by_stage)

    def _relax(self) -> None:
        """Move all placed fields together to where the candidates next to them say.

        Field by field, two that are joined firmly hold each other where they were placed first.
        """
        graph, free = self.graph, self.placed & ~self.fixed
        used = np.flatnonzero(self.placed[graph.first] & self.placed[graph.second])
        a, b = graph.first[used], graph.second[used]
        expected = self.stage + self.shared_by @ self.shared
        for scale_px in RELAXED_PX:
            moved = self.place - self.stage
            off = (moved[b] - moved[a])[:, None] - graph.offset[used]
            distance = np.where(np.isfinite(graph.misfit[used]), _distance(graph.precision[used], off), np.inf)
            pick = np.argmin(distance, axis=1)
            rows = np.arange(len(used))
            weight = 1 / (1 + (distance[rows, pick] / scale_px) ** 2) ** 2
            precision = weight[:, None] * graph.precision[used, pick]
            self.place[free] += _joint_step(
                (a, b), precision, off[rows, pick], (self.place - expected) / self.scatter**2, self.scatter, free
            )

    def _put(self, field: int) -> None:
        self.place[field], self.odds[field] = self._best(field)

    def _best(self, field: int) -> tuple[Numbers, float]:
        """Return the best place of a field, by its placed neighbours and the stage, and its log odds."""
        graph, by = self.graph, self.shared_by[field][:, : len(self.shared_covariance)]
        expected = self.stage[field] + self.shared_by[field] @ self.shared
        covariance = np.diag(self.scatter**2) + by @ self.shared_covariance @ by.T
        edges = graph.edges[graph.ends[field] : graph.ends[field + 1]]
        n_proposals, found = edges.size * graph.misfit.shape[1] + 1, np.zeros(3)
        _place(
            field,
            edges,
            graph.first,
            graph.second,
            graph.offset,
            graph.precision,
            graph.misfit,
            self.stage,
            self.place,
            self.placed,
            expected,
            np.linalg.inv(covariance),
            CHOICE.most_overlap_nats,
            CHOICE.near_px,
            np.empty((n_proposals, 3)),
            np.empty((n_proposals, edges.size), np.int64),
            found,
        )
        return found[:2], float(found[2])

    def _refit(self, n_shared: int, with_scatter: bool) -> None:
        """Estimate the shared errors of the stage, and its scatter, from the placed fields."""
        used = self.placed
        off, by = (self.place - self.stage)[used], self.shared_by[used][:, :, :n_shared]
        sigma, weight = _shared_sigma(n_shared), np.ones(len(off))
        shared = np.zeros(n_shared)
        for _ in range(5):
            precision = weight[:, None] / self.scatter**2
            normal = np.einsum("nam,na,nak->mk", by, precision, by) + np.diag(sigma**-2.0)
            shared = np.linalg.solve(normal, np.einsum("nam,na,na->m", by, precision, off))
            rest = off - by @ shared
            if with_scatter and not self.knows_scatter and len(off) >= CHOICE.enough_fields:
                self.scatter = self._scatter_of(rest, len(off) - n_shared / 2)
            weight = 1 / (1 + np.sum((rest / self.scatter) ** 2, axis=1) / 18)
        self.shared = np.zeros(N_SHARED)
        self.shared[:n_shared] = shared
        self.shared_covariance = np.linalg.inv(normal)

    def _scatter_of(self, rest: Numbers, freedom: float) -> Numbers:
        """Return the scatter of the stage from what its shared errors leave, with that expected beforehand."""
        found = MAD_TO_SIGMA * np.median(np.abs(rest), axis=0) * np.sqrt(len(rest) / freedom)
        usual = _usual_scatter(self.graph, len(self.stage))
        both = np.sqrt((freedom * found**2 + CHOICE.usually * usual**2) / (freedom + CHOICE.usually))
        return np.maximum(both, CHOICE.least_scatter_px)


def _usual_scatter(graph: _Graph, n_fields: int) -> float:
    """Return the scatter of a stage that is expected beforehand, in pixels."""
    if n_fields < CHOICE.enough_fields:
        return CHOICE.scatter_px
    return min(CHOICE.scatter_px, CHOICE.scatter_of_pitch * graph.spacing_px)


def _shared_sigma(n_shared: int) -> Numbers:
    sigma = (CHOICE.offset_px, CHOICE.offset_px, CHOICE.turn, CHOICE.turn, CHOICE.backlash_px, CHOICE.backlash_px)
    return np.array(sigma[:n_shared])


def _shared_by(stage: Numbers) -> Numbers:
    """Return the effect of the shared errors on the fields, [n, 2, 6]."""
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


def _distance(precision: Numbers, off: Numbers) -> Numbers:
    """Return the lengths of offsets [..., 2] in the directions that precisions (xx, xy, yy) determine."""
    xx, xy, yy = np.moveaxis(precision, -1, 0)
    strongest = (xx + yy) / 2 + np.hypot((xx - yy) / 2, xy)
    weighted = xx * off[..., 0] ** 2 + 2 * xy * off[..., 0] * off[..., 1] + yy * off[..., 1] ** 2
    return np.sqrt(np.maximum(weighted, 0) / np.maximum(strongest, 1e-30))


def _joint_step(
    ends: tuple[Ints, Ints], precision: Numbers, off: Numbers, prior: Numbers, scatter: Numbers, free: Flags
) -> Numbers:
    """Return the step [free, 2] to the least squares of overlaps and the stage.

    off: [e, 2], difference of the places of both ends less the measured one; prior: gradient of the stage's, [n, 2].
    """
    from scipy.sparse import coo_array, csc_array
    from scipy.sparse.linalg import spsolve

    n, (a, b) = len(free), ends
    xx, xy, yy = precision.T
    push = np.column_stack((xx * off[:, 0] + xy * off[:, 1], xy * off[:, 0] + yy * off[:, 1]))
    gradient = prior.copy()
    np.add.at(gradient, b, push)
    np.add.at(gradient, a, -push)
    rows, cols, values = [np.arange(2 * n)], [np.arange(2 * n)], [np.tile(1 / scatter**2, n)]
    for first, second, sign in ((a, a, 1.0), (b, b, 1.0), (a, b, -1.0), (b, a, -1.0)):
        for i, j, value in ((0, 0, xx), (0, 1, xy), (1, 0, xy), (1, 1, yy)):
            rows.append(2 * first + i)
            cols.append(2 * second + j)
            values.append(sign * value)
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(cols)))
    both = np.repeat(free, 2)
    matrix = csc_array(coo_array(entries, (2 * n, 2 * n)))[both][:, both]
    return -np.asarray(spsolve(csc_array(matrix), gradient[free].ravel())).reshape(-1, 2)


@lean_kernel
def _place(
    field: int,
    edges: Ints,
    first: Ints,
    second: Ints,
    offset: Numbers,
    precision: Numbers,
    misfit: Numbers,
    stage: Numbers,
    place: Numbers,
    placed: Flags,
    expected: Numbers,
    prior: Numbers,
    most_cost: float,
    near: float,
    proposals: Numbers,
    picks: Ints,
    found: Numbers,
) -> None:
    """Find the best place of a field among those that its neighbours propose; found: x, y and the log odds.

    prior: inverse covariance of the place about the expected one; most_cost: of an overlap; near: smallest distance of
    another place; proposals: room for x, y and cost, [p, 3]; picks: room for the candidates that fit them best, [p, m].
    """
    xx0, xy0, yy0 = prior[0, 0], prior[0, 1], prior[1, 1]
    proposals[0, 0], proposals[0, 1] = expected[0], expected[1]
    n = 1
    for m in range(edges.size):
        e = edges[m]
        other = first[e] + second[e] - field
        if placed[other]:
            sign = 1.0 if second[e] == field else -1.0
            base_x = place[other, 0] + stage[field, 0] - stage[other, 0] - expected[0]
            base_y = place[other, 1] + stage[field, 1] - stage[other, 1] - expected[1]
            for k in range(misfit.shape[1]):
                if misfit[e, k] < 1e6:
                    dx, dy = base_x + sign * offset[e, k, 0], base_y + sign * offset[e, k, 1]
                    xx, xy, yy = precision[e, k, 0], precision[e, k, 1], precision[e, k, 2]
                    gx, gy = xx * dx + xy * dy, xy * dx + yy * dy
                    a, b, c = xx0 + xx, xy0 + xy, yy0 + yy
                    det = a * c - b * b
                    proposals[n, 0] = expected[0] + (c * gx - b * gy) / det
                    proposals[n, 1] = expected[1] + (a * gy - b * gx) / det
                    n += 1
    best = 0
    for p in range(n):
        dx, dy = proposals[p, 0] - expected[0], proposals[p, 1] - expected[1]
        cost = (xx0 * dx * dx + 2 * xy0 * dx * dy + yy0 * dy * dy) / 2
        for m in range(edges.size):
            e = edges[m]
            other = first[e] + second[e] - field
            picks[p, m] = 0
            if placed[other]:
                sign = 1.0 if second[e] == field else -1.0
                sx = sign * (proposals[p, 0] - place[other, 0] - stage[field, 0] + stage[other, 0])
                sy = sign * (proposals[p, 1] - place[other, 1] - stage[field, 1] + stage[other, 1])
                least = most_cost
                for k in range(misfit.shape[1]):
                    if misfit[e, k] < least:
                        rx, ry = sx - offset[e, k, 0], sy - offset[e, k, 1]
                        off = precision[e, k, 0] * rx * rx + 2 * precision[e, k, 1] * rx * ry
                        off += precision[e, k, 2] * ry * ry
                        if off / 2 + misfit[e, k] < least:
                            least = off / 2 + misfit[e, k]
                            picks[p, m] = k + 1
                cost += least
        proposals[p, 2] = cost
        if cost < proposals[best, 2]:
            best = p
    rival = 1e9
    for p in range(n):
        differs = False
        for m in range(edges.size):
            differs = differs or picks[p, m] != picks[best, m]
        far = abs(proposals[p, 0] - proposals[best, 0]) > near or abs(proposals[p, 1] - proposals[best, 1]) > near
        if differs and far and proposals[p, 2] < rival:
            rival = proposals[p, 2]
    found[0], found[1], found[2] = proposals[best, 0], proposals[best, 1], rival - proposals[best, 2]


def _chosen(placing: _Placing, shifts: Shifts, pixel_um: float) -> Choice:
    """Return which overlaps are to be measured at the places of sure fields, and doubt the other patterns."""
    graph, scatter = placing.graph, float(np.sqrt(np.mean(placing.scatter**2)))
    refused = scatter > CHOICE.most_of_pitch * graph.spacing_px and graph.decided_by_pictures < CHOICE.decides_nats
    sure = placing.placed & (placing.odds > CHOICE.sure_nats) & (not refused)
    moved = placing.place - placing.stage
    expected = moved[shifts.second] - moved[shifts.first]
    between = sure[shifts.first] & sure[shifts.second]
    repeats = shifts.repeats
    at = np.column_stack((shifts.x_um, shifts.y_um)) / pixel_um
    is_measured = repeats & shifts.believed & (np.abs(at - expected).max(axis=1) < CHOICE.near_px)
    looks_open = np.isin(shifts.doubt, (RejectionReason.AMBIGUOUS, RejectionReason.END_OF_SEARCH))
    doubt = np.where(repeats & ~(is_measured & between), np.uint8(RejectionReason.AMBIGUOUS), shifts.doubt)
    return Choice(
        replace(shifts, doubt=doubt.astype(np.uint8)),
        between & (repeats | looks_open) & ~is_measured,
        expected * pixel_um,
        sure,
        scatter * pixel_um,
        graph.spacing_px,
        bool(refused),
    )
