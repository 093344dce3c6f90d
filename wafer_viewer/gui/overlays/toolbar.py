"""Toolbar, top left: camera views, and in Measure the tools before them."""

from __future__ import annotations

from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.gui.overlays.hud import EDGE_PX
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.tools.tool_palette import GAP, tool_strip
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import FloatingPanel
from wafer_viewer.session.state.snapshot import Snapshot

WAYS_TO_LOOK = (
    ("top", "Top", "Look from above · T", viser.Icon.SQUARE),
    ("front", "Front", "Look from the front · F", viser.Icon.PERSPECTIVE),
    ("iso", "Iso", "Three-quarter view · I", viser.Icon.CUBE),
    ("all", "Fit", "Show all · Home", viser.Icon.FOCUS_2),
)
_WIDTH_PX, _HEIGHT_PX = 520, 42
NARROW_SCENE_PX = 640
"""Scene width below which the toolbar shows icons only, to clear the legend."""
_SIDE_TOOLS_PX = 124 + 2 * EDGE_PX + 8
"""Width reserved for the colour bar: in a narrow scene the tools take two rows."""


class Toolbar:
    """Toolbar of camera views and tools; views have labels unless the tools need the space."""

    def __init__(self, page: Page) -> None:
        self._panel = FloatingPanel(page.gui, EDGE_PX, EDGE_PX, _WIDTH_PX, _HEIGHT_PX)
        self._viewport = page.viewport

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Update the toolbar."""
        if view.sheet_over != "none":  # what lies over the scene would lie over the tools
            self._panel.show("")
            return
        measuring = view.step == "measure"
        scene_px = self._viewport.width_px
        short = measuring or 0 < scene_px < NARROW_SCENE_PX
        looks = Markup("").join(_preset(*preset, short=short) for preset in WAYS_TO_LOOK)
        parts = tool_strip(view.tool) + GAP + looks if measuring else looks
        if view.step == "surface":
            parts += GAP + _select(view.selecting)
        two_rows = measuring and 0 < scene_px < NARROW_SCENE_PX
        room = (
            Markup(' style="flex-wrap:wrap;max-width:{}px"').format(scene_px - _SIDE_TOOLS_PX - EDGE_PX)
            if two_rows
            else Markup()
        )
        content = Markup('<div class="wv-glass wv-tools{}"{}>{}</div>').format(
            " many" if measuring else "", room, parts
        )
        self._panel.show(content, height_px=2 * _HEIGHT_PX if two_rows else _HEIGHT_PX)


def _preset(key: str, name: str, hint: str, sign: Any, short: bool) -> Markup:
    words = "" if short else name
    label = Markup('title="{}" aria-label="{}"').format(hint, name)
    return Markup("<span {label} {pick}>{icon}{words}</span>").format(
        label=label, pick=html.pick("look", key), icon=html.icon(sign, 17), words=words
    )


def _select(selecting: bool) -> Markup:
    """Return the Select toggle: if on, a drag over the scene selects; with Shift it always does."""
    label = Markup('title="Select an area · or drag with Shift" aria-label="Select" aria-pressed="{}"').format(
        str(selecting).lower()
    )
    on = Markup(' class="on"') if selecting else Markup()
    return Markup("<span{on} {label} {pick}>{icon}Select</span>").format(
        on=on, label=label, pick=html.pick("select"), icon=html.icon(viser.Icon.MARQUEE_2, 17)
    )
