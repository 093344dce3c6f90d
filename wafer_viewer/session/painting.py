"""How each thing the page asks for is made. Runs in the painter's process and imports what is heavy."""

from __future__ import annotations

from collections.abc import Callable

from wafer_viewer.session import paint_frames, paint_like, paint_parts, paint_pictures, paint_statistics, paint_whole
from wafer_viewer.session.paint_request import PaintRequest
from wafer_viewer.session.shelf import Shelf

PAINTERS: dict[str, Callable[[Shelf, PaintRequest], bytes]] = {
    "facts": paint_whole.facts,
    "scale": paint_whole.scale,
    "relief": paint_whole.relief,
    "tile": paint_parts.tile,
    "flat": paint_parts.flat,
    "points": paint_parts.points,
    "walls": paint_parts.walls,
    "frame": paint_frames.frame,
    "slice": paint_frames.stitched,
    "picture": paint_pictures.picture,
    "beside": paint_like.beside,
    "die": paint_like.die,
    "statistics": paint_statistics.statistics,
}


def paint(shelf: Shelf, request: PaintRequest) -> bytes:
    """Make what a request asks for; no bytes when there is nothing to be seen. Raises WaferViewerError."""
    return PAINTERS[request.what](shelf, request)
