"""Gauge block faces in the scene: regions of the step tool, on blocks drawn without exaggeration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.model.measurement.levelling import Levelling
from wafer_viewer.model.measurement.tool_options import ToolOptions
from wafer_viewer.model.region import Region
from wafer_viewer.session.state.snapshot import SurfaceInfo

_SHARE = 0.28
"""Side of a default face, as a fraction of the surface's side."""


def in_scene(view: View, surface: SurfaceInfo | None = None) -> View:
    """Return the view for the scene; it differs from the page's view only in Gauge check.

    surface: the displayed surface. Its colour range is widened, so that no face is drawn black or white.
    """
    if view.step != "gauge":
        return view
    dragged = bool(view.faces) and view.check is None
    return replace(
        view,
        show=max(0, view.show),
        tool="step" if dragged else "none",
        places=view.faces,
        options=ToolOptions(),
        levelling=Levelling(),
        exaggeration=1.0,
        colour_by="height",
        range_um=_colours_of(surface) if surface is not None else None,
        frame_k=None,
        slice_z_um=None,
        selected=None,
    )


def _colours_of(surface: SurfaceInfo) -> tuple[float, float]:
    low, high = surface.low_um, surface.high_um
    span = max(high - low, 1e-6)
    return low - 0.55 * span, high + 0.25 * span


def take_places(page: Page) -> Callable[[tuple[Region, ...]], None]:
    """Return a callback that stores dragged regions: as gauge faces in Gauge check, else as regions of the tool."""

    def take(places: tuple[Region, ...]) -> None:
        if page.view.step == "gauge":
            page.change(faces=places)
        else:
            page.change(places=places, selected=None)

    return take


def default_faces(surface: SurfaceInfo) -> tuple[Region, Region]:
    """Return two default faces side by side, to be dragged into position."""
    width, height = surface.cols * surface.pixel_um, surface.rows * surface.pixel_um
    y = surface.y0_um - height / 2

    def face(share: float) -> Region:
        x = surface.x0_um + share * width
        half_x, half_y = _SHARE * width / 2, _SHARE * height / 2
        return Region.rectangle(*(round(um, 2) for um in (x - half_x, y - half_y, x + half_x, y + half_y)))

    return face(0.72), face(0.28)
