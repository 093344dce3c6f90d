"""Size of the scene in CSS pixels, and the viewing axes of its camera.

viser's camera reports pixels of the drawing buffer: several per CSS pixel on a high-resolution screen, and less than
one where viser reduces the resolution to keep the frame rate. It reports them when the camera moves, so they can belong
to an earlier buffer. The browser therefore reports the size of the scene itself.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.gui.scene.camera_presets import CameraPose, Vector, screen_axes
from wafer_viewer.gui.scene.heightfield import HeightField


class Viewport:
    """The scene of one browser.

    Its sizes are reported on several threads. Listeners are called by one at a time and read the size themselves: else
    one with an older size could be the last, and no further report would correct it.

    Parameters
    ----------
    camera : viser.CameraHandle
        Reports the size of the drawing buffer.
    """

    def __init__(self, camera: Any) -> None:
        self._camera = camera
        self._size_px = 0, 0
        self._listeners: list[Callable[[], object]] = []
        self._one_at_a_time = threading.RLock()
        camera.on_update(lambda _: self._changed())

    @property
    def width_px(self) -> int:
        """Width in CSS pixels; that of the drawing buffer before the browser has reported, and 0 before that."""
        return self._size_px[0] or self._camera.image_width

    @property
    def height_px(self) -> int:
        """Height in CSS pixels; that of the drawing buffer before the browser has reported, and 0 before that."""
        return self._size_px[1] or self._camera.image_height

    def on_change(self, listener: Callable[[], object]) -> None:
        """Call `listener` when the size may have changed."""
        self._listeners.append(listener)

    def set_size(self, width_px: int, height_px: int) -> None:
        """Set the size in CSS pixels reported by the browser; a size of zero is ignored."""
        if min(width_px, height_px) > 0 and (width_px, height_px) != self._size_px:
            self._size_px = width_px, height_px
            self._changed()

    def _changed(self) -> None:
        with self._one_at_a_time:
            for listener in tuple(self._listeners):
                listener()


_STEPS = 40
_ACROSS, _DOWN = np.linspace(0, 1, 5), np.linspace(0, 1, 2)
_NEAREST = 0.1
"""Content in front of everything stays at least this fraction of its distance away from the camera."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewAxes:
    """Camera axes and scale.

    eye: position of the camera in scene mm.
    towards: unit vector from the point looked at to the camera, `distance_mm` away.
    mm_per_pixel: pixel size at the point looked at.
    """

    eye: Vector
    towards: Vector
    distance_mm: float
    mm_per_pixel: float

    @classmethod
    def of(cls, pose: CameraPose, mm_per_pixel: float) -> ViewAxes:
        """Return the view axes of a camera pose."""
        distance_mm = float(np.linalg.norm(pose.position - pose.look_at))
        return cls(pose.position, pose.direction, distance_mm, mm_per_pixel)

    @property
    def axes(self) -> NDArray[np.float64]:
        """Right, up and towards the camera, as columns."""
        right, up = screen_axes(self.towards)
        return np.stack([right, up, self.towards], axis=1)

    @property
    def wxyz(self) -> tuple[float, float, float, float]:
        """Quaternion that makes an image in the xy plane face the camera."""
        # Euler's rotation as two half turns: about z by the azimuth, then about x by how far the camera looks down.
        x, y, z = (float(v) for v in self.towards)
        half_turn, half_fall = np.arctan2(x, -y) / 2, np.arctan2(np.hypot(x, y), z) / 2
        (s, c), (t, d) = ((float(np.sin(a)), float(np.cos(a))) for a in (half_turn, half_fall))
        return c * d, c * t, s * t, s * d

    def pixel_at(self, place: Vector) -> float:
        """Return the pixel size in mm at a point."""
        return self.mm_per_pixel * max(float((self.eye - place) @ self.towards), 0.0) / max(self.distance_mm, 1e-12)

    def before(self, height_field: HeightField, corners: Vector, spare_mm: float) -> float:
        """Return the smallest fractional shift towards the camera that clears an image of occlusion by the surface.

        corners: lower left, lower right and upper left corner of the image, [3, 3] in scene mm. The image keeps its
        position on the screen. The shift is minimal because a nearer image moves more while the camera turns.
        """
        first, right, up = corners[0], corners[1] - corners[0], corners[2] - corners[0]
        places = (first + _ACROSS[:, None, None] * right + _DOWN[:, None] * up).reshape(-1, 1, 3)
        top = height_field.on_show.scene_z(height_field.on_show.facts.highest_um) + spare_mm
        climb = self.eye[2] - float(places[..., 2].min())
        reach = (top - float(places[..., 2].min())) / climb if climb > 0 else 1.0
        share = np.linspace(0, min(max(reach, 0.0), 1.0 - _NEAREST), _STEPS)
        ways = places + (self.eye - places) * share[:, None]
        hidden = (ways[..., 2] < height_field.visible_z_mm(ways[..., 0], ways[..., 1]) + spare_mm).any(axis=0)
        return float(share[min(int(np.flatnonzero(hidden)[-1]) + 1, _STEPS - 1)]) if hidden.any() else 0.0
