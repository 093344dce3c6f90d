"""Incremental pose estimation: reuse of an earlier solution, and selection of fields to be redrawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.field_poses import HeightOffsets, Poses, RejectionReason, Shifts, joined, selected
from wafer_viewer.reconstruct.registration.pair_registration import with_own_drift

Pairs = NDArray[np.int32]
T = TypeVar("T", Shifts, HeightOffsets)
A = TypeVar("A", np.float64, np.bool_)
STILL_PX = 0.1
"""Lateral move, in pixels, below which a field is not redrawn."""
STILL_UM = 0.01
"""Height change, at the most affected corner of a field, below which it is not redrawn.

It is below the repeatability of any height.
"""
POSE = ("x_um", "y_um", "z_um", "tilt_x", "tilt_y")


@dataclass(frozen=True, slots=True, eq=False)
class PreviousSolution:
    """Earlier solution mapped to the current list of fields, all [n_fields].

    row: index of each field in the earlier list, -1 where it is new or its surface was recomputed; poses: the earlier
    ones.
    """

    row: NDArray[np.intp]
    poses: Poses | None

    @classmethod
    def of(cls, poses: Poses | None, numbers: NDArray[np.int32], marks: NDArray[np.int64]) -> PreviousSolution:
        """Map earlier poses to fields with the given surface marks."""
        if poses is None or poses.numbers.size == 0:
            return cls(np.full(len(numbers), -1), poses)
        order = np.argsort(poses.numbers)
        position = np.minimum(np.searchsorted(poses.numbers, numbers, sorter=order), len(order) - 1)
        row = order[position]
        same = (poses.numbers[row] == numbers) & (poses.marks[row] == marks)
        return cls(np.where(same, row, -1), poses)

    @property
    def unchanged(self) -> NDArray[np.bool_]:
        """Mask of the unchanged fields."""
        return self.row >= 0

    def earlier(self, name: str, without: NDArray[A]) -> NDArray[A]:
        """Return a quantity of the earlier poses, `without` where a field has none."""
        if self.poses is None or not self.unchanged.any():
            return without
        return np.where(self.unchanged, getattr(self.poses, name)[self.row], without)

    def stale(self, moved: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Return the rows of the earlier list to hide: fields that moved, changed or were removed."""
        n_before = 0 if self.poses is None else self.poses.numbers.size
        return np.setdiff1d(np.arange(n_before), self.row[self.unchanged & ~moved])

    def shifts(self, pairs: Pairs, observe: Callable[[Pairs], Shifts]) -> Shifts:
        """Return the lateral shifts of overlaps; only changed overlaps are measured again."""
        return self._and(pairs, observe, None if self.poses is None else _as_measured(self.poses.shifts))

    def seams(self, pairs: Pairs, observe: Callable[[Pairs], HeightOffsets]) -> HeightOffsets:
        """Return the height offsets of overlaps, reusing those between unchanged fields."""
        return self._and(pairs, observe, None if self.poses is None else _unsolved(self.poses.seams))

    def _and(self, pairs: Pairs, observe: Callable[[Pairs], T], earlier: T | None) -> T:
        if earlier is None or earlier.first.size == 0:
            return observe(pairs)
        n, first, second = len(self.row), self._now(earlier.first), self._now(earlier.second)
        wanted, known_pairs = _keys(pairs[:, 0], pairs[:, 1], n), _keys(first, second, n)
        of_use = (first >= 0) & (second >= 0) & np.isin(known_pairs, wanted)
        reused = replace(selected(earlier, of_use), first=first[of_use], second=second[of_use])
        new = ~np.isin(wanted, known_pairs[of_use])
        return joined([reused, observe(pairs[new])]) if new.any() else reused

    def _now(self, rows: NDArray[np.int32]) -> NDArray[np.int32]:
        """Convert earlier indices to current ones, -1 for fields that were removed or recomputed."""
        n_before = 0 if self.poses is None else self.poses.numbers.size
        place = np.full(n_before, -1, np.int32)
        place[self.row[self.unchanged]] = np.flatnonzero(self.unchanged)
        return place[rows]


def _keys(first: NDArray[np.int32], second: NDArray[np.int32], n: int) -> NDArray[np.int64]:
    """Return a unique number for each pair of n fields."""
    return first.astype(np.int64) * n + second


def _as_measured(shifts: Shifts) -> Shifts:
    """Restore shifts as measured: the overlaps that they disagree with, or share the drift with, may have changed."""
    doubt = np.where(shifts.doubt == RejectionReason.DISAGREES, np.uint8(RejectionReason.NONE), shifts.doubt)
    return with_own_drift(replace(shifts, doubt=doubt.astype(np.uint8)))


def _unsolved(seams: HeightOffsets) -> HeightOffsets:
    """Restore the offsets of `height_seams.compare`, without the residual step of a solution."""
    return replace(seams, rms_um=np.sqrt(np.maximum(seams.rms_um**2 - seams.step_um**2, 0)), step_um=seams.z_um)


def freeze_unmoved_fields(
    poses: Poses, previous: PreviousSolution, pixel_um: float, corner_um: float
) -> tuple[Poses, NDArray[np.bool_]]:
    """Restore the drawn poses of fields that hardly moved, and return which fields are to be redrawn.

    corner_um: from the centre of a field to its corner.
    """
    if previous.poses is None:
        return poses, np.ones(poses.numbers.size, bool)
    before = {name: previous.earlier(name, getattr(poses, name)) for name in POSE}
    change = {name: getattr(poses, name) - before[name] for name in POSE}
    away_px = np.hypot(change["x_um"], change["y_um"]) / pixel_um
    higher_um = np.abs(change["z_um"]) + corner_um * np.hypot(change["tilt_x"], change["tilt_y"])
    turned_up = poses.left_out != previous.earlier("left_out", poses.left_out)
    moved = ~previous.unchanged | (away_px > STILL_PX) | (higher_um > STILL_UM) | turned_up
    frozen = {name: np.where(moved, getattr(poses, name), before[name]) for name in POSE}
    return replace(poses, **frozen), moved
