"""Camera presets, fitted to the contents and to the canvas area that no panel covers. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Preset = Literal["top", "front", "iso", "all"]
Vector = NDArray[np.float64]

NEAR_MM, NEAR_SHARE = 0.005, 2.5e-3
"""Near plane in mm; for a large sample a fraction of its distance, because thin layers would flicker otherwise."""
FOV_RAD = math.radians(29)
_TURNS: dict[str, tuple[float, float]] = {"top": (0.0, 89.9), "front": (0.0, 22.0), "iso": (-10.0, 50.0)}
"""Azimuth from south towards east and angle of depression of each preset, in degrees."""


@dataclass(frozen=True, slots=True)
class Clear:
    """Pixels at each edge of the canvas that are covered by panels."""

    left: float = 28
    top: float = 76
    right: float = 152
    bottom: float = 84


@dataclass(frozen=True, slots=True, eq=False)
class CameraPose:
    """Camera position and the point looked at, in mm."""

    position: Vector
    look_at: Vector

    @property
    def direction(self) -> Vector:
        """Unit vector from the point looked at to the camera."""
        away = self.position - self.look_at
        return away / np.linalg.norm(away)

    def is_same(self, other: CameraPose) -> bool:
        """Return whether two poses are bitwise equal."""
        return bool((self.position == other.position).all() and (self.look_at == other.look_at).all())

    def is_near(self, other: CameraPose | None) -> bool:
        """Return whether two poses agree within 1 % of the viewing distance."""
        if other is None:
            return False
        scale = float(np.linalg.norm(other.position - other.look_at))
        moved = np.linalg.norm(self.position - other.position) + np.linalg.norm(self.look_at - other.look_at)
        return bool(moved < 0.01 * scale)


def direction_of(preset: str) -> Vector:
    """Return the unit vector from the sample towards the camera."""
    turn, down = (math.radians(a) for a in _TURNS[preset])
    return np.array([math.sin(turn) * math.cos(down), -math.cos(turn) * math.cos(down), math.sin(down)])


def fit(
    corners_mm: Vector, direction: Vector, fov_rad: float, width_px: int, height_px: int, clear: Clear
) -> CameraPose:
    """Return the pose that shows points [n, 3] centred and as large as they fit into the free part of the canvas.

    fov_rad is the vertical field of view. The condition that a point lies within an edge is linear in the camera
    position, so the least distance has a closed form for points at any height.
    """
    focal_px = height_px / 2 / math.tan(fov_rad / 2)
    middle = (corners_mm.min(axis=0) + corners_mm.max(axis=0)) / 2
    right, up = screen_axes(direction)
    across, along, near = ((corners_mm - middle) @ axis for axis in (right, up, direction))
    left_px, right_px = _edges(width_px, clear.left, clear.right)
    foot_px, top_px = _edges(height_px, clear.bottom, clear.top)
    x = _Slack.of(across, near, left_px, right_px, focal_px)
    y = _Slack.of(along, near, foot_px, top_px, focal_px)
    distance = max(x.least_distance, y.least_distance, 1.02 * float(near.max()) + 1e-3)
    aim = middle + right * x.place(distance) + up * y.place(distance)
    return CameraPose(aim + direction * distance, aim)


def _edges(size_px: int, before: float, after: float) -> tuple[float, float]:
    """Return the free interval of one canvas side, relative to its centre; at least 80 pixels wide."""
    first = before - size_px / 2
    return first, max(size_px / 2 - after, first + 80.0)


@dataclass(frozen=True, slots=True)
class _Slack:
    """Interval of camera positions along one screen axis that keep all points within the free part."""

    low_mm: float
    high_mm: float
    first: float
    last: float
    """Edges of the free part as slopes of the line of sight."""

    @classmethod
    def of(cls, places: Vector, near: Vector, first_px: float, last_px: float, focal_px: float) -> _Slack:
        first, last = first_px / focal_px, last_px / focal_px
        return cls(float((places + last * near).max()), float((places + first * near).min()), first, last)

    @property
    def least_distance(self) -> float:
        """Distance at which the interval shrinks to one position."""
        return (self.low_mm - self.high_mm) / (self.last - self.first)

    def place(self, distance: float) -> float:
        """Return the centre of the interval at a distance."""
        return (self.low_mm - self.last * distance + self.high_mm - self.first * distance) / 2


def screen_axes(direction: Vector) -> tuple[Vector, Vector]:
    """Return right and up on the screen for a camera in this direction; the world's z is up."""
    right = np.cross([0.0, 0.0, 1.0], direction)
    right /= np.linalg.norm(right)
    return right, np.cross(direction, right)


def near_mm(pose: CameraPose) -> float:
    """Return the near plane distance of a pose."""
    return max(NEAR_MM, NEAR_SHARE * float(np.linalg.norm(pose.position - pose.look_at)))


def pixel_ray(pose: CameraPose, fov_rad: float, aspect: float, u: float, v: float) -> Vector:
    """Return the viewing direction of a point of the image.

    fov_rad: the vertical field of view; aspect: width by height; u, v: fractions of the width and the height, 0 at the
    left and at the top.
    """
    right, up = screen_axes(pose.direction)
    tall = np.tan(fov_rad / 2)
    return -pose.direction + (2 * u - 1) * aspect * tall * right + (1 - 2 * v) * tall * up
