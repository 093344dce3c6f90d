"""The coarse heights of the surface on show: what a click hits, how a line lies on it, where its plateaus are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.gui.contents import OnShow
from wafer_viewer.session.paint_request import Relief

Floats = NDArray[np.float64]
Place = tuple[float, float]
"""Stage x, y in um."""

_RAY_STEPS = 1500
_HALVINGS = 14
_PATCH_SHARES = (1 / 6, 1 / 9, 1 / 12, 1 / 18, 1 / 30)
"""Sides of the squares that plateaus are looked for with, largest first, as shares of the shorter side."""


class Land:
    """Heights of one surface, and how they are drawn. Places are stage um, rays are scene mm.

    holes: whether the ground is seen where nothing is measured.
    """

    def __init__(self, relief: Relief, on_show: OnShow, holes: bool = True) -> None:
        self._relief, self.on_show, self._holes = relief, on_show, holes
        shape = (relief.rows, relief.cols)
        self._z_um = np.frombuffer(relief.z_um, "<f4").reshape(shape)
        self._there = np.frombuffer(relief.there, bool).reshape(shape)

    @property
    def bounds_um(self) -> tuple[float, float, float, float]:
        """(x low, y low, x high, y high)."""
        r = self._relief
        return r.x0_um, r.y0_um - (r.rows - 1) * r.pixel_um, r.x0_um + (r.cols - 1) * r.pixel_um, r.y0_um

    def clamped(self, place: Place) -> Place:
        """The place, or the nearest on the surface; to a hundredth of a micrometre."""
        x0, y0, x1, y1 = self.bounds_um
        return round(min(max(place[0], x0), x1), 2), round(min(max(place[1], y0), y1), 2)

    def z_um(self, x_um: Floats, y_um: Floats) -> Floats:
        """Heights at places, bilinear; outside, those of the edge."""
        r = self._relief
        col = np.clip((np.asarray(x_um) - r.x0_um) / r.pixel_um, 0, r.cols - 1.001)
        row = np.clip((r.y0_um - np.asarray(y_um)) / r.pixel_um, 0, r.rows - 1.001)
        c, f = np.floor(col).astype(int), np.floor(row).astype(int)
        u, v, z = col - c, row - f, self._z_um
        return (z[f, c] * (1 - u) + z[f, c + 1] * u) * (1 - v) + (z[f + 1, c] * (1 - u) + z[f + 1, c + 1] * u) * v

    def measured(self, x_um: Floats, y_um: Floats) -> NDArray[np.bool_]:
        """Whether the pixel nearest to each place has a height."""
        r = self._relief
        col = np.clip(np.round((np.asarray(x_um) - r.x0_um) / r.pixel_um), 0, r.cols - 1).astype(int)
        row = np.clip(np.round((r.y0_um - np.asarray(y_um)) / r.pixel_um), 0, r.rows - 1).astype(int)
        return self._there[row, col]

    def seen_um(self, x_um: Floats, y_um: Floats) -> Floats:
        """What is seen at places: the surface, or the ground through a hole in it."""
        z = self.z_um(x_um, y_um)
        return np.where(self.measured(x_um, y_um), z, self.on_show.z0_um) if self._holes else z

    def scene_points(self, x_um: Floats, y_um: Floats, lift_mm: float = 0.0) -> NDArray[np.float32]:
        """Places on the drawn surface as scene points, float32 [n, 3]."""
        z = (self.z_um(x_um, y_um) - self.on_show.z0_um) * 1e-3 * self.on_show.stretch + lift_mm
        return np.stack([np.asarray(x_um) * 1e-3, np.asarray(y_um) * 1e-3, z], axis=1).astype(np.float32)

    def draped(self, a: Place, b: Place, lift_mm: float) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """A line from a to b on the surface as points [n, 3], and which of its pieces [n - 1] are measured.

        It runs over narrow pits instead of diving through their walls.
        """
        t = np.linspace(0, 1, 480)
        x, y = a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t
        points, there = self.scene_points(x, y, lift_mm), self.measured(x, y)
        padded = np.pad(points[:, 2], 2, mode="edge")
        points[:, 2] = np.max([padded[k : k + len(points)] for k in range(5)], axis=0)
        return points, there[:-1] & there[1:]

    def highest_um(self, x0: float, y0: float, x1: float, y1: float) -> float:
        """Nearly the highest height within a rectangle, a spike aside."""
        x, y = np.meshgrid(np.linspace(x0, x1, 24), np.linspace(y0, y1, 24))
        return float(np.percentile(self.z_um(x.ravel(), y.ravel()), 97))

    def hit(self, origin: Floats, direction: Floats) -> Place | None:
        """Where a ray meets the surface first, or the ground through a hole in it; None when it passes by."""
        span = self._crossing(origin, direction)
        if span is None:
            return None
        t = np.linspace(*span, _RAY_STEPS)
        below = np.flatnonzero(self._depth(origin, direction, t) <= 0)
        if below.size == 0:
            return None
        low, high = t[max(0, below[0] - 1)], t[below[0]]
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (low, middle) if self._depth(origin, direction, np.array([middle]))[0] <= 0 else (middle, high)
        x, y, _ = origin + direction * high
        return self.clamped((float(x) * 1e3, float(y) * 1e3)) if self._inside(np.array([x]), np.array([y]))[0] else None

    def _crossing(self, origin: Floats, direction: Floats) -> tuple[float, float] | None:
        """The part of a ray between the highest height drawn and the ground."""
        if abs(direction[2]) < 1e-9:
            return None
        top, foot = (
            self.on_show.scene_z(float(self._z_um.max())),
            min(0.0, self.on_show.scene_z(float(self._z_um.min()))),
        )
        ends = sorted(((top - origin[2]) / direction[2], (foot - origin[2]) / direction[2]))
        return (max(0.0, float(ends[0])), float(ends[1]) * (1 + 1e-9) + 1e-9) if ends[1] > 0 else None

    def _depth(self, origin: Floats, direction: Floats, t: Floats) -> Floats:
        """Height of the ray's points over the surface, in um; beside the surface they never meet it."""
        x, y, z = (origin[k] + direction[k] * t for k in range(3))
        over = z * 1e3 / self.on_show.stretch + self.on_show.z0_um - self.seen_um(x * 1e3, y * 1e3)
        return np.where(self._inside(x, y), over, np.inf)

    def _inside(self, x_mm: Floats, y_mm: Floats) -> NDArray[np.bool_]:
        x0, y0, x1, y1 = (v * 1e-3 for v in self.bounds_um)
        return (x_mm >= x0) & (x_mm <= x1) & (y_mm >= y0) & (y_mm <= y1)

    # ---------------------------------------------------------------- where to begin

    def first_line(self, near: Place) -> tuple[Place, Place]:
        """A profile to begin with: along x, near the middle of what is looked at, where it shows most."""
        x0, y0, x1, y1 = self.bounds_um
        x, y = self._inner(near)
        half = 0.32 * (x1 - x0)
        x = min(max(x, x0 + half * 1.1), x1 - half * 1.1)
        t = np.linspace(x - half, x + half, 200)
        rows = y + np.linspace(0, 0.3, 13)[:, None] * np.array([1.0, -1.0]) * (y1 - y0)
        best = max(rows.ravel().tolist(), key=lambda row: self._worth(t, row))
        return self.clamped((x - half, best)), self.clamped((x + half, best))

    def _worth(self, x_um: Floats, y_um: float) -> float:
        """How much a row shows: its measured share, more where it climbs; rows that differ by little are alike."""
        y = np.full_like(x_um, y_um)
        there = self.measured(x_um, y)
        if not there.any():
            return 0.0
        climb = float(np.ptp(self.z_um(x_um, y)[there])) / max(
            self.on_show.facts.high_um - self.on_show.facts.low_um, 1e-9
        )
        return round(float(there.mean()) * (1 + min(climb, 1.5)), 1)

    def first_plateaus(self, near: Place) -> tuple[Place, Place, float]:
        """Middles of an upper and a lower plateau near a place, and the side of the squares that fit on both."""
        short = min(self._relief.rows, self._relief.cols)
        for share in _PATCH_SHARES:
            side = max(4, round(short * share))
            found = self._plateaus(near, side)
            if found is not None:
                return *found, side * self._relief.pixel_um
        x, y = self._inner(near)
        side_um = short * _PATCH_SHARES[-1] * self._relief.pixel_um
        return (x, y + 2 * side_um), (x, y - 2 * side_um), side_um

    def _plateaus(self, near: Place, side: int) -> tuple[Place, Place] | None:
        """The flat patch on the upper level that is nearest, and the nearest to it on the lower; None: no such two."""
        places, levels, spreads = self._patches(side)
        span = self.on_show.facts.high_um - self.on_show.facts.low_um
        flat = spreads <= 0.04 * span
        if np.count_nonzero(flat) < 2:
            return None
        places, levels = places[flat], levels[flat]
        if np.ptp(levels) < 0.25 * span:
            return None
        upper = _nearest(places[levels >= levels.max() - 0.12 * np.ptp(levels)], self._inner(near))
        return upper, _nearest(places[levels <= levels.min() + 0.12 * np.ptp(levels)], upper)

    def _patches(self, side: int) -> tuple[Floats, Floats, Floats]:
        """Middles (um), mean heights and spreads of the square patches, half a side apart, measured all over."""
        r, step = self._relief, max(1, side // 2)
        z = self._z_um.astype(float) - self.on_show.z0_um
        n, total, squares = (_box_sums(layer, side, step) for layer in (self._there.astype(float), z, z * z))
        row, col = np.nonzero(n > 0.98 * side * side)
        mean = total[row, col] / side**2
        spread = np.sqrt(np.maximum(squares[row, col] / side**2 - mean**2, 0))
        x = r.x0_um + (col * step + (side - 1) / 2) * r.pixel_um
        y = r.y0_um - (row * step + (side - 1) / 2) * r.pixel_um
        return np.stack([x, y], axis=1).astype(float), mean, spread.astype(float)

    def _inner(self, near: Place) -> Place:
        """The place, drawn into the inner half of the surface."""
        x0, y0, x1, y1 = self.bounds_um
        x = min(max(near[0], x0 + 0.25 * (x1 - x0)), x1 - 0.25 * (x1 - x0))
        return x, min(max(near[1], y0 + 0.25 * (y1 - y0)), y1 - 0.25 * (y1 - y0))


def _nearest(places: Floats, to: Place) -> Place:
    away = np.hypot(places[:, 0] - to[0], places[:, 1] - to[1])
    x, y = places[int(np.argmin(away))]
    return float(x), float(y)


def _box_sums(layer: Floats, side: int, step: int) -> Floats:
    """Sums over the squares of `side` pixels that begin every `step` pixels."""
    sums = np.pad(layer, ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    boxes = sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]
    return boxes[::step, ::step]
