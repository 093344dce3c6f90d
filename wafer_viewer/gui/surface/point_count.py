"""Overlay below the toolbar with the number of drawn points and the reasons for the others."""

from __future__ import annotations

import math
import re

from wafer_viewer.gui.overlays.colour_legend import WIDTH_PX as LEGEND_PX
from wafer_viewer.gui.overlays.hud import EDGE_PX
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.surface.points_section import counted
from wafer_viewer.gui.widgets.controls import FloatingPanel
from wafer_viewer.session.state.snapshot import Snapshot

_LEAST_PX, _MOST_PX = 230, 760
_LINE_PX, _EDGES_PX, _LETTER_PX, _BELOW_TOOLBAR_PX = 18, 14, 7.2, 48
"""Pixels; _LETTER_PX: upper bound of the average width of a letter."""


class PointCount:
    """Overlay shown while points are drawn and counted; its width leaves space for the colour bar."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._glass = FloatingPanel(page.gui, EDGE_PX, EDGE_PX + _BELOW_TOOLBAR_PX, _MOST_PX, _LINE_PX + _EDGES_PX)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the count up to date."""
        told = self._page.statistics
        there = view.step in ("surface", "measure") and view.look == "points" and view.counted == "all"
        if not there or told is None or not told.counts:
            self._glass.show("")
            return
        words = counted(told, self._page.drawn_points, view)
        width_px, height_px = size_px(words, self._page.client.camera.image_width)
        self._glass.show(f'<div class="wv-glass wv-points">{words}</div>', width_px=width_px, height_px=height_px)


def size_px(words: str, scene_px: int) -> tuple[int, int]:
    """Return width and height of the overlay for a text in HTML, given the width of the scene."""
    n_letters = len(re.sub("<[^>]*>", "", words))
    width_px = min(_MOST_PX, max(_LEAST_PX, scene_px - LEGEND_PX - 3 * EDGE_PX))
    n_lines = math.ceil(n_letters * _LETTER_PX / (width_px - 2 * _EDGES_PX))
    return width_px, n_lines * _LINE_PX + _EDGES_PX
