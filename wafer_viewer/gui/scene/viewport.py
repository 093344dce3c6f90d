"""Size of the scene in CSS pixels, the unit of all panels and overlays.

viser's camera reports pixels of the drawing buffer: several per CSS pixel on a high-resolution screen, and less than
one where viser reduces the resolution to keep the frame rate. It reports them when the camera moves, so they can belong
to an earlier buffer. The browser therefore reports the size of the scene itself.
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
        self._size_px = 0, 0
        self._listeners: list[Callable[[], object]] = []
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
        for listener in tuple(self._listeners):
            listener()
