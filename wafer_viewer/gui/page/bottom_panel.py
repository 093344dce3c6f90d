"""Panel below the scene, as wide as the scene, for one curve at a time."""

from __future__ import annotations

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import Below, View
from wafer_viewer.gui.widgets.controls import set_prop
from wafer_viewer.gui.widgets.style import PROFILE_PX

FIRST_WIDTH_PX = 892
"""Initial width, until the browser reports the width of its scene."""


def bottom_panel_height_px(view: View) -> int:
    """Return the height of the bottom panel in CSS pixels; 0 if no curve is shown."""
    return PROFILE_PX if view.below != "none" else 0


class BottomPanel:
    """Panel that is visible while the view shows its curve; add contents `with tab:`."""

    def __init__(self, page: Page, curve: Below) -> None:
        self._curve = curve
        self._panel = page.gui.add_panel(visible=False)
        self.tab = self._panel.add_tab(curve.capitalize())
        with self.tab:
            page.gui.add_html('<div class="wv-bottom"></div>')
        self._panel.float(x=0, y=-1, width=FIRST_WIDTH_PX, height=PROFILE_PX)
        self._width = 0
        page.viewport.on_change(lambda: self._follow(page.viewport.width_px))

    def show(self, view: View) -> bool:
        """Show or hide the panel by the view; return whether it is visible."""
        there = view.below == self._curve
        set_prop(self._panel, "visible", there)
        return there

    def _follow(self, width_px: int) -> None:
        """Match the width of the scene, which depends on the side panels."""
        if width_px not in (0, self._width):
            self._width = width_px
            self._panel.set_width(width_px)
