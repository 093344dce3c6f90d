"""Estimation of lateral drift, and of a magnification that changes with focus.

All displacement measurements of all tiles are solved at once by robust least squares (Cauchy weights), so that errors
do not accumulate from frame to frame. Frames without sharp content follow the measured ones, at a constant rate if the
drift is steady. All frames are registered to their mean, as is usual where a lens focuses by moving.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.reconstruct.preprocess.frame_motion import Sightings

LEAST_DRIFT_PX = 0.5
"""Smaller drift is not corrected; growth is judged by its rms displacement over the field."""
LEAST_TILES = 4
"""Fewer tiles cannot distinguish motion from light that bends round an edge."""
STEADY_SHARE = 0.25
"""Minimum fraction of frames that must show the drift rate before it is extrapolated."""

_ROUNDS = 8
_SCATTER_PX = 0.05
_SHIFT_TIE, _GROWTH_TIE = 1e-3, 0.1
_RIGID = 1e6
_SURE_ERRORS = 3.0
_MEAN_OVER_FIELD = 3**-0.5
"""Ratio of the rms distance from the middle of a rectangle to that of its corner."""

Floats = NDArray[np.float64]
Wholes = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """Drift of the frames: a field point p, from the middle, lies at exp(growth[k]) p + shift_px[k] in frame k.

    Coordinates are (rows, cols). shape: (rows, cols) of the field; corner: position of the first pixel read in the
    field (not 0 for a part of a field).
    """

    shift_px: Floats
    growth: Floats
    shape: tuple[int, int]
    corner: tuple[int, int] = (0, 0)

    def places(self, k: int, axis: int, first: int, stop: int) -> Floats:
        """Return the positions in frame k of the field's rows (axis 0) or columns (1) from first to stop - 1."""
        middle = (self.shape[axis] - 1) / 2 - self.corner[axis]
        return middle + np.exp(self.growth[k]) * (np.arange(first, stop) - middle) + self.shift_px[k, axis]

    def covered(self, axis: int, length: int) -> slice:
        """Return the range of the first `length` rows or columns that is covered by every frame."""
        there = np.array([self.places(k, axis, 0, length) for k in range(len(self.growth))]) + self.corner[axis]
        seen = np.flatnonzero(((there > -0.5) & (there < self.shape[axis] - 0.5)).all(axis=0))
        return slice(int(seen[0]), int(seen[-1]) + 1) if seen.size else slice(0, 0)


def drift_of(seen: Sightings, n_frames: int, shape: tuple[int, int]) -> Drift | None:
    """Estimate the drift from tile displacements; None if it is below half a pixel or undetermined.

    Shift and growth are judged separately, each over runs of frames that are connected by sharp tiles.
    """
    seen = _agreed(seen, n_frames)
    radius_px = float(np.hypot(*shape)) / 2
    free = _solve(seen, n_frames, radius_px, _GROWTH_TIE)
    grows = _least_extent(free, seen, [2]) * _MEAN_OVER_FIELD > LEAST_DRIFT_PX
    rigid = free if grows else _solve(seen, n_frames, radius_px, _RIGID)
    shifts = _least_extent(rigid, seen, [0, 1]) > LEAST_DRIFT_PX
    if not grows and not shifts:
        return None
    return Drift(rigid.moves[:, :2] * shifts, rigid.moves[:, 2] / radius_px * grows, shape)


def drift_note(drift: Drift, pixel_um: float) -> str:
    """Return a one-sentence note on the drift."""
    shift = float(np.hypot(*np.ptp(drift.shift_px, axis=0)))
    growth = float(np.ptp(drift.growth))
    shifts = f"the picture shifts by {shift:.1f} px ({shift * pixel_um:.2f} um)" if shift > 0 else ""
    grows = f"its magnification changes by {growth:.2%}" if growth > 0 else ""
    both = " and ".join(part for part in (shifts, grows) if part)
    return f"{both[0].upper()}{both[1:]} through the stack: its frames were put right."


def _agreed(seen: Sightings, n_frames: int) -> Sightings:
    """Return the measurements of frame pairs with enough tiles."""
    _, of_pair, count = np.unique(seen.first * n_frames + seen.second, return_inverse=True, return_counts=True)
    return seen.where(count[of_pair] >= LEAST_TILES) if len(seen) else seen


def _runs(seen: Sightings, n_frames: int) -> list[Wholes]:
    """Return the sets of frames connected by measurements, directly or through others."""
    label = np.arange(n_frames)
    for a, b in np.unique(np.stack([seen.first, seen.second], axis=1), axis=0):
        label[label == label[b]] = label[a]
    runs = [np.flatnonzero(label == one) for one in np.unique(label)]
    return [run for run in runs if len(run) > 1]


def _least_extent(solved: _Solved, seen: Sightings, axes: list[int]) -> float:
    """Return a lower bound of the drift range: the largest range minus three jackknife standard errors.

    The jackknife leaves out one tile at a time. Tiles on the two sides of a trench, whose light moves to the two sides
    with defocus, disagree.
    """
    surely = 0.0
    for run in _runs(seen, len(solved.moves)):
        path = solved.moves[run][:, axes]
        ends = run[[path.sum(axis=1).argmin(), path.sum(axis=1).argmax()]]
        without = np.array([one[ends[1]] - one[ends[0]] for one in solved.without])[:, axes]
        spread = without - without.mean(axis=0)
        error = np.sqrt((len(without) - 1) / len(without) * (spread**2).sum())
        surely = max(surely, float(np.hypot.reduce(np.ptp(path, axis=0)) - _SURE_ERRORS * error))
    return surely


def _solve(seen: Sightings, n_frames: int, radius_px: float, growth_tie: float) -> _Solved:
    """Estimate the moves of the frames, and the moves without each of the tiles.

    Each measurement states moves[second] - moves[first] = moved - growth x place. Its place is taken halfway between
    the two frames and relative to the moved middle of the field, so that growth adds up as a logarithm.
    """
    moves = np.zeros((n_frames, 3))
    if not len(seen):
        return _Solved(moves, [])
    problem = _Problem.of(seen, n_frames, np.array([_SHIFT_TIE, _SHIFT_TIE, growth_tie]))
    pace, trust, rows = np.zeros(3), seen.weight, _rows(seen, moves, radius_px)
    for n in range(_ROUNDS):
        moves = problem.moves(rows, trust, pace)
        rows = _rows(seen, moves, radius_px)
        off = seen.moved_px - np.einsum("nab,nb->na", rows, moves[seen.second] - moves[seen.first])
        far = np.hypot(off[:, 0], off[:, 1])
        trust = seen.weight / (1 + (far / max(_SCATTER_PX, 1.4826 * float(np.median(far)))) ** 2)
        if n >= _ROUNDS // 2:
            pace = problem.pace(moves)
    without = [problem.moves(rows, trust * (seen.tile != tile), pace) for tile in np.unique(seen.tile)]
    return _Solved(moves, without)


def _rows(seen: Sightings, moves: Floats, radius_px: float) -> Floats:
    """Return the two equations of each measurement: [n, (rows, cols), (rows, cols, growth)]."""
    carried = (moves[seen.first, :2] + moves[seen.second, :2]) / 2
    rows = np.zeros((len(seen), 2, 3))
    rows[:, 0, 0] = rows[:, 1, 1] = 1
    rows[:, :, 2] = (seen.at_px + seen.moved_px / 2 - carried) / radius_px
    return rows


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    """Moves [k, (rows, cols, growth)] in px, growth at the corner; the mean over measured frames is 0."""

    moves: Floats
    without: list[Floats]


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """Least squares over the measured frames, `tied`; others are interpolated or follow the common rate."""

    seen: Sightings
    n_frames: int
    tied: Wholes
    first: Wholes
    second: Wholes
    tie: Floats

    @classmethod
    def of(cls, seen: Sightings, n_frames: int, tie: Floats) -> _Problem:
        tied, places = np.unique(np.concatenate([seen.first, seen.second]), return_inverse=True)
        first, second = np.split(places, 2)
        return cls(seen, n_frames, tied, first, second, tie)

    def moves(self, rows: Floats, trust: Floats, pace: Floats) -> Floats:
        """Return the moves of all frames; neighbours are weakly tied to the common rate."""
        n, gaps = len(self.tied), np.diff(self.tied)
        normal, right = np.zeros((n, n, 3, 3)), np.zeros((n, 3))
        one = np.einsum("n,nab,nac->nbc", trust, rows, rows)
        moved = np.einsum("n,nab,na->nb", trust, rows, self.seen.moved_px)
        k, loose = np.arange(n - 1), self.tie / gaps[:, None]
        between = loose[:, :, None] * np.eye(3), self.tie * np.tile(pace, (n - 1, 1))
        for first, second, matrix, side in ((self.first, self.second, one, moved), (k, k + 1, *between)):
            for a, b, sign in ((first, first, 1), (second, second, 1), (first, second, -1), (second, first, -1)):
                np.add.at(normal, (a, b), sign * matrix)
            np.add.at(right, second, side)
            np.add.at(right, first, -side)
        normal[0, 0] += np.eye(3)
        tied = np.linalg.solve(normal.transpose(0, 2, 1, 3).reshape(3 * n, 3 * n), right.ravel()).reshape(n, 3)
        return self._all(tied - tied.mean(axis=0), pace)

    def pace(self, moves: Floats) -> Floats:
        """Return the median motion between consecutive measured frames, 0 if too few are measured."""
        near = self.tied[:-1][np.diff(self.tied) == 1]
        if len(near) < STEADY_SHARE * self.n_frames:
            return np.zeros(3)
        return np.median(moves[near + 1] - moves[near], axis=0)

    def _all(self, tied: Floats, pace: Floats) -> Floats:
        k = np.arange(self.n_frames)
        between = np.stack([np.interp(k, self.tied, tied[:, i]) for i in range(3)], axis=1)
        beyond = k - k.clip(self.tied[0], self.tied[-1])
        return between + beyond[:, None] * pace
