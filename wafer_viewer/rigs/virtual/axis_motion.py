"""How an axis moves: pieces of constant acceleration, with the exact time at which a position is crossed."""

from __future__ import annotations

import math
from dataclasses import dataclass

ROUNDING_S = 1e-9
"""A crossing between two pieces is found in one of them, whichever way the times were rounded."""


@dataclass(frozen=True, slots=True)
class MotionPiece:
    """A stretch of constant acceleration."""

    start_s: float
    duration_s: float
    position_um: float
    speed_um_s: float
    acceleration_um_s2: float = 0.0

    def position_at(self, time_s: float) -> float:
        """Where the axis is; before the piece its beginning, after it its end."""
        t = min(max(time_s - self.start_s, 0.0), self.duration_s)
        return self.position_um + (self.speed_um_s + self.acceleration_um_s2 * t / 2) * t

    def crossing_s(self, position_um: float, direction: int) -> float | None:
        """When the axis passes a position on its way in a direction, or None."""
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
    """A motion of one axis from standing or moving to standing."""

    pieces: tuple[MotionPiece, ...]
    direction: int = 1

    @property
    def end_s(self) -> float:
        """When the axis stands."""
        return self.pieces[-1].start_s + self.pieces[-1].duration_s

    def position_at(self, time_s: float) -> float:
        """Where the axis is, in um."""
        return self._piece_at(time_s).position_at(time_s)

    def speed_at(self, time_s: float) -> float:
        """How fast it goes, in um/s, with the sign of its direction."""
        piece = self._piece_at(time_s)
        t = time_s - piece.start_s
        return piece.speed_um_s + piece.acceleration_um_s2 * t if 0 <= t < piece.duration_s else 0.0

    def crossing_s(self, position_um: float, direction: int, after_s: float) -> float | None:
        """The first time, not before after_s, at which a position is crossed in a direction, or None."""
        if direction != self.direction:
            return None
        times = (piece.crossing_s(position_um, direction) for piece in self.pieces)
        return min((t for t in times if t is not None and t >= after_s), default=None)

    def _piece_at(self, time_s: float) -> MotionPiece:
        return next((p for p in self.pieces if time_s < p.start_s + p.duration_s), self.pieces[-1])


def standing(position_um: float) -> MotionProfile:
    """An axis that has stood there since ever."""
    return MotionProfile((MotionPiece(-math.inf, 0.0, position_um, 0.0),))


def trapezoid(
    start_s: float, from_um: float, to_um: float, speed_um_s: float, acceleration_um_s2: float
) -> MotionProfile:
    """From standing to standing: up to speed, at speed, down again; a short way never reaches the speed."""
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
    """From moving to standing, as soon as it can."""
    direction = 1 if speed_um_s >= 0 else -1
    return MotionProfile(
        (
            MotionPiece(
                start_s, abs(speed_um_s) / acceleration_um_s2, position_um, speed_um_s, -direction * acceleration_um_s2
            ),
        ),
        direction,
    )
