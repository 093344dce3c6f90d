"""Levelling section of the measuring panel: zero of heights from the stage or from the surface."""

from __future__ import annotations

from typing import Any

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.provenance import ZERO
from wafer_viewer.gui.scenes.scene_view import SceneView
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import BoundInput, HtmlBlock, set_prop
from wafer_viewer.model.measurement.levelling import LevelBy, Levelling
from wafer_viewer.model.measurement.tools import TOOLS

NAMES: dict[str, LevelBy] = {
    "Stage": "stage",
    "Three points": "three points",
    "Plane": "plane",
    "Region": "region",
    "Form": "form",
}
_HOW = {"three points": "Drag the points 1, 2, 3.", "region": "Drag the region Zero."}


class LevellingSection:
    """Selection of the levelling, a sentence that states it, and a link back to the stage's zero."""

    def __init__(self, page: Page, scene: SceneView) -> None:
        self._page, self._scene = page, scene
        choice = page.gui.add_dropdown("Heights from", tuple(NAMES))
        self._choice: BoundInput[str] = BoundInput(choice, self._choose, page, "The zero of heights was not changed")
        self._told = HtmlBlock(page.gui)
        page.on_pick("stage-zero", lambda _: page.change(levelling=Levelling(), range_um=None))

    def show(self, view: View) -> None:
        """Bring the section up to date."""
        reads_heights = view.tool == "none" or not TOOLS[view.tool].on_picture
        set_prop(self._choice.handle, "visible", reads_heights)
        if not reads_heights:
            self._told.show("")
            return
        by = view.levelling.by
        self._choice.show(next(name for name, way in NAMES.items() if way == by))
        back = f' <span class="wv-link" {html.pick("stage-zero")}>Back to the stage</span>' if by != "stage" else ""
        how = f" {_HOW[by]}" if by in _HOW else ""
        told = f"Heights are read from {ZERO[by]}.{how}"
        self._told.show(f'<div class="wv-zero{" on" if by != "stage" else ""}">{html.safe(told)}{back}</div>')

    def _choose(self, event: Any) -> None:
        levelling = self._scene.first_levelling(NAMES[event.target.value])
        self._page.change(levelling=levelling, range_um=None)
