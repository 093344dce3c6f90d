"""Line geometry of the field and overlap layer in the plane, in um, before it is draped on a surface. Pure.

Pieces are straight, float64 [n, 2, 2]: start and end, x and y.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.field_poses import Poses, RejectionReason

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LONG, _WIDE = 0.55, 0.25
"""Limits for the 90th percentile of arrow lengths and circle radii, as fractions of a field's shorter side."""
_MOST_TIMES = 1000.0
_HEAD = 0.07
_TURN = np.linspace(0, 2 * np.pi, 25)
_LEAST_CIRCLE, _MOST_CIRCLE = 0.012, 0.45
STITCH = 0.15
"""Length of the line across an overlap, as a fraction of a field's shorter side."""
_INSET = 0.14
"""Inset of an overlap's frame, as a fraction of its shorter side."""


class Fields:
    """Field frames of equal size at their solved positions, boxes [n, 4] as x low, y low, x high, y high.

    every: only each n-th of very many fields is drawn, in addition to all excluded fields.
    """

    def __init__(self, poses: Poses, width_um: float, height_um: float, most: int = 4000) -> None:
        self.poses = poses
        self.unit_um = min(width_um, height_um)
        x, y = poses.x_um, poses.y_um
        half = width_um / 2, height_um / 2
        self.boxes: Floats = np.stack([x - half[0], y - half[1], x + half[0], y + half[1]], axis=1)
        self.every = max(1, math.ceil(len(x) / most))
        self.kept: Mask = ~poses.left_out & (np.arange(len(x)) % self.every == 0)
        self.times = self._times()

    def _times(self) -> float:
        """Return the magnification of arrows and circles: 1, 2 or 5 times a power of ten, limited by the field size."""
        poses, there = self.poses, ~self.poses.left_out
        moved, u_um = np.hypot(*self._moved(there)), 2 * np.maximum(poses.u_x_um, poses.u_y_um)[there]
        u_um = u_um[np.isfinite(u_um)]
        shares = [float(np.percentile(um, 90)) / room for um, room in ((moved, _LONG), (u_um, _WIDE)) if len(um)]
        largest = max(shares, default=0.0)
        return min(_MOST_TIMES, round_below(self.unit_um / largest)) if moved.any() and largest > 0 else 1.0

    def _moved(self, which: Mask) -> tuple[Floats, Floats]:
        poses = self.poses
        return (poses.x_um - poses.stage_x_um)[which], (poses.y_um - poses.stage_y_um)[which]

    # ---------------------------------------------------------------- fields

    def outlines(self) -> Floats:
        """Return the frames of the included fields."""
        return sides(self.boxes[self.kept])

    def left_out(self) -> Floats:
        """Return the crosses through the excluded fields."""
        x0, y0, x1, y1 = self.boxes[self.poses.left_out].T
        rising, falling = np.stack([x0, y0, x1, y1], axis=1), np.stack([x0, y1, x1, y0], axis=1)
        return np.concatenate([rising, falling]).reshape(-1, 2, 2)

    def left_out_frames(self) -> Floats:
        """Return the frames of the excluded fields."""
        return sides(self.boxes[self.poses.left_out])

    # ---------------------------------------------------------------- from the stage's place to the solved one

    def arrows(self) -> Floats:
        """Return arrows with heads from stage to solved positions, magnified by `times`: [n, 3, 2, 2]."""
        tails = np.stack([self.poses.stage_x_um, self.poses.stage_y_um], axis=1)[self.kept]
        way = np.stack(self._moved(self.kept), axis=1) * self.times
        long = np.hypot(way[:, 0], way[:, 1])
        seen = long > _LEAST_CIRCLE * self.unit_um
        tails, way, long = tails[seen], way[seen], long[seen, None]
        along = way / long
        beside = along[:, ::-1] * (-1.0, 1.0)
        head, tips = np.minimum(0.4 * long, _HEAD * self.unit_um), tails + way
        barbs = [tips - head * (along + side * beside) for side in (0.5, -0.5)]
        return np.stack([_pieces(tails, tips), *(_pieces(tips, barb) for barb in barbs)], axis=1)

    def circles(self) -> Floats:
        """Return the expanded uncertainties (k = 2), magnified by `times`, around the arrow tips: [n, 24, 2, 2]."""
        poses = self.poses
        tips = np.stack([poses.stage_x_um, poses.stage_y_um], axis=1)[self.kept]
        tips = tips + np.stack(self._moved(self.kept), axis=1) * self.times
        radii = 2 * self.times * np.stack([poses.u_x_um, poses.u_y_um], axis=1)[self.kept]
        seen = np.isfinite(radii).all(axis=1) & (radii.max(axis=1) > _LEAST_CIRCLE * self.unit_um)
        radii = np.minimum(radii[seen], _MOST_CIRCLE * self.unit_um)
        round_ = np.stack([np.cos(_TURN), np.sin(_TURN)], axis=1)
        rims = tips[seen, None] + radii[:, None] * round_
        return np.stack([rims[:, :-1], rims[:, 1:]], axis=2)

    # ---------------------------------------------------------------- overlaps

    def stitches(self) -> Floats:
        """Return a short line across each accepted overlap, from field to field."""
        first, second = self._pairs(self.poses.shifts.believed)
        between = self._centres(second) - self._centres(first)
        along = between / np.maximum(np.hypot(between[:, 0], between[:, 1]), 1e-9)[:, None]
        middle, half = (self._centres(first) + self._centres(second)) / 2, STITCH / 2 * self.unit_um
        return _pieces(middle - half * along, middle + half * along)

    def doubted(self, blank: bool) -> Floats:
        """Return boxes of the rejected overlaps: the blank ones (`blank`), or those with another reason."""
        doubt = self.poses.shifts.doubt
        which = (
            doubt == RejectionReason.BLANK
            if blank
            else (doubt != RejectionReason.NONE) & (doubt != RejectionReason.BLANK)
        )
        return self.overlaps(which)

    def overlaps(self, which: Mask) -> Floats:
        """Return the common areas of overlapping fields, slightly inset; [n, 4], without empty ones."""
        a, b = (self.boxes[k] for k in self._pairs(which))
        low, high = np.maximum(a[:, :2], b[:, :2]), np.minimum(a[:, 2:], b[:, 2:])
        short = (high - low).min(axis=1, keepdims=True)
        boxes = np.concatenate([low + _INSET * short, high - _INSET * short], axis=1)
        return boxes[short[:, 0] > 0]

    def _pairs(self, which: Mask) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Return first and second fields of the selected overlaps, without those of excluded fields."""
        shifts = self.poses.shifts
        which = which & ~self.poses.left_out[shifts.first] & ~self.poses.left_out[shifts.second]
        which = which & (self.kept[shifts.first] | self.kept[shifts.second])
        return shifts.first[which], shifts.second[which]

    def _centres(self, k: NDArray[np.int32]) -> Floats:
        return np.stack([self.poses.x_um[k], self.poses.y_um[k]], axis=1)


def round_below(value: float) -> float:
    """Return the largest of 1, 2, 5, 10, 20 … that does not exceed a value; at least 1."""
    if value < 1:
        return 1.0
    ten = 10.0 ** math.floor(math.log10(value))
    return ten * max(step for step in (1.0, 2.0, 5.0) if step * ten <= value * (1 + 1e-9))


def sides(boxes: Floats) -> Floats:
    """Return the four sides of boxes [n, 4] as pieces [4 n, 2, 2]."""
    x0, y0, x1, y1 = boxes.T
    corners = np.stack([np.stack(c, axis=1) for c in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))], axis=1)
    return np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 2)


def in_dashes(pieces: Floats, dash_um: float, share: float = 0.55) -> Floats:
    """Return pieces in dashes. Each is divided into full periods, so that a dash begins at every corner."""
    counts = np.maximum(1, np.round(np.hypot(*(pieces[:, 1] - pieces[:, 0]).T) / dash_um)).astype(int)
    of = np.repeat(np.arange(len(pieces)), counts)
    place = np.arange(len(of)) - np.repeat(np.cumsum(counts) - counts, counts)
    begin, way = pieces[of, 0], pieces[of, 1] - pieces[of, 0]
    first, last = (((place + end) / counts[of])[:, None] for end in (0.0, share))
    return _pieces(begin + way * first, begin + way * last)


def _pieces(begin: Floats, end: Floats) -> Floats:
    return np.stack([begin, end], axis=1)
