"""Size of the scene in CSS pixels, the unit of all panels and of everything on glass.

viser's camera counts the pixels of the drawing buffer: on a screen of high resolution they are several to a CSS pixel,
and fewer than one where viser draws coarser to keep up.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class Viewport:
    """The scene of one browser.

    Parameters
    ----------
    camera : viser.CameraHandle
        Reports the size of the drawing buffer.
    """

    def __init__(self, camera: Any) -> None:
        self._camera = camera
        self._ratio = 1.0
        self._listeners: list[Callable[[], object]] = []
        camera.on_update(lambda _: self._changed())

    @property
    def width_px(self) -> int:
        """Width in CSS pixels; 0 before the browser has said."""
        return round(self._camera.image_width / self._ratio)

    @property
    def height_px(self) -> int:
        """Height in CSS pixels; 0 before the browser has said."""
        return round(self._camera.image_height / self._ratio)

    def on_change(self, listener: Callable[[], object]) -> None:
        """Call `listener` when the size may have changed."""
        self._listeners.append(listener)

    def set_ratio(self, drawn: float) -> None:
        """Set how many pixels of the drawing buffer make a CSS pixel; a ratio that cannot be is ignored."""
        if drawn > 0 and drawn != self._ratio:
            self._ratio = drawn
            self._changed()

    def _changed(self) -> None:
        for listener in tuple(self._listeners):
            listener()
