"""Fields on their way to the places that all their overlaps and the stage together say.

Fields are placed one by one, the surest next; then all of them again in turn. What the errors of the stage have in
common is estimated along the way.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.field_poses import Numbers
from wafer_viewer.numerics.jit import lean_kernel
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA
from wafer_viewer.reconstruct.pose_graph.bridge_arbitration import groups
from wafer_viewer.reconstruct.pose_graph.candidate_graph import CHOICE, CandidateGraph, Ints, distance_px
from wafer_viewer.reconstruct.pose_graph.pose_graph import Flags

RELAXED_PX = (6.0, 2.0, 1.0)
"""Residuals at which overlaps have lost three quarters of their weight, when all fields are moved together, px."""
N_SHARED = 6
"""Number of shared errors of the stage: offset along x and y, scale, turn, backlash of rows and of columns."""
N_UNSETTLED = 4
"""Number of these that count while fields are placed for the first time."""


@dataclass(slots=True, eq=False)
class Placing:
    """Fields on their way to their places, in pixels.

    stage, place: [n, 2]; placed, fixed: masks; odds: log odds of a place against any other, [n]; shared_by: effect of
    the shared errors on a field, [n, 2, m]; shared, shared_covariance: what is known of them; scatter: of the stage
    along x and y about these; knows_scatter: whether it was given.
    """

    graph: CandidateGraph
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
    def begin(cls, graph: CandidateGraph, stage: Numbers, fixed: Flags | None, start: Numbers | None) -> Placing:
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
        if not len(movable):
            return
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
            distance = np.where(np.isfinite(graph.misfit[used]), distance_px(graph.precision[used], off), np.inf)
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
        shared, normal = np.zeros(n_shared), np.diag(sigma**-2.0)
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
        self.shared_covariance = np.asarray(np.linalg.inv(normal), np.float64)

    def _scatter_of(self, rest: Numbers, freedom: float) -> Numbers:
        """Return the scatter of the stage from what its shared errors leave, with that expected beforehand."""
        found = MAD_TO_SIGMA * np.median(np.abs(rest), axis=0) * np.sqrt(len(rest) / freedom)
        usual = _usual_scatter(self.graph, len(self.stage))
        both = np.sqrt((freedom * found**2 + CHOICE.usually * usual**2) / (freedom + CHOICE.usually))
        return np.maximum(both, CHOICE.least_scatter_px)


def _usual_scatter(graph: CandidateGraph, n_fields: int) -> float:
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
