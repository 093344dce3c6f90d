"""Colour legend with histogram, top right in all steps that show a surface except Gauge check."""

from __future__ import annotations

from wafer_viewer.draw.charts.colour_bar import LINE_PX, colour_bar_html, origin_legend_html
from wafer_viewer.draw.surface.display_style import QUANTITIES
from wafer_viewer.gui.overlays.hud import EDGE_PX
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.scene.lod.surface_tiles import OWN_COLOURS
from wafer_viewer.gui.state.view_state import ColourBy, View
from wafer_viewer.gui.widgets.controls import FloatingPanel
from wafer_viewer.session.rendering.render_request import ColourScale
from wafer_viewer.session.state.snapshot import Snapshot

WIDTH_PX, HEAD_AND_FOOT_PX = 124, 78
MOST_BAR_PX, LEAST_BAR_PX = 320, 110
BELOW_PX = 96
"""Height reserved below the bar for the read-out."""
ORIGIN_ROW_PX, ORIGINS_EDGES_PX = 23, 18
SIGNED = ("height", "deviation", "form", "difference")


class ColourLegend:
    """Colour bar over the scene, as high as the scene allows."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._glass = FloatingPanel(page.gui, -EDGE_PX, EDGE_PX, WIDTH_PX, MOST_BAR_PX + HEAD_AND_FOOT_PX)
        self._of_origins = FloatingPanel(page.gui, -EDGE_PX, EDGE_PX, 236, _origins_px(1), align="right")

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Update the legend."""
        scale = self._page.scale if view.on_surface and view.step != "gauge" else None
        of_origins = scale is not None and scale.quantity == "origin"
        bar_px = self._bar_px()
        bar = _bar(scale, view, self._page.coloured_by(view), bar_px) if scale is not None and not of_origins else ""
        self._glass.show(_on_glass(bar), height_px=bar_px + HEAD_AND_FOOT_PX + 2 + _foot_px(scale))
        origins = scale.origins if scale is not None and of_origins else {}
        rows = sum(share > 0 for share in origins.values())
        self._of_origins.show(_on_glass(origin_legend_html(origins) if rows else ""), height_px=_origins_px(rows))

    def _bar_px(self) -> int:
        room = self._page.viewport.height_px - EDGE_PX - HEAD_AND_FOOT_PX - BELOW_PX
        return min(MOST_BAR_PX, max(LEAST_BAR_PX, room // 10 * 10))


def _foot_px(scale: ColourScale | None) -> int:
    """Return the height of the line that explains grey; 0 if it is not shown."""
    return LINE_PX if scale is not None and scale.quantity == "overlap" else 0


def _origins_px(rows: int) -> int:
    """Return the height of a legend with `rows` origins."""
    return ORIGIN_ROW_PX * rows + ORIGINS_EDGES_PX


def _bar(scale: ColourScale, view: View, quantity: ColourBy, bar_px: int) -> str:
    title, unit = QUANTITIES[quantity]
    colours = OWN_COLOURS.get(quantity, view.colours)
    return colour_bar_html(
        title,
        unit,
        scale.low,
        scale.high,
        colours,
        scale.counts,
        height_px=bar_px,
        signed=quantity in SIGNED,
        elsewhere="one field only" if quantity == "overlap" else "",
    )


def _on_glass(content: str) -> str:
    return content and f'<div class="wv-glass">{content}</div>'
