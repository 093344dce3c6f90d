"""Animated camera transitions, cancelled at once when the user moves the camera."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

import numpy as np

from wafer_viewer.gui.scene.camera.camera_presets import CameraPose, Vector

FLIGHT_S, STEP_S = 0.35, 0.04
LATE_S = 0.2
"""A browser that has not reported a step after this time is too slow for transitions."""
REST_S = 60.0
"""Time without transitions after a browser was too slow."""
LAND_S = 0.1
"""Delay before the final pose is verified."""
_SAME = 1e-3
"""Tolerance of equal positions, as a fraction of the viewing distance."""


def between(start: CameraPose, goal: CameraPose, share: float) -> CameraPose:
    """Return the pose after a fraction of a transition; the goal itself at its end.

    The camera turns about the vertical axis the shorter way, and its distance is interpolated logarithmically. The
    point looked at moves in proportion to the change of distance, so that the goal stays in view.
    """
    if share >= 1:
        return goal
    eased = share * share * (3 - 2 * share)
    near, far = _distance(goal), _distance(start)
    distance = far ** (1 - eased) * near**eased
    moved = eased if math.isclose(near, far, rel_tol=1e-3) else (far - distance) / (far - near)
    look_at = start.look_at + (goal.look_at - start.look_at) * moved
    return CameraPose(look_at + _direction(start, goal, eased) * distance, look_at)


def _distance(pose: CameraPose) -> float:
    return float(np.linalg.norm(pose.position - pose.look_at))


def _direction(start: CameraPose, goal: CameraPose, share: float) -> Vector:
    (turn, rise), (last_turn, last_rise) = _angles(start.direction), _angles(goal.direction)
    turn += share * math.remainder(last_turn - turn, 2 * math.pi)
    rise += share * (last_rise - rise)
    return np.array([math.cos(turn) * math.cos(rise), math.sin(turn) * math.cos(rise), math.sin(rise)])


def _angles(direction: Vector) -> tuple[float, float]:
    x, y, z = (float(v) for v in direction)
    return math.atan2(y, x), math.atan2(z, math.hypot(x, y))


class CameraTransition:
    """One transition. Times are seconds of any clock. Poses reported by the browser are compared with those sent."""

    def __init__(self, start: CameraPose, goal: CameraPose, now_s: float) -> None:
        self.start, self.goal = start, goal
        self.over, self.late = False, False
        self._began_s = now_s
        self._sent: list[tuple[float, CameraPose]] = []
        self._known = 0

    def step(self, now_s: float) -> CameraPose | None:
        """Return the pose to set now; None when the transition is over."""
        if self.over:
            return None
        self.late = self._known < len(self._sent) and now_s - self._sent[self._known][0] > LATE_S
        share = 1.0 if self.late else (now_s - self._began_s + STEP_S) / FLIGHT_S
        pose = between(self.start, self.goal, share)
        self._sent.append((now_s, pose))
        self.over = share >= 1
        return pose

    def heard(self, position: Vector) -> bool:
        """Return whether a reported position is one that was sent; any other means that the user moved the camera."""
        for number in range(len(self._sent), 0, -1):
            sent = self._sent[number - 1][1]
            if np.linalg.norm(sent.position - position) < _SAME * _distance(sent):
                self._known = max(self._known, number)
                return True
        # Before the first step has come back the browser may still tell of what it did on its own before.
        return self._known == 0


class CameraAnimator:
    """Animates one camera on its own thread; `stand` sets the camera pose.

    able: True if the browser renders fast enough and its user wants motion.
    """

    def __init__(
        self,
        stand: Callable[[CameraPose], None],
        pose: Callable[[], CameraPose],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.able = False
        self._stand, self._pose, self._clock = stand, pose, clock
        self._flight: CameraTransition | None = None
        self._rests_until_s = -math.inf
        self._due = threading.Condition()
        self._closed = False
        self._thread: threading.Thread | None = None

    @property
    def goal(self) -> CameraPose | None:
        """Goal of the running transition; None if there is none."""
        with self._due:
            return self._flight.goal if self._flight is not None else None

    def fly(self, start: CameraPose, goal: CameraPose) -> bool:
        """Start a transition in place of any other; return False if transitions are disabled or the goal is reached."""
        with self._due:
            if not self.able or self._clock() < self._rests_until_s or start.is_near(goal):
                self._flight = None
                return False
            self._flight = CameraTransition(start, goal, self._clock())
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="flight", daemon=True)
                self._thread.start()
            self._due.notify_all()
            return True

    def drop(self) -> None:
        """Cancel the transition and leave the camera at its current pose."""
        with self._due:
            self._flight = None
            self._due.notify_all()

    def heard(self, position: Vector) -> None:
        """Handle a camera position reported by the browser."""
        with self._due:
            if self._flight is not None and not self._flight.heard(position):
                self._flight = None
                self._due.notify_all()

    def close(self) -> None:
        """Stop the thread."""
        with self._due:
            self._closed, self._flight = True, None
            self._due.notify_all()

    def _run(self) -> None:
        while True:
            with self._due:
                self._due.wait_for(lambda: self._flight is not None or self._closed)
                flight = self._flight
            if self._closed or flight is None:
                return
            self._carry_out(flight)

    def _carry_out(self, flight: CameraTransition) -> None:
        """Run the steps of a transition until it is over or replaced."""
        while (pose := self._step(flight)) is not None:
            self._stand(pose)
            with self._due:
                self._due.wait_for(lambda: self._flight is not flight, LAND_S if flight.over else STEP_S)
        self._land(flight)

    def _step(self, flight: CameraTransition) -> CameraPose | None:
        with self._due:
            if self._flight is not flight:
                return None
            pose = flight.step(self._clock())
            if flight.late:
                self._rests_until_s = self._clock() + REST_S
            return pose

    def _land(self, flight: CameraTransition) -> None:
        """Set the goal once more if a report received meanwhile has changed the pose."""
        with self._due:
            if self._flight is not flight:
                return
            self._flight = None
        pose, goal = self._pose(), flight.goal
        if not (np.allclose(pose.position, goal.position) and np.allclose(pose.look_at, goal.look_at)):
            self._stand(goal)
