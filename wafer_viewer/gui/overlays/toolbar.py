"""Toolbar, top left: camera views, and in Measure the tools before them."""

from __future__ import annotations

from collections.abc import Sequence
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
        if view.sheet_over != "none" or view.at_bench:  # what lies over the scene would lie over the tools
            self._panel.show("")
            return
        measuring = view.step == "measure"
        scene_px = self._viewport.width_px
        short = measuring or 0 < scene_px < NARROW_SCENE_PX
        looks = Markup("").join(_preset(*preset, short=short) for preset in WAYS_TO_LOOK)
        parts = tool_strip(view.tool) + GAP + looks if measuring else looks
        if view.step == "surface":
            parts += GAP + _select(view.selecting)
        if view.step == "plan":
            parts = sample_or_live(live=False) + GAP + parts
        if view.step == "gauge":
            parts = blocks_or_instrument(view.instrument) + GAP + parts
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


def sample_or_live(live: bool) -> Markup:
    """Return the choice between the sample and the live view in Plan."""
    ways = (("sample", "Sample", viser.Icon.MAP_2, not live), ("live", "Live", viser.Icon.VIDEO, live))
    return _ways("plan-look", ways, " · C")


def blocks_or_instrument(instrument: bool) -> Markup:
    """Return the choice between the gauge blocks and the calibrations of the instrument in Gauge check."""
    ways = (
        ("blocks", "Blocks", viser.Icon.CERTIFICATE, not instrument),
        ("instrument", "Instrument", viser.Icon.MICROSCOPE, instrument),
    )
    return _ways("gauge-look", ways)


def _ways(what: str, ways: Sequence[tuple[str, str, Any, bool]], key_hint: str = "") -> Markup:
    """Return a choice between looks of a step: key, name, icon, and whether it is the present one."""
    return Markup("").join(
        Markup('<span{on} title="{name}{hint}" aria-pressed="{pressed}" {pick}>{icon}{name}</span>').format(
            on=Markup(' class="on"') if on else "",
            name=name,
            hint=key_hint,
            pressed=str(on).lower(),
            pick=html.pick(what, key),
            icon=html.icon(sign, 17),
        )
        for key, name, sign, on in ways
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
