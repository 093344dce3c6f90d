"""Fields on their way to the places that all their overlaps and the stage together say.

Fields are placed one by one, the surest next; then all of them again in turn. What the errors of the stage have in
common is estimated along the way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.field_poses import Numbers
from wafer_viewer.numerics.jit import Int, Real, lean_kernel
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA
from wafer_viewer.reconstruct.pose_graph.bridge_arbitration import groups
from wafer_viewer.reconstruct.pose_graph.candidate_graph import CHOICE, CandidateGraph, Ints, joint_step
from wafer_viewer.reconstruct.pose_graph.pose_graph import N_SHARED, Flags, shared_effects

RELAXED_PX = (6.0, 2.0, 1.0)
"""Residuals at which overlaps have lost three quarters of their weight, when all fields are moved together, px."""
N_UNSETTLED = 4
"""Number of the shared errors of the stage that count while fields are placed for the first time."""


@dataclass(slots=True, eq=False)
class Placing:
    """Fields on their way to their places, in pixels.

    stage, place: [n, 2]; placed, fixed: masks; odds: log odds of a place against any other, [n]; shared_by: effect of
    the shared errors on a field, [n, 2, m]; shared, shared_covariance: what is known of them; scatter: of the stage
    along x and y about these, and usual_scatter beforehand; spacing_px: of the candidates; knows_scatter: whether the
    scatter was given.
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
    usual_scatter: float
    spacing_px: float
    knows_scatter: bool = False

    @classmethod
    def begin(cls, graph: CandidateGraph, stage: Numbers, fixed: Flags | None, start: Numbers | None) -> Placing:
        """Return fields of which only the fixed ones have a place."""
        n = len(stage)
        is_fixed = np.zeros(n, np.bool_) if fixed is None or start is None else fixed.copy()
        place = stage.copy()
        if start is not None:
            place[is_fixed] = start[is_fixed]
        spacing_px = graph.spacing_px
        usual = _usual_scatter(spacing_px, n)
        placing = cls(
            graph,
            stage,
            place,
            is_fixed.copy(),
            is_fixed,
            np.where(is_fixed, np.inf, 0.0),
            shared_effects(stage),
            np.zeros(N_SHARED),
            np.zeros((0, 0)),
            np.full(2, usual),
            usual,
            spacing_px,
        )
        placing.shared_covariance = np.diag(placing.shared_sigma(N_UNSETTLED) ** 2)
        return placing

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
        heap, at = _Heap.of(graph, n), self._surroundings()
        for field in np.flatnonzero(self.placed).tolist():
            _push_neighbours(heap, field, at)
        n_placed, n_refit = int(self.placed.sum()), 4
        while (last := _grow(heap, at, max(1, n_refit - n_placed))) >= 0:
            n_placed = max(n_placed + 1, n_refit)
            self._refit(N_UNSETTLED, with_scatter=False)
            n_refit, at = int(1.25 * n_placed) + 1, self._surroundings()
            _push_neighbours(heap, last, at)

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

    def sweep(self) -> None:
        """Place all fields again, with the scatter of the stage and its backlash, until none moves."""
        movable = np.flatnonzero(self.placed & ~self.fixed & (np.diff(self.graph.ends) > 0))
        if not len(movable):
            return
        for n in range(CHOICE.most_sweeps):
            self._refit(N_UNSETTLED if n == 0 else N_SHARED, with_scatter=True)
            before = self.place.copy()
            self._relax()
            _put_each(movable, self._surroundings())
            self._put_pairs()
            if n > 1 and np.abs(self.place - before).max(initial=0) < CHOICE.near_px / 2:
                break

    def _put_pairs(self) -> None:
        """Move pairs of neighbours by a period together where that is likelier, and limit their odds by it.

        An overlap that shows what is there once only holds both at each other, one by one wherever they are.
        """
        periods = self.graph.periods_px
        periods = periods[np.isfinite(periods).all(axis=1)]
        movable = self.placed & ~self.fixed
        pairs = np.flatnonzero(movable[self.graph.first] & movable[self.graph.second])
        _put_each_pair(pairs, np.concatenate((periods, -periods)), self._surroundings())

    def cost_nats(self) -> float:
        """Return minus the log likelihood of all places, apart from a constant."""
        return float(self._overlap_nats(self.graph).sum()) + self._stage_nats()

    def lines_nats(self) -> float:
        """Return the log odds of these places against those with every second row or column one period further.

        Infinite where fields are fixed: these hold the lines. Pictures that tell little of a period do not count: in
        very many overlaps, noise and what a pattern between binned pixels shows in all of them alike would add up.
        """
        if self.fixed.any():
            return np.inf
        odds = [np.inf]
        for axis, period in enumerate(self.graph.periods_px):
            for sign in (1.0, -1.0) if np.isfinite(period).all() else ():
                by_lines = self.shared_by[:, axis, N_UNSETTLED + axis]
                rival = replace(self, place=self.place + sign * by_lines[:, None] * period)
                rival._refit(N_SHARED, with_scatter=True)
                odds.append(self._odds_against(rival))
        return min(odds)

    def _odds_against(self, rival: Placing) -> float:
        lattice = self.graph.without_misfits()
        by_lattice = rival._overlap_nats(lattice) - self._overlap_nats(lattice)
        by_pictures = rival._overlap_nats(self.graph) - self._overlap_nats(self.graph) - by_lattice
        told = by_pictures[np.abs(by_pictures) > CHOICE.decides_nats]
        return float(by_lattice.sum() + told.sum()) + rival._stage_nats() - self._stage_nats()

    def _overlap_nats(self, graph: CandidateGraph) -> Numbers:
        """Return the cost of each overlap of placed fields, with the candidates of a graph of the same overlaps."""
        used = self.placed[graph.first] & self.placed[graph.second]
        moved = self.place - self.stage
        off = (moved[graph.second] - moved[graph.first])[used, None] - graph.offset[used]
        xx, xy, yy = np.moveaxis(graph.precision[used], -1, 0)
        misfit = (xx * off[..., 0] ** 2 + 2 * xy * off[..., 0] * off[..., 1] + yy * off[..., 1] ** 2) / 2
        return np.minimum((misfit + graph.misfit[used]).min(axis=1), CHOICE.most_overlap_nats)

    def _stage_nats(self) -> float:
        """Return the cost of the places beside the stage, and of its shared errors."""
        rest = ((self.place - self.stage - self.shared_by @ self.shared)[self.placed & ~self.fixed]) / self.scatter
        by_shared = np.sum((self.shared / self.shared_sigma(N_SHARED)) ** 2) / 2
        return float(np.sum(rest**2) / 2 + len(rest) * np.log(self.scatter).sum() + by_shared)

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
            off = moved[b] - moved[a]
            pick, distance = np.zeros(len(used), np.int64), np.zeros(len(used))
            _nearest(used, off, graph.offset, graph.precision, graph.misfit, pick, distance)
            weight = 1 / (1 + (distance / scale_px) ** 2) ** 2
            precision = weight[:, None] * graph.precision[used, pick]
            prior = (self.place - expected) / self.scatter**2
            self.place[free] += joint_step(
                (a, b), precision, off - graph.offset[used, pick], prior, self.scatter, free, self.stage
            )

    def _surroundings(self) -> _Surroundings:
        graph, by = self.graph, self.shared_by[:, :, : len(self.shared_covariance)]
        covariance = np.diag(self.scatter**2) + by @ self.shared_covariance @ np.swapaxes(by, 1, 2)
        most_edges = int(np.diff(graph.ends).max(initial=0))
        n_proposals = most_edges * graph.misfit.shape[1] + 1
        return _Surroundings(
            *(graph.ends, graph.edges, graph.first, graph.second, graph.offset, graph.precision, graph.misfit),
            *(self.stage, self.place, self.placed, self.odds),
            expected=self.stage + self.shared_by @ self.shared,
            prior=np.asarray(np.linalg.inv(covariance), np.float64),
            most_cost=CHOICE.most_overlap_nats,
            near=CHOICE.near_px,
            proposals=np.empty((n_proposals, 3)),
            picks=np.empty((n_proposals, most_edges), np.int64),
            found=np.zeros(3),
        )

    def shared_sigma(self, n_shared: int) -> Numbers:
        """Return the standard deviations of the shared errors.

        That of a backlash is limited by the pitch: one of most of a pitch would pass for a period.
        """
        backlash = min(CHOICE.backlash_px, CHOICE.backlash_of_pitch * self.spacing_px)
        sigma = (CHOICE.offset_px, CHOICE.offset_px, CHOICE.turn, CHOICE.turn, backlash, backlash)
        return np.array(sigma[:n_shared])

    def _refit(self, n_shared: int, with_scatter: bool) -> None:
        """Estimate the shared errors of the stage, and its scatter, from the placed fields."""
        used = self.placed
        off, by = (self.place - self.stage)[used], self.shared_by[used][:, :, :n_shared]
        flat = by.reshape(-1, n_shared)
        sigma, weight = self.shared_sigma(n_shared), np.ones(len(off))
        shared, normal = np.zeros(n_shared), np.diag(sigma**-2.0)
        for _ in range(5):
            weighted = flat.T * (weight[:, None] / self.scatter**2).ravel()
            normal = weighted @ flat + np.diag(sigma**-2.0)
            shared = np.linalg.solve(normal, weighted @ off.ravel())
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
        usual = CHOICE.usually * self.usual_scatter**2
        both = np.sqrt((freedom * found**2 + usual) / (freedom + CHOICE.usually))
        return np.maximum(both, CHOICE.least_scatter_px)


def _usual_scatter(spacing_px: float, n_fields: int) -> float:
    """Return the scatter of a stage that is expected beforehand, in pixels."""
    if n_fields < CHOICE.enough_fields:
        return CHOICE.scatter_px
    return min(CHOICE.scatter_px, CHOICE.scatter_of_pitch * spacing_px)


@lean_kernel
def _place(
    field: Int,
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


@lean_kernel
def _nearest(
    used: Ints, off: Numbers, offset: Numbers, precision: Numbers, misfit: Numbers, pick: Ints, distance: Numbers
) -> None:
    """Find the candidate next to an offset [u, 2] of each used overlap, and its distance in determined directions."""
    for n in range(used.size):
        e = used[n]
        distance[n] = np.inf
        for k in range(misfit.shape[1]):
            if misfit[e, k] < 1e6:
                x, y = off[n, 0] - offset[e, k, 0], off[n, 1] - offset[e, k, 1]
                xx, xy, yy = precision[e, k, 0], precision[e, k, 1], precision[e, k, 2]
                strongest = (xx + yy) / 2 + math.sqrt(((xx - yy) / 2) ** 2 + xy**2)
                far = max(xx * x * x + 2 * xy * x * y + yy * y * y, 0.0) / max(strongest, 1e-30)
                if far < distance[n]:
                    pick[n], distance[n] = k, far
        distance[n] = math.sqrt(distance[n])


class _Heap(NamedTuple):
    """Fields to be placed, the surest first: cost (minus the log odds) and field of each entry, and their number.

    latest: cost of the last entry of each field; earlier ones do not count.
    """

    cost: Numbers
    field: Ints
    size: Ints
    latest: Numbers

    @classmethod
    def of(cls, graph: CandidateGraph, n: int) -> _Heap:
        """Return an empty heap: each field is entered once for each of its overlaps at most."""
        room = len(graph.edges) + 1
        return cls(np.empty(room), np.empty(room, np.int64), np.zeros(1, np.int64), np.zeros(n))


class _Surroundings(NamedTuple):
    """Arguments of `_place` that all fields share: the fields of `CandidateGraph` and `Placing`, limits, and room.

    expected, prior: place by the stage and its inverse covariance, [n, 2] and [n, 2, 2].
    """

    ends: Ints
    edges: Ints
    first: Ints
    second: Ints
    offset: Numbers
    precision: Numbers
    misfit: Numbers
    stage: Numbers
    place: Numbers
    placed: Flags
    odds: Numbers
    expected: Numbers
    prior: Numbers
    most_cost: float
    near: float
    proposals: Numbers
    picks: Ints
    found: Numbers


@lean_kernel
def _put_each(fields: Ints, at: _Surroundings) -> None:
    """Put each field to its best place, one after the other."""
    for n in range(fields.size):
        _put(fields[n], at)


@lean_kernel
def _put_each_pair(pairs: Ints, moves: Numbers, at: _Surroundings) -> None:
    """Move both fields of each overlap by the best of some moves, [m, 2], if that is likelier."""
    for n in range(pairs.size):
        edge = int(pairs[n])
        a, b = int(at.first[edge]), int(at.second[edge])
        own = _cost_beside(a, b, 0.0, 0.0, at) + _cost_beside(b, a, 0.0, 0.0, at)
        best, least = 0, 1e9
        for m in range(moves.shape[0]):
            x, y = float(moves[m, 0]), float(moves[m, 1])
            cost = _cost_beside(a, b, x, y, at) + _cost_beside(b, a, x, y, at)
            if cost < least:
                best, least = m, cost
        odds = abs(least - own)
        at.odds[a], at.odds[b] = min(at.odds[a], odds), min(at.odds[b], odds)
        if least < own:
            for axis in range(2):
                at.place[a, axis] += moves[best, axis]
                at.place[b, axis] += moves[best, axis]


@lean_kernel
def _cost_beside(field: Int, beside: Int, move_x: Real, move_y: Real, at: _Surroundings) -> float:
    """Return the cost of a field where it lies, moved by (x, y), without its overlap with the field beside it."""
    x, y = at.place[field, 0] + move_x, at.place[field, 1] + move_y
    dx, dy, prior = x - at.expected[field, 0], y - at.expected[field, 1], at.prior[field]
    cost = (prior[0, 0] * dx * dx + 2 * prior[0, 1] * dx * dy + prior[1, 1] * dy * dy) / 2
    for m in range(at.ends[field], at.ends[field + 1]):
        e = int(at.edges[m])
        other = int(at.first[e] + at.second[e] - field)
        if other != beside and at.placed[other]:
            sign = 1.0 if at.second[e] == field else -1.0
            sx = sign * (x - at.place[other, 0] - at.stage[field, 0] + at.stage[other, 0])
            sy = sign * (y - at.place[other, 1] - at.stage[field, 1] + at.stage[other, 1])
            cost += _cost_of(e, sx, sy, at)
    return cost


@lean_kernel
def _cost_of(e: Int, off_x: Real, off_y: Real, at: _Surroundings) -> float:
    """Return the cost of an overlap at an offset."""
    least = at.most_cost
    for k in range(at.misfit.shape[1]):
        if at.misfit[e, k] < least:
            rx, ry = off_x - at.offset[e, k, 0], off_y - at.offset[e, k, 1]
            off = at.precision[e, k, 0] * rx * rx + 2 * at.precision[e, k, 1] * rx * ry
            off += at.precision[e, k, 2] * ry * ry
            least = min(least, off / 2 + at.misfit[e, k])
    return least


@lean_kernel
def _grow(heap: _Heap, at: _Surroundings, limit: int) -> Int:
    """Place up to `limit` fields, the surest next; return the last one, or -1 where no field is left.

    Its neighbours are not in the heap yet.
    """
    n_placed = 0
    while True:
        field = _popped(heap, at.placed)
        if field < 0:
            return -1
        _put(field, at)
        at.placed[field] = True
        n_placed += 1
        if n_placed == limit:
            return field
        _push_neighbours(heap, field, at)


@lean_kernel
def _push_neighbours(heap: _Heap, field: Int, at: _Surroundings) -> None:
    for n in range(at.ends[field], at.ends[field + 1]):
        edge = int(at.edges[n])
        other = int(at.first[edge] + at.second[edge] - field)
        if not at.placed[other]:
            _look(other, at)
            heap.latest[other] = -at.found[2]
            _push(heap, -at.found[2], other)


@lean_kernel
def _push(heap: _Heap, cost: Real, field: Int) -> None:
    at = heap.size[0]
    heap.size[0] += 1
    while at > 0:
        up = (at - 1) // 2
        if heap.cost[up] < cost or (heap.cost[up] == cost and heap.field[up] <= field):
            break
        heap.cost[at], heap.field[at] = heap.cost[up], heap.field[up]
        at = up
    heap.cost[at], heap.field[at] = cost, field


@lean_kernel
def _popped(heap: _Heap, placed: Flags) -> Int:
    """Take the cheapest entry that is the last one of a field without a place; return this field, or -1."""
    while heap.size[0] > 0:
        top_cost, top_field = heap.cost[0], heap.field[0]
        heap.size[0] -= 1
        n, at = int(heap.size[0]), 0
        cost, field = heap.cost[n], heap.field[n]
        while 2 * at + 1 < n:
            below = 2 * at + 1
            if below + 1 < n and _is_before(heap, below + 1, heap.cost[below], heap.field[below]):
                below += 1
            if not _is_before(heap, below, cost, field):
                break
            heap.cost[at], heap.field[at] = heap.cost[below], heap.field[below]
            at = below
        heap.cost[at], heap.field[at] = cost, field
        if not placed[top_field] and top_cost == heap.latest[top_field]:
            return top_field
    return -1


@lean_kernel
def _is_before(heap: _Heap, at: Int, cost: Real, field: Int) -> bool:
    return heap.cost[at] < cost or (heap.cost[at] == cost and heap.field[at] < field)


@lean_kernel
def _put(field: Int, at: _Surroundings) -> None:
    _look(field, at)
    at.place[field, 0], at.place[field, 1], at.odds[field] = at.found[0], at.found[1], at.found[2]


@lean_kernel
def _look(field: Int, at: _Surroundings) -> None:
    _place(
        field,
        at.edges[at.ends[field] : at.ends[field + 1]],
        at.first,
        at.second,
        at.offset,
        at.precision,
        at.misfit,
        at.stage,
        at.place,
        at.placed,
        at.expected[field],
        at.prior[field],
        at.most_cost,
        at.near,
        at.proposals,
        at.picks,
        at.found,
    )
