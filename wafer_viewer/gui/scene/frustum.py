"""View frustum of a camera: visibility and screen size of boxes."""

from __future__ import annotations

import math
from dataclasses import dataclass

Triple = tuple[float, float, float]
_WIDER = 1.06
"""Widening factor of the view: a small turn of the camera then shows no coarse tiles at its edge."""


@dataclass(frozen=True, slots=True)
class AABB:
    """Axis-aligned box in scene mm."""

    low: Triple
    high: Triple


@dataclass(frozen=True, slots=True)
class Frustum:
    """Frustum of a camera at `eye` looking along `ahead`.

    sides: inward normals of the four side planes through the eye.
    focal_px: height in pixels of an object 1 mm high at a distance of 1 mm.
    """

    eye: Triple
    ahead: Triple
    sides: tuple[Triple, ...]
    focal_px: float

    @classmethod
    def of(cls, eye: Triple, look_at: Triple, up: Triple, fov_rad: float, width_px: int, height_px: int) -> Frustum:
        """Return the frustum of a camera; fov_rad is the vertical field of view."""
        ahead = _unit(_minus(look_at, eye))
        right = _unit(_cross(ahead, up))
        above = _cross(right, ahead)
        tall = math.tan(fov_rad / 2)
        wide = tall * width_px / max(1, height_px)
        sides = tuple(
            _sum(axis, ahead, _WIDER * slope)
            for axis, slope in ((right, wide), (_turned(right), wide), (above, tall), (_turned(above), tall))
        )
        return cls(eye, ahead, sides, max(1, height_px) / 2 / tall)

    def sees(self, box: AABB) -> bool:
        """Return whether any part of a box may be in view."""
        return all(self._reach(side, box) >= 0 for side in (*self.sides, self.ahead))

    def px_per_mm(self, box: AABB) -> float:
        """Return the pixels per millimetre at the nearest point of a box."""
        away = [
            max(low - coordinate, 0.0, coordinate - high)
            for low, coordinate, high in zip(box.low, self.eye, box.high, strict=True)
        ]
        return self.focal_px / max(math.hypot(*away), 1e-6)

    def aside(self, box: AABB) -> float:
        """Return the angular offset of a box centre from the view axis, as a slope; infinite behind the camera."""
        off = _minus(_middle(box), self.eye)
        ahead = _dot(off, self.ahead)
        return math.sqrt(max(0.0, _dot(off, off) - ahead * ahead)) / ahead if ahead > 0 else math.inf

    def ground_um(self, z_mm: float) -> tuple[tuple[float, float], ...] | None:
        """Return the intersections of the four view corners with a level plane, in um; None if any of them misses."""
        right, left, above, below = self.sides
        corners = [_cross(a, b) for a, b in ((left, above), (above, right), (right, below), (below, left))]
        rays = [ray if _dot(ray, self.ahead) > 0 else _turned(ray) for ray in corners]
        times = [(z_mm - self.eye[2]) / ray[2] if ray[2] else -1.0 for ray in rays]
        if min(times) <= 0:
            return None
        met = [_sum(self.eye, ray, t) for ray, t in zip(rays, times, strict=True)]
        return tuple((x * 1e3, y * 1e3) for x, y, _ in met)

    def _reach(self, normal: Triple, box: AABB) -> float:
        """Return the largest extent of a box on the inner side of a plane through the eye."""
        return sum(
            n * ((high if n > 0 else low) - coordinate)
            for n, low, high, coordinate in zip(normal, box.low, box.high, self.eye, strict=True)
        )


def _middle(box: AABB) -> Triple:
    (x0, y0, z0), (x1, y1, z1) = box.low, box.high
    return (x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2


def _minus(a: Triple, b: Triple) -> Triple:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _sum(a: Triple, b: Triple, times: float) -> Triple:
    return a[0] + times * b[0], a[1] + times * b[1], a[2] + times * b[2]


def _turned(a: Triple) -> Triple:
    return -a[0], -a[1], -a[2]


def _dot(a: Triple, b: Triple) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Triple, b: Triple) -> Triple:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _unit(a: Triple) -> Triple:
    length = math.sqrt(_dot(a, a))
    return (a[0] / length, a[1] / length, a[2] / length) if length > 0 else (1.0, 0.0, 0.0)
