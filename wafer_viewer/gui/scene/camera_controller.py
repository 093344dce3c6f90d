"""Camera of one browser: presets, framing, saved poses, and transitions that the user may interrupt."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

import numpy as np
import viser

from wafer_viewer.gui.scene.camera_presets import FOV_RAD, CameraPose, Clear, Vector, direction_of, fit, near_mm
from wafer_viewer.gui.scene.quadtree import Frustum
from wafer_viewer.gui.scene.viewport import Viewport

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
        self._acknowledged = 0

    def step(self, now_s: float) -> CameraPose | None:
        """Return the pose to set now; None when the transition is over."""
        if self.over:
            return None
        self.late = self._acknowledged < len(self._sent) and now_s - self._sent[self._acknowledged][0] > LATE_S
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
                self._acknowledged = max(self._acknowledged, number)
                return True
        # Before the first step has come back the browser may still tell of what it did on its own before.
        return self._acknowledged == 0


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
        self._height_field(flight)

    def _step(self, flight: CameraTransition) -> CameraPose | None:
        with self._due:
            if self._flight is not flight:
                return None
            pose = flight.step(self._clock())
            if flight.late:
                self._rests_until_s = self._clock() + REST_S
            return pose

    def _height_field(self, flight: CameraTransition) -> None:
        """Set the goal once more if a report received meanwhile has changed the pose."""
        with self._due:
            if self._flight is not flight:
                return
            self._flight = None
        pose, goal = self._pose(), flight.goal
        if not (np.allclose(pose.position, goal.position) and np.allclose(pose.look_at, goal.look_at)):
            self._stand(goal)


_AIMED = 5e-3
"""Tolerance of the point looked at, as a fraction of the distance to the camera."""


class CameraController:
    """The camera of one browser."""

    def __init__(self, client: viser.ClientHandle, viewport: Viewport) -> None:
        self._client, self._viewport = client, viewport
        self._preset: str = "iso"
        self._corners: Vector | None = None
        self._clear = Clear()
        self._set: CameraPose | None = None
        self._size_px = (0, 0)
        self._fitting = threading.RLock()
        """Held from reading the size of the canvas to the pose for it: the scene's thread and that of the moves fit."""
        self._last_seen: Vector | None = None
        self._pilot = CameraAnimator(self._put, lambda: self.pose)
        client.camera.on_update(self._heard)

    @property
    def pose(self) -> CameraPose:
        """Current pose of the camera."""
        camera = self._client.camera
        return CameraPose(np.asarray(camera.position, float), np.asarray(camera.look_at, float))

    @property
    def goal(self) -> CameraPose:
        """Target pose of the current transition; the current pose if there is none."""
        return self._pilot.goal or self.pose

    def let_fly(self, able: bool) -> None:
        """Enable animated transitions; disabled for slow browsers and users who prefer reduced motion."""
        self._pilot.able = able

    def close(self) -> None:
        """Stop the animation thread."""
        self._pilot.close()

    def sight(self) -> Frustum:
        """Return the frustum of the goal pose, in pixels of the drawing buffer; intermediate poses are skipped."""
        camera, pose = self._client.camera, self.goal
        eye, look_at, up = (
            (float(v[0]), float(v[1]), float(v[2])) for v in (pose.position, pose.look_at, camera.up_direction)
        )
        return Frustum.of(eye, look_at, up, camera.fov, camera.image_width, camera.image_height)

    def um_per_pixel(self) -> float:
        """Return the size of a CSS pixel at the point looked at."""
        camera = self._client.camera
        distance = float(np.linalg.norm(camera.position - camera.look_at))
        return 2e3 * distance * math.tan(camera.fov / 2) / max(1, self._viewport.height_px)

    def frame(self, corners_mm: Vector, preset: str, clear: Clear, *, flying: bool = False) -> None:
        """Frame these points from a preset; ``all`` keeps the current direction."""
        self._corners, self._preset, self._clear = corners_mm, preset, clear
        direction = self.goal.direction if preset == "all" else direction_of(preset)
        self._apply(direction, self._fly if flying else self._stand)

    def fly(self, corners_mm: Vector) -> None:
        """Frame these points from the current direction; the points that `follow` compares remain unchanged."""
        self._fly(fit(corners_mm, self.goal.direction, FOV_RAD, *self.canvas_px, self._clear))

    def go(self, pose: CameraPose, *, flying: bool = False) -> None:
        """Move to a pose as the operator would; the camera stays there from now on."""
        self._set = None
        (self._fly if flying else self._stand)(pose)

    def follow(self, corners_mm: Vector, clear: Clear) -> None:
        """Frame the contents again after their extent has changed, unless the operator has moved the camera."""
        if self._corners is not None and np.allclose(corners_mm, self._corners, atol=1e-4) and clear == self._clear:
            return
        self._corners, self._clear = corners_mm, clear
        if self._set is not None and self.goal.is_near(self._set):
            self._apply(self._set.direction, self._stand)

    def aim(self, place: Vector) -> None:
        """Look at a point in the centre of the view without changing the image: the pivot of rotation and zoom."""
        pose = self.pose
        if self._last_seen is not None and np.allclose(pose.position, self._last_seen) and not pose.is_near(self._set):
            return  # as a slow browser still has it: it was told where to stand, and has not come there yet
        moved = float(np.linalg.norm(place - pose.look_at))
        if self._pilot.goal is None and moved > _AIMED * float(np.linalg.norm(place - pose.position)):
            if pose.is_near(self._set):
                self._set = CameraPose(pose.position, place)
            self._client.camera.look_at = place

    def moved(self) -> CameraPose:
        """Handle a camera move: fit to a resized canvas, update the near plane and return the current pose."""
        self.refit()
        self.update_near_plane()
        return self.pose

    def update_near_plane(self) -> None:
        """Adapt the near plane to the distance: no clipping of near parts, no flicker of thin layers far away."""
        camera, pose = self._client.camera, self.pose
        near = near_mm(pose)
        if not 0.5 < near / camera.near < 2:
            camera.near = near

    def refit(self) -> None:
        """Fit again after the canvas was resized, unless the operator has moved the camera since."""
        with self._fitting:
            if self.canvas_px == self._size_px or self._corners is None:
                return
            if self.goal.is_near(self._set):
                self._apply(self._set.direction if self._set else direction_of(self._preset), self._stand)

    @property
    def canvas_px(self) -> tuple[int, int]:
        """Width and height of the scene in CSS pixels."""
        return self._viewport.width_px, self._viewport.height_px

    def _apply(self, direction: Vector, move: Callable[[CameraPose], None]) -> None:
        if self._corners is None:
            return
        with self._fitting:
            self._size_px = self.canvas_px
            self._set = fit(self._corners, direction, FOV_RAD, *self._size_px, self._clear)
            move(self._set)

    def _fly(self, pose: CameraPose) -> None:
        if not self._pilot.fly(self.pose, pose):
            self._put(pose)

    def _stand(self, pose: CameraPose) -> None:
        self._pilot.drop()
        self._put(pose)

    async def _heard(self, camera: viser.CameraHandle) -> None:
        # A coroutine: run where the report arrives, before anything else can put the camera elsewhere.
        self._pilot.heard(np.asarray(camera.position, float))

    def _put(self, pose: CameraPose) -> None:
        camera = self._client.camera
        self._last_seen = np.array(camera.position, float)
        with self._client.atomic():
            camera.up_direction = (0.0, 0.0, 1.0)
            camera.fov = FOV_RAD
            camera.near = near_mm(pose)
            camera.position = pose.position
            camera.look_at = pose.look_at
        self._client.flush()
