"""Motion profiles of an axis: pieces of constant acceleration, with exact times of position crossings."""

from __future__ import annotations

import math
from dataclasses import dataclass

ROUNDING_S = 1e-9
"""Time tolerance in s, so that a crossing between two pieces is found in one of them."""


@dataclass(frozen=True, slots=True)
class MotionPiece:
    """Piece of constant acceleration."""

    start_s: float
    duration_s: float
    position_um: float
    speed_um_s: float
    acceleration_um_s2: float = 0.0

    def position_at(self, time_s: float) -> float:
        """Return the position in um, clamped to the start and the end of the piece."""
        t = min(max(time_s - self.start_s, 0.0), self.duration_s)
        return self.position_um + (self.speed_um_s + self.acceleration_um_s2 * t / 2) * t

    def crossing_s(self, position_um: float, direction: int) -> float | None:
        """Return the time at which the axis passes a position in a direction, or None."""
        way = position_um - self.position_um
        square = self.speed_um_s**2 + 2 * self.acceleration_um_s2 * way
        if square < 0:
            return None
        speed_there = direction * math.sqrt(square)
        if self.speed_um_s + speed_there == 0:
            return None
        t = 2 * way / (self.speed_um_s + speed_there)
        return self.start_s + t if -ROUNDING_S <= t <= self.duration_s + ROUNDING_S else None


@dataclass(frozen=True, slots=True)
class MotionProfile:
    """Motion of one axis that ends at rest."""

    pieces: tuple[MotionPiece, ...]
    direction: int = 1

    @property
    def end_s(self) -> float:
        """Time at which the axis comes to rest."""
        return self.pieces[-1].start_s + self.pieces[-1].duration_s

    def position_at(self, time_s: float) -> float:
        """Return the position in um."""
        return self._piece_at(time_s).position_at(time_s)

    def speed_at(self, time_s: float) -> float:
        """Return the velocity in um/s, signed by direction."""
        piece = self._piece_at(time_s)
        t = time_s - piece.start_s
        return piece.speed_um_s + piece.acceleration_um_s2 * t if 0 <= t < piece.duration_s else 0.0

    def crossing_s(self, position_um: float, direction: int, after_s: float) -> float | None:
        """Return the first time from after_s on at which a position is crossed in a direction, or None."""
        if direction != self.direction:
            return None
        times = (piece.crossing_s(position_um, direction) for piece in self.pieces)
        return min((t for t in times if t is not None and t >= after_s), default=None)

    def _piece_at(self, time_s: float) -> MotionPiece:
        return next((p for p in self.pieces if time_s < p.start_s + p.duration_s), self.pieces[-1])


def standing(position_um: float) -> MotionProfile:
    """Return the profile of an axis at rest."""
    return MotionProfile((MotionPiece(-math.inf, 0.0, position_um, 0.0),))


def trapezoid(
    start_s: float, from_um: float, to_um: float, speed_um_s: float, acceleration_um_s2: float
) -> MotionProfile:
    """Return a trapezoidal profile from rest to rest; a short motion does not reach the full speed."""
    way, direction = abs(to_um - from_um), 1 if to_um >= from_um else -1
    top = min(speed_um_s, math.sqrt(way * acceleration_um_s2))
    ramp_s, ramp_um = top / acceleration_um_s2, top**2 / acceleration_um_s2 / 2
    even_s = (way - 2 * ramp_um) / top if top > 0 else 0.0
    v, a = direction * top, direction * acceleration_um_s2
    up = MotionPiece(start_s, ramp_s, from_um, 0.0, a)
    even = MotionPiece(start_s + ramp_s, even_s, from_um + direction * ramp_um, v)
    down = MotionPiece(start_s + ramp_s + even_s, ramp_s, to_um - direction * ramp_um, v, -a)
    return MotionProfile((up, even, down), direction)


def halt(start_s: float, position_um: float, speed_um_s: float, acceleration_um_s2: float) -> MotionProfile:
    """Return a deceleration to rest at the given acceleration."""
    direction = 1 if speed_um_s >= 0 else -1
    return MotionProfile(
        (
            MotionPiece(
                start_s, abs(speed_um_s) / acceleration_um_s2, position_um, speed_um_s, -direction * acceleration_um_s2
            ),
        ),
        direction,
    )
