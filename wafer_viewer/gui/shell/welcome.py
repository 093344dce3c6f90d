"""Start card: plan a scan, open a dataset, import images, or take the tour."""

from __future__ import annotations

import viser

from wafer_viewer.gui.page.import_export_dialogs import import_dialog, open_dialog
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.command import Command
from wafer_viewer.gui.widgets.controls import HtmlBlock, button, leading, outlined, set_prop
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.session.state.snapshot import Snapshot

WIDTH_PX, HEIGHT_PX = 380, 318
TOUR_TIME = "about 2 min"
"""Measured by tests/bench/bench_tour.py, including reading time."""


class Welcome:
    """Card shown while there is neither a plan nor a dataset."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._place = (0, 0)
        self._away = False
        gui = page.gui
        self._panel = gui.add_panel(visible=False)
        with self._panel.add_tab("Start"):
            gui.add_html('<div class="wv-card"></div>')
            HtmlBlock(gui, _HEAD)
            plan = button(
                gui, "Plan a scan", viser.Icon.LAYOUT_GRID, guarded(page, "There is no plan")(lambda _: self._plan())
            )
            leading(gui, plan, 46, sticky=False)
            outlined(gui, button(gui, "Open a dataset…", viser.Icon.FOLDER_OPEN, lambda _: open_dialog(page)), 42)
            outlined(gui, button(gui, "Import images…", viser.Icon.PHOTO_PLUS, lambda _: import_dialog(page)), 42)
            self._tour = HtmlBlock(gui)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Show or hide the card."""
        first = snapshot.draft.job is None and snapshot.dataset is None and view.step == "plan" and not self._away
        set_prop(self._panel, "visible", first)
        if not first:
            return
        self._centre()
        link = f'<span class="wv-link" {html.pick("tour")}>Take the tour on the virtual rig</span>, {TOUR_TIME}'
        way = link if snapshot.rig.limits is not None else "The virtual rig is starting …"
        tour = f"No sample at hand? &ensp;{way}" if snapshot.rig.simulated else ""
        self._tour.show(f'<div class="wv-lab" style="text-align:center;padding:4px 0 6px">{tour}</div>')

    def commands(self) -> list[Command]:
        """Return the command that plans a scan."""
        icon = viser.Icon
        return [Command("Plan a scan", None, self._go_and_plan, icon.LAYOUT_GRID, group="Plan")]

    def _go_and_plan(self) -> None:
        self._page.change(step="plan", why=None)
        self._plan()

    def _plan(self) -> None:
        """Cover the sample in the rig's overview; without an overview, hide the card so that the form can be used."""
        if self._page.session.snapshot.overview is None:
            self._away = True
            self._page.redraw()
        else:
            self._page.ask("There is no plan", self._page.session.cover_sample())

    def _centre(self) -> None:
        viewport = self._page.viewport
        place = ((viewport.width_px - WIDTH_PX) // 2, max(70, (viewport.height_px - HEIGHT_PX) // 2))
        if place != self._place and viewport.width_px > 0:
            self._place = place
            self._panel.float(x=max(0, place[0]), y=place[1], width=WIDTH_PX)


_HEAD = (
    '<div class="wv-hello"><b>Start with a sample</b>'
    "<span>Lay a field grid on it and scan, or open<br>what was measured before.</span></div>"
)
