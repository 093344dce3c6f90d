"""Camera of one browser: presets, framing of regions and saved poses."""

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
        self._left: Vector | None = None
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
        if self._left is not None and np.allclose(pose.position, self._left) and not pose.is_near(self._set):
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
