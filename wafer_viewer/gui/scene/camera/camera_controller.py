"""The camera of one browser: sent to a preset, to a part of what is drawn, to a place that was kept."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import viser

from wafer_viewer.gui.scene.camera.camera_flight import CameraAnimator
from wafer_viewer.gui.scene.camera.camera_presets import FOV_RAD, CameraPose, Clear, Vector, direction_of, fit, near_mm
from wafer_viewer.gui.scene.camera.frustum import Frustum
from wafer_viewer.gui.scene.viewport import Viewport

_AIMED = 5e-3
"""As a share of the distance: the camera looks at a place when it looks so close to it."""


class CameraController:
    """The camera of one browser."""

    def __init__(self, client: viser.ClientHandle, viewport: Viewport) -> None:
        self._client, self._viewport = client, viewport
        self._preset: str = "iso"
        self._corners: Vector | None = None
        self._clear = Clear()
        self._set: CameraPose | None = None
        self._size_px = (0, 0)
        self._left: Vector | None = None
        self._pilot = CameraAnimator(self._put, lambda: self.pose)
        client.camera.on_update(self._heard)

    @property
    def pose(self) -> CameraPose:
        """Where the camera is now."""
        camera = self._client.camera
        return CameraPose(np.asarray(camera.position, float), np.asarray(camera.look_at, float))

    @property
    def goal(self) -> CameraPose:
        """Where it is going to stand: where it is now, unless it flies."""
        return self._pilot.goal or self.pose

    def let_fly(self, able: bool) -> None:
        """Whether it may fly: a browser that draws slowly, or whose user wants things to keep still, has it jump."""
        self._pilot.able = able

    def close(self) -> None:
        """Let the thread of flights go."""
        self._pilot.close()

    def sight(self) -> Frustum:
        """What it sees, in a flight at its end: what lies on the way is not worth drawing. In pixels as drawn."""
        camera, pose = self._client.camera, self.goal
        eye, look_at, up = (
            (float(v[0]), float(v[1]), float(v[2])) for v in (pose.position, pose.look_at, camera.up_direction)
        )
        return Frustum.of(eye, look_at, up, camera.fov, camera.image_width, camera.image_height)

    def um_per_pixel(self) -> float:
        """How long a CSS pixel is at the point looked at."""
        camera = self._client.camera
        distance = float(np.linalg.norm(camera.position - camera.look_at))
        return 2e3 * distance * math.tan(camera.fov / 2) / max(1, self._viewport.height_px)

    def frame(self, corners_mm: Vector, preset: str, clear: Clear, *, flying: bool = False) -> None:
        """Look at these points from a preset, ``all`` from where the camera is now."""
        self._corners, self._preset, self._clear = corners_mm, preset, clear
        direction = self.goal.direction if preset == "all" else direction_of(preset)
        self._apply(direction, self._fly if flying else self._stand)

    def fly(self, corners_mm: Vector) -> None:
        """Look at these points from where the camera is now; what is drawn stays what `follow` takes in."""
        self._fly(fit(corners_mm, self.goal.direction, FOV_RAD, *self.canvas_px, self._clear))

    def go(self, pose: CameraPose, *, flying: bool = False) -> None:
        """Stand somewhere, as the operator would; from now on the camera stays there."""
        self._set = None
        (self._fly if flying else self._stand)(pose)

    def follow(self, corners_mm: Vector, clear: Clear) -> None:
        """What is drawn has grown or shrunk: take it in again, unless the operator has moved the camera."""
        if self._corners is not None and np.allclose(corners_mm, self._corners, atol=1e-4) and clear == self._clear:
            return
        self._corners, self._clear = corners_mm, clear
        if self._set is not None and self.goal.is_near(self._set):
            self._apply(self._set.direction, self._stand)

    def aim(self, place: Vector) -> None:
        """Look at a place in the middle of the picture, which stays the same: turns go about it, the wheel nears it."""
        pose = self.pose
        if self._left is not None and np.allclose(pose.position, self._left) and not pose.is_near(self._set):
            return  # as a slow browser still has it: it was told where to stand, and has not come there yet
        moved = float(np.linalg.norm(place - pose.look_at))
        if self._pilot.goal is None and moved > _AIMED * float(np.linalg.norm(place - pose.position)):
            if pose.is_near(self._set):
                self._set = CameraPose(pose.position, place)
            self._client.camera.look_at = place

    def moved(self) -> CameraPose:
        """After a move: fit again what the canvas no longer holds, let nothing near be cut off; where it is now."""
        self.refit()
        self.come_near()
        return self.pose

    def come_near(self) -> None:
        """Let nothing near be cut off, and keep thin layers of what is far apart."""
        camera, pose = self._client.camera, self.pose
        near = near_mm(pose)
        if not 0.5 < near / camera.near < 2:
            camera.near = near

    def refit(self) -> None:
        """After the canvas changed its size: fit again, unless the operator has moved the camera since."""
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
        self._left = np.array(camera.position, float)
        with self._client.atomic():
            camera.up_direction = (0.0, 0.0, 1.0)
            camera.fov = FOV_RAD
            camera.near = near_mm(pose)
            camera.position = pose.position
            camera.look_at = pose.look_at
        self._client.flush()
