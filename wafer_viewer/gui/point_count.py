"""Top left on glass below the toolbar: how many of how many points are drawn, and where the rest is."""

from __future__ import annotations

from wafer_viewer.gui.kit import Overlay
from wafer_viewer.gui.overlays import EDGE_PX
from wafer_viewer.gui.page import Page
from wafer_viewer.gui.points_section import counted
from wafer_viewer.gui.view import View
from wafer_viewer.session.state import Snapshot

_WIDTH_PX, _HEIGHT_PX, _BELOW_TOOLBAR_PX = 560, 32, 48


class PointCount:
    """There wherever points are drawn and counted."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._glass = Overlay(page.gui, EDGE_PX, EDGE_PX + _BELOW_TOOLBAR_PX, _WIDTH_PX, _HEIGHT_PX)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the count up to date."""
        told = self._page.statistics
        there = view.step in ("surface", "measure") and view.look == "points" and view.counted == "all"
        if not there or told is None or not told.counts:
            self._glass.show("")
            return
        words = counted(told, self._page.drawn_points, view)
        self._glass.show(f'<div class="wv-glass wv-points">{words}</div>')
