"""Dispatch of render requests by kind. Runs in the render process and imports the heavy modules."""

from __future__ import annotations

from collections.abc import Callable

from wafer_viewer.session.rendering import render_comparisons, render_pictures, render_statistics
from wafer_viewer.session.rendering.render_request import RenderRequest
from wafer_viewer.session.rendering.surface_source import SurfaceProvider

PAINTERS: dict[str, Callable[[SurfaceProvider, RenderRequest], bytes]] = {
    "facts": render_statistics.facts,
    "scale": render_statistics.scale,
    "relief": render_statistics.relief,
    "tile": render_pictures.tile,
    "flat": render_pictures.flat,
    "points": render_pictures.points,
    "walls": render_pictures.walls,
    "frame": render_pictures.frame,
    "slice": render_pictures.stitched,
    "picture": render_pictures.picture,
    "beside": render_comparisons.comparison,
    "die": render_comparisons.die,
    "statistics": render_statistics.statistics,
}


def paint(provider: SurfaceProvider, request: RenderRequest) -> bytes:
    """Execute a render request; no bytes when nothing is visible. Raises WaferViewerError."""
    return PAINTERS[request.what](provider, request)
