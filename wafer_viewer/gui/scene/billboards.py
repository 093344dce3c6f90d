"""Text labels in the scene that face the camera, keep a constant screen size and are never occluded."""

from __future__ import annotations

import numpy as np
import viser

from wafer_viewer.draw.colormaps import Rgb
from wafer_viewer.draw.raster_text import tag
from wafer_viewer.draw.surface import mesh
from wafer_viewer.draw.surface.mesh import painted
from wafer_viewer.gui.scene.camera_presets import Vector
from wafer_viewer.gui.scene.heightfield import HeightField
from wafer_viewer.gui.scene.viewport import ViewAxes
from wafer_viewer.model.region import Region

_FINER = 2
"""Texels per screen pixel: sharp on a high-resolution screen, halved without loss on others."""
_WHITE: Rgb = (255, 255, 255)
_SPARE_PX = 2.0


class Billboard:
    """A text label of fixed height in pixels, placed next to a scene point."""

    def __init__(self, scene: viser.SceneApi, name: str, text: str, plate: Rgb, high_px: int) -> None:
        picture = tag(text, _WHITE, plate, _FINER * high_px)
        self._wide_px, self._high_px = picture.shape[1] / _FINER, high_px
        flat = mesh.flat(-self._wide_px, -high_px / 2, 0.0, high_px / 2)
        data = painted(flat, picture, blend=True)
        self._node = scene.add_glb(f"/tools/{name}", data, cast_shadow=False, receive_shadow=False)

    def place(
        self, by: Vector, height_field: HeightField, view_axes: ViewAxes, right_px: float, up_px: float = 0.0
    ) -> None:
        """Place the label `right_px` right (negative: left) and `up_px` above a scene point, clear of any occluder."""
        pixel = view_axes.pixel_at(by)
        right, up, _ = view_axes.axes.T * pixel
        anchor = by + right * (right_px + (self._wide_px if right_px > 0 else 0)) + up * up_px
        foot = anchor - right * self._wide_px - up * self._high_px / 2
        corners = np.stack([foot, foot + right * self._wide_px, foot + up * self._high_px])
        share = view_axes.before(height_field, corners, _SPARE_PX * pixel)
        self._node.wxyz = view_axes.wxyz
        self._node.scale = pixel * (1 - share)
        self._node.position = tuple((anchor + (view_axes.eye - anchor) * share).tolist())

    def remove(self) -> None:
        """Remove the label from the scene."""
        self._node.remove()


def corner_on_screen(region: Region, height_field: HeightField, view_axes: ViewAxes, right: float, up: float) -> Vector:
    """Return a point on the edge of a region's screen extent, in scene mm.

    right, up: position within the extent, from -1 (left or lower edge) to 1 (right or upper edge).
    """
    x0, y0, x1, y1 = region.bounds_um
    x, y = np.array([x0, x1, x1, x0]), np.array([y0, y0, y1, y1])
    corners = np.stack([x * 1e-3, y * 1e-3, height_field.visible_z_mm(x * 1e-3, y * 1e-3)], axis=1)
    middle = corners.mean(axis=0)
    across, along, _ = view_axes.axes.T
    reach_x, reach_y = ((corners - middle) @ axis for axis in (across, along))
    return middle + across * _between(reach_x, right) + along * _between(reach_y, up)


def _between(values: Vector, share: float) -> float:
    low, high = float(values.min()), float(values.max())
    return low + (high - low) * (share + 1) / 2
