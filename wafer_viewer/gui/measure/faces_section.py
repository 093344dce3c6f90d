"""Button of the step tool that places its regions on the two faces of a pair of gauge blocks."""

from __future__ import annotations

from typing import Any

import viser

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import HtmlBlock, button, outlined, set_prop
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.gui.widgets.latest_only import LatestOnlyWorker
from wafer_viewer.model.errors import WaferViewerError

FIND, LOOKING = "Find the faces", "Looking for the faces …"


class FacesSection:
    """Button of the step tool, with the reason below it if no faces were found."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._worker = LatestOnlyWorker("faces of a step")
        self._looking, self._problem = False, ""
        page.on_close(self._worker.close)
        self._button = button(
            page.gui, FIND, viser.Icon.SEARCH, guarded(page, "The faces were not found")(self._look_for)
        )
        outlined(page.gui, self._button)
        self._why = HtmlBlock(page.gui)

    def show(self, view: View, *, kept: bool) -> None:
        """Bring the section up to date; it is shown for the step tool while no saved result is selected."""
        there = view.tool == "step" and not kept
        set_prop(self._button, "visible", there)
        set_prop(self._button, "disabled", self._looking)
        set_prop(self._button, "label", LOOKING if self._looking else FIND)
        told = self._problem if there and not self._looking else ""
        self._why.show(f'<div class="wv-why">{html.safe(html.with_micro_sign(told))}</div>' if told else "")

    def _look_for(self, _: Any) -> None:
        if not self._looking:
            self._looking, self._problem = True, ""
            self._worker.ask(lambda: guarded(self._page, "The faces were not found")(self._find)())
            self._page.redraw()

    def _find(self) -> None:
        before = self._page.view
        try:
            found = self._page.session.gauge.find_faces(max(0, before.show))
            if self._page.view.tool == "step":
                self._page.change(places=found)
        except WaferViewerError as fault:
            self._problem = str(fault)
        finally:
            self._looking = False
            self._page.redraw()
