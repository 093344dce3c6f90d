"""Dispatch of render requests by kind. Runs in the render process and imports the heavy modules."""

from __future__ import annotations

from collections.abc import Callable

from wafer_viewer.session.rendering import (
    render_comparisons,
    render_frames,
    render_statistics,
    render_summary,
    render_thumbnails,
    render_tiles,
)
from wafer_viewer.session.rendering.render_request import RenderRequest
from wafer_viewer.session.rendering.surface_source import SurfaceProvider

PAINTERS: dict[str, Callable[[SurfaceProvider, RenderRequest], bytes]] = {
    "facts": render_summary.facts,
    "scale": render_summary.scale,
    "relief": render_summary.relief,
    "tile": render_tiles.tile,
    "flat": render_tiles.flat,
    "points": render_tiles.points,
    "walls": render_tiles.walls,
    "frame": render_frames.frame,
    "slice": render_frames.stitched,
    "picture": render_thumbnails.picture,
    "beside": render_comparisons.beside,
    "die": render_comparisons.die,
    "statistics": render_statistics.statistics,
}


def paint(shelf: SurfaceProvider, request: RenderRequest) -> bytes:
    """Execute a render request; no bytes when nothing is visible. Raises WaferViewerError."""
    return PAINTERS[request.what](shelf, request)
