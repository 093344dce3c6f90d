"""Sheet over the scene: as wide as the scene, as high as its content."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.gui.overlays.hud import EDGE_PX
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.widgets.controls import HtmlBlock, set_prop

FIRST_PX = 892, 640
"""Initial size, until the browser reports the size of its scene."""
BORDER_PX = 18
"""Extra height of the panel, without which viser clips its content at the bottom."""


@dataclass(frozen=True, slots=True)
class SheetRoom:
    """Available size of a sheet in CSS pixels."""

    width_px: int
    height_px: int


class OverScene:
    """Sheet over the scene; the page is redrawn when the size of the scene changes."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._panel = page.gui.add_panel(visible=False)
        with self._panel.add_tab("·"):
            self._cell = HtmlBlock(page.gui, padded=False)
        self._place = (0, 0)
        self._size = FIRST_PX
        page.viewport.on_change(lambda: self._follow(page.viewport.width_px, page.viewport.height_px))

    @property
    def room(self) -> SheetRoom:
        """Available size at present."""
        width, height = self._size
        return SheetRoom(max(360, width - 2 * EDGE_PX), max(240, height - 2 * EDGE_PX))

    def show(self, content: str, height_px: int = 0) -> None:
        """Show `content`, or nothing when it is empty."""
        if content and (self.room.width_px, height_px) != self._place:
            self._place = self.room.width_px, height_px
            self._panel.float(x=EDGE_PX, y=EDGE_PX, width=self._place[0], height=height_px + BORDER_PX)
        self._cell.show(content and f'<div class="wv-ov wv-over"><div class="wv-sheet-over">{content}</div></div>')
        set_prop(self._panel, "visible", bool(content))

    def _follow(self, width_px: int, height_px: int) -> None:
        if (width_px, height_px) != self._size and width_px > 0 and height_px > 0:
            self._size = width_px, height_px
            self._page.redraw()
