"""Clip box in the scene: dashed edges, and a handle on each face that is dragged along its axis."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import viser
from numpy.typing import NDArray

from wafer_viewer.draw.colormaps import Rgb
from wafer_viewer.gui.scene.drag_handles import Dragged, DragHandle
from wafer_viewer.gui.scene.heightfield import HeightField
from wafer_viewer.gui.scene.primitives import dashed, lines
from wafer_viewer.gui.scene.scene_contents import DisplayedSurface, corners_of
from wafer_viewer.gui.scene.viewport import ViewAxes
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets.callbacks import EchoFilter
from wafer_viewer.model.surface.clipping import Box, Span

NAME = "clip"
AXES = "xyz"
INK: dict[bool, Rgb] = {False: (21, 32, 43), True: (233, 238, 243)}
_BALL: Rgb = (11, 110, 153)
_BALL_PX, _LINE_PX, _DASH_PX = 8.0, 1.8, 9.0
_LEAST_SHARE = 0.01
"""Least distance of opposite faces, as a fraction of the surface's extent."""
_SKEW = 1e-3
"""Least squared sine of the angle between ray and axis; a more parallel ray does not define a point on the axis."""
_EDGES = np.array([(a, b) for a in range(8) for b in range(a + 1, 8) if bin(a ^ b).count("1") == 1])
Vector = NDArray[np.float64]


class ClipBoxFaces(NamedTuple):
    """Limits of a clip box, um: in the stage plane and in height."""

    box_um: Box
    heights_um: Span

    def ends(self, axis: int) -> tuple[float, float]:
        """Return the low and the high limit along an axis."""
        return self.heights_um if axis == 2 else (self.box_um[axis], self.box_um[axis + 2])

    def moved(self, axis: int, side: int, to_um: float) -> ClipBoxFaces:
        """Return a copy with one face moved."""
        if axis == 2:
            low, high = self.heights_um
            return self._replace(heights_um=(low, to_um) if side else (to_um, high))
        box = list(self.box_um)
        box[axis + 2 * side] = to_um
        return self._replace(box_um=(box[0], box[1], box[2], box[3]))


Moved = Callable[[ClipBoxFaces, str], ClipBoxFaces]
"""Called with the box and the dragged handle, ``x0`` to ``z1``; returns the box that applies from now on."""


class ClipBox:
    """The clip box of a view. It ignores updates that only echo its own changes."""

    def __init__(self, scene: viser.SceneApi, dragged: Dragged, moved: Moved) -> None:
        self._scene, self._dragged, self._moved = scene, dragged, moved
        self._faces: ClipBoxFaces | None = None
        self._echoes = EchoFilter[ClipBoxFaces]()
        self._knobs: dict[str, DragHandle] = {}
        self._edges: viser.LineSegmentsHandle | None = None
        self._dark = False

    def show(self, view: View, on_show: DisplayedSurface) -> None:
        """Show the clip box of a view; remove it if nothing is clipped or no points are drawn."""
        clip = view.clip
        if view.step != "surface" or view.look != "points" or (clip.box_um is None and clip.heights_um is None):
            self.remove()
            return
        if view.dark != self._dark:
            self.remove()
        self._dark = view.dark
        wanted = ClipBoxFaces(clip.box_um or on_show.box_um, clip.heights_um or on_show.heights_um)
        if self._faces is None or not self._echoes.is_echo(wanted):
            self._faces = wanted
        for axis in AXES:
            for side in (0, 1):
                key = f"{axis}{side}"
                if key not in self._knobs:
                    self._knobs[key] = DragHandle(self._scene, f"{NAME}/{key}", _BALL, _BALL_PX, self._dragged)

    def draw(self, height_field: HeightField, view_axes: ViewAxes) -> None:
        """Draw the box for the displayed surface."""
        if self._faces is None:
            return
        corners = corners_mm(self._faces, height_field.on_show)
        pixel = view_axes.mm_per_pixel
        edges = dashed(corners[_EDGES].astype(np.float32), _DASH_PX * pixel)
        if self._edges is None:
            self._edges = lines(self._scene, f"/tools/{NAME}/edges", edges, INK[self._dark], _LINE_PX)
        else:
            self._edges.points = edges
        for key, knob in self._knobs.items():
            knob.place(ball_mm(corners, key), pixel, view_axes.towards)

    def drag(self, name: str, origin: Vector, direction: Vector, on_show: DisplayedSurface) -> None:
        """Move the face of the named handle, ``clip/x0``, to the point of its axis nearest to the pointer ray."""
        key = name.split("/")[1]
        if self._faces is None or key not in self._knobs:
            return
        faces = pulled(self._faces, key, origin, direction, on_show)
        if faces is not None and faces != self._faces:
            self._faces = self._echoes.tell(self._moved(faces, key))

    def remove(self) -> None:
        """Remove the box from the scene."""
        for knob in self._knobs.values():
            knob.remove()
        if self._edges is not None:
            self._edges.remove()
        self._knobs, self._edges, self._faces = {}, None, None
        self._echoes.forget()


def corners_mm(faces: ClipBoxFaces, on_show: DisplayedSurface) -> Vector:
    """Return the eight corners in scene mm, [8, 3]. Bits 2, 1 and 0 of the index are the sides in x, y and z."""
    x0, y0, x1, y1 = (v * 1e-3 for v in faces.box_um)
    low, high = (on_show.scene_z(z_um) for z_um in faces.heights_um)
    return corners_of((x0, y0, x1, y1), low, high)


def ball_mm(corners: Vector, key: str) -> NDArray[np.float32]:
    """Return the centre of the face with a key such as ``x0``, in scene mm."""
    bit, side = 2 - AXES.index(key[0]), int(key[1])
    on_face = [k for k in range(8) if (k >> bit) & 1 == side]
    return corners[on_face].mean(axis=0).astype(np.float32)


def pulled(
    faces: ClipBoxFaces, key: str, origin: Vector, direction: Vector, on_show: DisplayedSurface
) -> ClipBoxFaces | None:
    """Return the faces after a handle is dragged to the point of its axis nearest to a ray.

    Parameters
    ----------
    faces
        Previous box, um.
    key
        Axis and side of the handle, ``x0`` to ``z1``.
    origin, direction
        Pointer ray in scene mm.
    on_show
        The surface and its exaggeration of heights.

    Returns
    -------
    ClipBoxFaces or None
        A face stays on its side of the opposite one; faces in x and y stay within the surface. None for a ray along the
        axis.
    """
    axis, side = AXES.index(key[0]), int(key[1])
    ball = ball_mm(corners_mm(faces, on_show), key).astype(float)
    along = along_axis(ball, axis, origin, direction)
    if along is None:
        return None
    x0, y0, x1, y1 = on_show.box_um
    low, high = ((x0, x1), (y0, y1), on_show.heights_um)[axis]
    to_um = on_show.height_um(along) if axis == 2 else along * 1e3
    ends, apart = faces.ends(axis), _LEAST_SHARE * (high - low)
    if axis < 2:  # refused points lie above and below the surface
        to_um = min(max(to_um, low), high)
    to_um = max(to_um, ends[0] + apart) if side else min(to_um, ends[1] - apart)
    return faces.moved(axis, side, round(to_um, 2))


def along_axis(point: Vector, axis: int, origin: Vector, direction: Vector) -> float | None:
    """Return the coordinate of the point nearest to a ray on an axis-parallel line; None for a ray along the axis."""
    unit = direction / max(float(np.linalg.norm(direction)), 1e-12)
    cosine = float(unit[axis])
    if 1 - cosine**2 < _SKEW:
        return None
    to_point = point - origin
    away = (cosine * float(unit @ to_point) - float(to_point[axis])) / (1 - cosine**2)
    return float(point[axis]) + away
