"""Camera pose saved in the browser and restored after a reload, before the first picture."""

from __future__ import annotations

import numpy as np

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.scene.camera.camera_presets import CameraPose
from wafer_viewer.gui.scenes.scene_view import SceneView
from wafer_viewer.gui.state.browser_storage import SavedCamera, keep_standpoint
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.session.state.snapshot import Snapshot

MOVED_MM = 1e-5


class Viewpoint:
    """Saves and restores the camera pose of a dataset or step."""

    def __init__(self, page: Page, scene: SceneView) -> None:
        self._page, self._scene = page, scene
        self._kept: SavedCamera | None = None

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Restore the camera pose on the first call; save it later whenever it has changed."""
        of = camera_key(snapshot, view)
        if self._kept is None:
            self._kept = self._page.recalled.standpoint
            if self._kept.of == of:
                self._scene.reopen(CameraPose(np.array(self._kept.position_mm), np.array(self._kept.look_at_mm)))
            return
        pose = self._scene.pose
        if pose is not None and not (of == self._kept.of and _same(pose, self._kept)):
            self._kept = SavedCamera(of, _vector(pose.position), _vector(pose.look_at))
            keep_standpoint(self._page.client, self._kept)


def camera_key(snapshot: Snapshot, view: View) -> str:
    """Return the key of a camera pose: the dataset's path on a surface, else the step."""
    data = snapshot.dataset
    return f"{data.path}" if view.on_surface and data is not None else view.step


def _same(pose: CameraPose, kept: SavedCamera) -> bool:
    now = (*_vector(pose.position), *_vector(pose.look_at))
    return all(abs(a - b) < MOVED_MM for a, b in zip(now, (*kept.position_mm, *kept.look_at_mm), strict=True))


def _vector(place: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in place)
    return x, y, z
