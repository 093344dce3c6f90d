"""Spatial index for intersections of axis-parallel rectangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wafer_viewer.numerics.jit import Float64s, Int64s


@dataclass(frozen=True, slots=True, eq=False)
class Rectangles:
    """Rectangles float64 [n] by their borders, indexed by the cell of their upper left corner.

    A cell is as large as the largest rectangle, so one that contains a point starts in its cell or in the previous one.
    Rectangles of NaN are ignored.
    """

    top: Float64s
    bottom: Float64s
    left: Float64s
    right: Float64s
    cell: tuple[float, float]
    keys: Int64s
    order: Int64s

    @classmethod
    def of(cls, top: Float64s, bottom: Float64s, left: Float64s, right: Float64s) -> Rectangles:
        """Return the rectangles with these borders, inclusive row and column numbers."""
        placed = np.flatnonzero(np.isfinite(top + left))
        tallest, widest = (float(np.max((b - a)[placed], initial=0.0)) + 1 for a, b in ((top, bottom), (left, right)))
        keys = _keys(np.floor(top[placed] / tallest), np.floor(left[placed] / widest))
        order = np.argsort(keys, kind="stable")
        return cls(top, bottom, left, right, (tallest, widest), keys[order], placed[order])

    def intersecting(self, top: float, bottom: float, left: float, right: float) -> list[int]:
        """Return the indices of the rectangles that intersect a window, ascending."""
        rows = np.arange(np.floor(top / self.cell[0]) - 1, np.floor(bottom / self.cell[0]) + 1)
        first = np.searchsorted(self.keys, _keys(rows, np.floor(left / self.cell[1]) - 1))
        last = np.searchsorted(self.keys, _keys(rows, np.floor(right / self.cell[1])), "right")
        near = np.concatenate([self.order[a:b] for a, b in zip(first, last, strict=True)])
        meets = (self.top[near] <= bottom) & (self.bottom[near] >= top)
        meets &= (self.left[near] <= right) & (self.right[near] >= left)
        return sorted(near[meets].tolist())

    def pairs(self) -> tuple[Int64s, Int64s]:
        """Return the indices of all intersecting pairs, each pair once."""
        rows, cols = np.floor(self.top[self.order] / self.cell[0]), np.floor(self.left[self.order] / self.cell[1])
        found = [
            self._pairs_in_cells(_keys(rows + down, cols + right)) for down, right in ((0, 1), (1, -1), (1, 0), (1, 1))
        ]
        found.append(self._pairs_in_own_cell())
        a, b = (np.concatenate([pair[side] for pair in found]) for side in (0, 1))
        meets = (self.top[a] <= self.bottom[b]) & (self.top[b] <= self.bottom[a])
        meets &= (self.left[a] <= self.right[b]) & (self.left[b] <= self.right[a])
        return a[meets], b[meets]

    def _pairs_in_cells(self, keys: Int64s) -> tuple[Int64s, Int64s]:
        """Pair each rectangle with all those in the cell of its key."""
        return self._with(np.searchsorted(self.keys, keys), np.searchsorted(self.keys, keys, "right"))

    def _pairs_in_own_cell(self) -> tuple[Int64s, Int64s]:
        """Pair each rectangle with the later ones in its own cell."""
        return self._with(np.arange(1, self.keys.size + 1), np.searchsorted(self.keys, self.keys, "right"))

    def _with(self, start: Int64s, stop: Int64s) -> tuple[Int64s, Int64s]:
        """Pair each rectangle with those from `start` up to `stop`, in the order of their cells."""
        n = stop - start
        first = np.repeat(np.arange(n.size), n)
        second = np.arange(first.size) - np.repeat(np.cumsum(n) - n, n) + np.repeat(start, n)
        return self.order[first], self.order[second]


def _keys(rows: Float64s, cols: Float64s | float) -> Int64s:
    """Return one number per cell, ascending along its row and then from row to row."""
    return (np.asarray(rows) * 2.0**31 + cols).astype(np.int64)
