"""Handles that are dragged over the surface, and the lines that connect them."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from wafer_viewer.draw.colormaps import Rgb
from wafer_viewer.gui.scene.heightfield import HeightField, Place
from wafer_viewer.gui.scene.primitives import lines
from wafer_viewer.gui.scene.viewport import ViewAxes

Dragged = Callable[[str, np.ndarray, bool], None]
"""Called in order with the handle's name, the scene point under the pointer, and True when the drag has ended."""

_WHITE: Rgb = (255, 255, 255)
_SELECTION: Rgb = (11, 110, 153)


class DragHandle:
    """A coloured ball on a white rim, of constant size on the screen. It can be dragged if `dragged` is given."""

    def __init__(
        self, scene: viser.SceneApi, name: str, colour: Rgb, radius_px: float, dragged: Dragged | None = None
    ) -> None:
        self.radius_px = radius_px
        self._rim, self._ball = (
            scene.add_icosphere(f"/tools/{name}/{part}", 1.0, tone, cast_shadow=False, receive_shadow=False)
            for part, tone in (("rim", _WHITE), ("ball", colour))
        )
        if dragged is not None:
            for part in (self._rim, self._ball):
                part.on_drag("left")(_in_order(name, dragged))

    def place(self, position: NDArray[np.float32], mm_per_pixel: float, towards: NDArray[np.float64]) -> None:
        """Move to a scene point. `towards`: direction of the camera, in which the ball protrudes from the rim."""
        radius = self.radius_px * mm_per_pixel
        for part, size, out in ((self._rim, 1.24, 0.0), (self._ball, 1.0, 0.62)):
            part.scale = radius * size
            part.position = tuple(np.asarray(position, float) + towards * radius * out)

    def remove(self) -> None:
        """Remove the handle from the scene."""
        self._rim.remove()
        self._ball.remove()


def _in_order(
    name: str, dragged: Dragged
) -> Callable[[viser.SceneNodeDragEvent[viser.IcosphereHandle]], Coroutine[Any, Any, None]]:
    # A coroutine, because viser runs plain functions on many threads and a later event could overtake an earlier one.
    async def on_drag(event: viser.SceneNodeDragEvent[viser.IcosphereHandle]) -> None:
        dragged(name, np.asarray(event.end_position, float), event.phase == "end")

    return on_drag


class CasedLine:
    """A coloured line on a white casing, updated in place so that it does not flicker."""

    def __init__(self, scene: viser.SceneApi, name: str, colour: Rgb, width_px: float) -> None:
        nothing = np.zeros((1, 2, 3), np.float32)
        self._casing = lines(scene, f"/tools/{name}/casing", nothing, _WHITE, width_px + 3.1)
        self._line = lines(scene, f"/tools/{name}/line", nothing, colour, width_px)

    def lay(self, segments: NDArray[np.float32], coloured: NDArray[np.bool_] | None, lift_mm: float) -> None:
        """Set the segments. The coloured line is lifted `lift_mm` above the casing to avoid z-fighting.

        coloured: mask of the measured segments. Unmeasured segments show the casing only. None: all are coloured.
        """
        above = segments if coloured is None or not coloured.any() else segments[coloured]
        self._casing.points = segments
        self._line.points = above + np.array([0, 0, lift_mm], np.float32)

    def remove(self) -> None:
        """Remove the line from the scene."""
        self._casing.remove()
        self._line.remove()


class PlaceMark:
    """A fixed marker on the surface."""

    def __init__(self, scene: viser.SceneApi, colour: Rgb) -> None:
        self.place: Place = (0.0, 0.0)
        self._knob = DragHandle(scene, "mark", colour, 5.0)

    def draw(self, height_field: HeightField, view_axes: ViewAxes) -> None:
        """Draw the marker on the displayed surface, or at the bottom of a hole."""
        x, y = (np.array([v]) for v in self.place)
        position = height_field.visible_points(x, y, 2 * view_axes.mm_per_pixel)[0]
        self._knob.place(position, view_axes.mm_per_pixel, view_axes.towards)

    def remove(self) -> None:
        """Remove the marker from the scene."""
        self._knob.remove()


class DrapedOutline:
    """A rectangle draped over the surface."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self.box_um = (0.0, 0.0, 0.0, 0.0)
        self._line = CasedLine(scene, "selection", _SELECTION, 2.4)

    def draw(self, height_field: HeightField, view_axes: ViewAxes) -> None:
        """Draw the rectangle on the displayed surface."""
        x0, y0, x1, y1 = self.box_um
        corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
        self._line.lay(
            height_field.drape_outline(corners, 2 * view_axes.mm_per_pixel), None, 1.6 * view_axes.mm_per_pixel
        )

    def remove(self) -> None:
        """Remove the rectangle from the scene."""
        self._line.remove()
