"""Virtual stage: three axes with exact motion profiles and scales, and the errors of the scales."""

from __future__ import annotations

import errno
import math
import os
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wafer_viewer.model.acquisition.devices import Position
from wafer_viewer.model.acquisition.plan import Axis
from wafer_viewer.model.acquisition.rig_limits import AxisLimits, RigLimits
from wafer_viewer.model.errors import MotionStopped, RigError, RigTimeout
from wafer_viewer.model.progress import ShouldStop
from wafer_viewer.rigs.virtual.clock import VirtualClock
from wafer_viewer.rigs.virtual.faults import Faults

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


LATERAL_ERROR_UM = 0.15
AXIAL_ERROR_UM = 0.02
"""Root mean square difference between scale and truth."""
LATERAL_WAVES_UM = (900.0, 12_000.0)
AXIAL_WAVES_UM = (20.0, 400.0)
"""Shortest and longest wavelength of these errors."""
RING_UM = 0.3
RING_HZ = 60.0
REST_PATIENCE_S = 5.0
"""Time after motion and settling for which an axis may still report motion."""
WATCH_S = 0.002
"""Polling interval of motion and stop requests: 0.2 mm at full speed."""


class ScaleError:
    """Smooth, repeatable difference between scale and truth: waves over position with a given rms in um."""

    def __init__(self, seed: tuple[int, ...], rms_um: float, waves_um: tuple[float, float], n_waves: int = 5) -> None:
        rng = np.random.default_rng(seed)
        lengths_um = np.geomspace(*waves_um, n_waves)
        turn = rng.uniform(0, 2 * math.pi, n_waves)
        self._kx = 2 * math.pi * np.cos(turn) / lengths_um
        self._ky = 2 * math.pi * np.sin(turn) / lengths_um
        self._phase = rng.uniform(0, 2 * math.pi, n_waves)
        self._amplitude_um = rms_um * math.sqrt(2 / n_waves)

    def at(self, a_um: float, b_um: float = 0.0) -> float:
        """Return truth minus scale at a position, in um."""
        return float(self._amplitude_um * np.sin(self._kx * a_um + self._ky * b_um + self._phase).sum())


class VirtualAxis:
    """One axis: its limits, its motion, its ringing after a halt, and the position of its index mark on the scale."""

    def __init__(self, name: str, limits: AxisLimits, at_um: float = 0.0) -> None:
        self.name = name
        self.limits = limits
        self.index_um = limits.index_um
        self.profile = standing(at_um)

    def start(self, now_s: float, to_um: float, speed_um_s: float, late_s: float = 0.0) -> None:
        """Begin a motion, `late_s` after its command."""
        self.profile = trapezoid(
            now_s + late_s, self.profile.position_at(now_s), to_um, speed_um_s, self.limits.acceleration_um_s2
        )

    def stop(self, now_s: float) -> None:
        """Decelerate to a halt."""
        at_um, speed = self.profile.position_at(now_s), self.profile.speed_at(now_s)
        self.profile = halt(now_s, at_um, speed, self.limits.acceleration_um_s2)

    def moving(self, time_s: float) -> bool:
        """Return whether the axis is in motion."""
        return time_s < self.profile.end_s

    def settled_s(self) -> float:
        """Return the time at which the axis has settled after its motion."""
        return self.profile.end_s + self.limits.settle_s

    def ring_um(self, time_s: float) -> float:
        """Return the ringing after a halt in um, which has decayed after the settle time."""
        since_s = time_s - self.profile.end_s
        if since_s < 0 or math.isinf(since_s):
            return 0.0
        return RING_UM * math.exp(-6 * since_s / self.limits.settle_s) * math.cos(2 * math.pi * RING_HZ * since_s)


class VirtualStage:
    """Implementation of Stage on a virtual clock; the pulse box uses its scales, the camera its true position."""

    def __init__(
        self,
        clock: VirtualClock,
        limits: RigLimits,
        seed: int = 0,
        faults: Faults | None = None,
        z_fraction: float = 0.0,
    ) -> None:
        self._clock = clock
        self._z_factor = 1 + z_fraction
        """True distance over distance on the scale."""
        self._faults = faults or Faults()
        self._motions = 0
        """Number of motions commanded since the rig was switched on."""
        self._endless = False
        """Whether the stage permanently reports motion."""
        self.axes: dict[Axis, VirtualAxis] = {n: VirtualAxis(n, limits.axis(n)) for n in ("x", "y", "z")}
        self._further: dict[str, VirtualAxis] = {}
        """Axes of positioners, by name, in their units."""
        self._error_x = ScaleError((seed, 1), LATERAL_ERROR_UM, LATERAL_WAVES_UM)
        self._error_y = ScaleError((seed, 2), LATERAL_ERROR_UM, LATERAL_WAVES_UM)
        self._error_z = ScaleError((seed, 3), AXIAL_ERROR_UM, AXIAL_WAVES_UM)
        self._followers: list[Callable[[Axis, float], None]] = []
        self._lost = False

    def pull_cable(self) -> None:
        """Lose the line to the stage: commands raise OSError, and a motion goes on to its end."""
        self._lost = True

    def _check_cable(self) -> None:
        if self._lost:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))

    def on_motion(self, follower: Callable[[Axis, float], None]) -> None:
        """Register a callback for axis and time of every start and interruption of a motion."""
        self._followers.append(follower)

    def add(self, name: str, limits: AxisLimits, at: float) -> None:
        """Add an axis of a positioner, which no pulse counts, at a position in its unit."""
        self._further[name] = VirtualAxis(name, limits, at)

    def axis(self, name: str) -> VirtualAxis:
        """Return an axis of the stage or of a positioner."""
        return next(axis for axis in self._all if axis.name == name)

    @property
    def _all(self) -> tuple[VirtualAxis, ...]:
        return (*self.axes.values(), *self._further.values())

    @property
    def motions(self) -> int:
        """Number of motions commanded since the rig was switched on."""
        return self._motions

    def position(self) -> Position:
        """Return the current scale readings."""
        self._check_cable()
        return self.scales_at(self._clock.now_s())

    def scales_at(self, time_s: float) -> Position:
        """Return the scale readings at a time."""
        x, y, z = (axis.profile.position_at(time_s) for axis in self.axes.values())
        return Position(x, y, z)

    def truth_at(self, time_s: float) -> Position:
        """Return the true position at a time, including ringing."""
        at = self.truth_of(self.scales_at(time_s))
        ring_x, ring_y, ring_z = (axis.ring_um(time_s) for axis in self.axes.values())
        return Position(at.x_um + ring_x, at.y_um + ring_y, at.z_um + ring_z)

    def truth_of(self, scales: Position) -> Position:
        """Return the true position for scale readings, without ringing."""
        x_um, y_um = scales.x_um, scales.y_um
        return Position(
            x_um + self._error_x.at(x_um, y_um),
            y_um + self._error_y.at(x_um, y_um),
            scales.z_um * self._z_factor + self._error_z.at(scales.z_um),
        )

    def move_to(
        self,
        *,
        x_um: float | None = None,
        y_um: float | None = None,
        z_um: float | None = None,
        should_stop: ShouldStop | None = None,
    ) -> None:
        """Move at full speed and wait until settled; None leaves an axis at its position.

        Raises MotionStopped, with the stage at rest, when `should_stop` returns True before or during the motion.
        """
        self._check_cable()
        wanted = zip(self.axes.values(), (x_um, y_um, z_um), strict=True)
        goals = [(axis, to_um) for axis, to_um in wanted if to_um is not None]
        for axis, to_um in goals:
            self._check(axis, to_um)
        if should_stop is not None and should_stop():
            raise self._stopped()
        now_s = self._clock.now_s()
        goals = [(axis, to_um) for axis, to_um in goals if to_um != axis.profile.position_at(now_s)]
        late_s, beyond_um = self._command() if goals else (0.0, 0.0)
        for axis, to_um in goals:
            self._start(axis, to_um + beyond_um, axis.limits.speed_um_s, late_s)
        self._arrive(should_stop)

    def start(self, axis: Axis, to_um: float, speed_um_s: float) -> None:
        """Begin a motion of one axis at a given speed, and return at once."""
        self._check_cable()
        one = self.axes[axis]
        self._check(one, to_um)
        one.limits.require_speed(axis, speed_um_s)
        late_s, beyond_um = self._command()
        self._start(one, to_um + beyond_um, speed_um_s, late_s)

    def homed(self) -> bool:
        """Return True, as the scales are absolute."""
        self._check_cable()
        return True

    def moving(self) -> bool:
        """Return whether any axis is in motion."""
        self._check_cable()
        now_s = self._clock.now_s()
        return self._endless or any(axis.moving(now_s) for axis in self._all)

    def wait(self) -> None:
        """Wait until every axis is at rest and settled. Raises RigTimeout when it does not report so in time."""
        self._check_cable()
        self._clock.sleep(self._unsettled_s())
        if self._endless:
            self._clock.sleep(REST_PATIENCE_S)
            raise RigTimeout("The stage still reports motion long after it should stand: stop it and check its drives.")

    def stop(self) -> None:
        """Decelerate every axis to a halt, those of positioners too. This is not an emergency stop."""
        self._check_cable()
        self._endless = False
        for axis in self._all:
            self.halt(axis.name)

    def redirect(self, axis: str, to_um: float, speed_um_s: float) -> None:
        """Begin a motion of one axis, even out of its range or in the middle of another: for simulated controllers."""
        late_s, beyond_um = self._command()
        self._start(self.axis(axis), to_um + beyond_um, speed_um_s, late_s)

    def halt(self, axis: str) -> None:
        """Decelerate one axis to a halt."""
        self._clock.catch_up()
        now_s, one = self._clock.now_s(), self.axis(axis)
        if one.moving(now_s):
            one.stop(now_s)
            self._tell(one, now_s)

    def _arrive(self, should_stop: ShouldStop | None) -> None:
        """Wait for the end of a motion, or interrupt it; what arrived while it was asked is not interrupted."""
        while should_stop is not None and self.moving():
            if should_stop() and self.moving():
                self.stop()
                self.wait()
                raise self._stopped()
            self._clock.sleep(min(WATCH_S, self._unsettled_s() or WATCH_S))
        self.wait()

    def _unsettled_s(self) -> float:
        settled_s = max(axis.settled_s() for axis in self._all)
        return max(0.0, settled_s - self._clock.now_s())

    def _stopped(self) -> MotionStopped:
        here = self.position()
        return MotionStopped.at(here.x_um, here.y_um, here.z_um)

    def _check(self, axis: VirtualAxis, to_um: float) -> None:
        axis.limits.require_reachable(axis.name, to_um)
        if axis.moving(self._clock.now_s()):
            raise RigError(f"The {axis.name} axis is still moving: wait for it or stop it first.")

    def _command(self) -> tuple[float, float]:
        """Number a motion, with its faults; return its start delay in s and its overshoot in um."""
        number, faults = self._motions, self._faults
        self._motions += 1
        self._endless = self._endless or number in faults.endless_motions
        late_s = faults.late_s if number in faults.late_motions else 0.0
        return late_s, faults.overshoot_um if number in faults.overshooting_motions else 0.0

    def _start(self, axis: VirtualAxis, to_um: float, speed_um_s: float, late_s: float) -> None:
        self._clock.catch_up()
        now_s = self._clock.now_s()
        axis.start(now_s, to_um, speed_um_s, late_s)
        self._tell(axis, now_s)

    def _tell(self, moved: VirtualAxis, now_s: float) -> None:
        """Tell the followers of a motion of the stage; the pulse box does not count positioners."""
        for name, axis in self.axes.items():
            if axis is moved:
                for follower in self._followers:
                    follower(name, now_s)
