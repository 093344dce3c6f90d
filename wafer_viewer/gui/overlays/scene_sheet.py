"""A sheet that lies over the scene: as wide as that, as high as what it shows."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.gui.overlays.hud import EDGE_PX
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.widgets.controls import HtmlBlock, set_prop

FIRST_PX = 892, 640
"""Until the browser has said how large its scene is."""
BORDER_PX = 18
"""viser cuts a panel's content at the bottom unless the panel is so much higher."""


@dataclass(frozen=True, slots=True)
class SheetRoom:
    """How much of the page a sheet may take."""

    width_px: int
    height_px: int


class OverScene:
    """The sheet; the page is drawn again when the scene has another size."""

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
        """What it may take now."""
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
