"""Sheet over the scene with all dies overlaid, to find defects that repeat from die to die; key Backspace."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import viser

from wafer_viewer.gui.defects.die_stack_html import FOOT_PX, HEAD_PX, PAD_PX, drawing_px, head, place_of, sheet
from wafer_viewer.gui.overlays.scene_sheet import OverScene
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.preconditions import nothing_inspected
from wafer_viewer.gui.presenters.review.defect_items import key_of, number_of
from wafer_viewer.gui.state.defect_list_state import listed
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.command import Command, with_precondition
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.gui.widgets.latest_only import LatestOnlyWorker
from wafer_viewer.model.inspection.defect import Defect, Inspection
from wafer_viewer.model.inspection.repeating_defect import RepeatedPlace
from wafer_viewer.session.rendering.comparison_views import DiePicture
from wafer_viewer.session.state.snapshot import Snapshot

WAITING_PX = 120


class DefectStack:
    """Sheet whose places and picture are computed on a worker thread and cached while they are valid."""

    def __init__(self, page: Page, look_at: Callable[[str], None]) -> None:
        self._page, self._look_at = page, look_at
        self._sheet = OverScene(page)
        self._worker = LatestOnlyWorker("dies overlaid")
        self._asked: tuple[Any, ...] | None = None
        self._defects: tuple[Defect, ...] = ()
        self._places: tuple[RepeatedPlace, ...] | None = None
        self._picture: DiePicture | None = None
        page.on_close(self._worker.close)
        page.on_pick("defect-place", lambda key: self._toggle_place_filter(int(key)))

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the sheet up to date."""
        inspection = snapshot.inspection.inspection
        if view.sheet_over != "stack" or inspection is None or snapshot.surface is None or snapshot.dataset is None:
            self._sheet.show("")
            return
        self._ask((snapshot.dataset.path, snapshot.surface.stamp, inspection.mark, inspection.recipe), inspection)
        width, height = drawing_px(inspection, self._sheet.room)
        if self._places is None:
            waits = f'{head(inspection)}<div style="height:{WAITING_PX}px">{html.empty("Comparing dies …")}</div>'
            self._sheet.show(waits, HEAD_PX + WAITING_PX + 2 * PAD_PX)
            return
        place = place_of(view.defects.numbers, self._places)
        content = sheet(inspection, self._places, self._picture, (width, height), number_of(view.review), place)
        self._sheet.show(content, height + HEAD_PX + FOOT_PX + 2 * PAD_PX)

    def commands(self) -> list[Command]:
        """Return the command that opens the sheet and then steps from place to place."""
        name, icon = "All dies overlaid, next place", viser.Icon.STACK_2
        return with_precondition(nothing_inspected, Command(name, "backspace", self.go_on, icon, group="Review"))

    def go_on(self) -> None:
        """Open the sheet; if it is open, filter by the next repeating place, and after the last one show all."""
        view, places = self._page.view, self._places or ()
        if view.sheet_over != "stack":
            self._page.change(sheet="stack")
        elif places:
            now = place_of(view.defects.numbers, places)
            self._toggle_place_filter(0 if now is None else now + 1)

    def _toggle_place_filter(self, k: int) -> None:
        """Filter by the defects of one place and show the first; choosing the same place again removes the filter."""
        page, places = self._page, self._places or ()
        new = places[k].numbers if k < len(places) else ()
        if new == page.view.defects.numbers:
            new = ()
        listing = replace(page.view.defects, numbers=new, kind="", die="")
        page.change(defects=listing)
        shown = listed(page.session.snapshot.inspection.defects, listing) if new else ()
        if shown:
            self._look_at(key_of(shown[0]))

    def _ask(self, of: tuple[Any, ...], inspection: Inspection) -> None:
        """Request the picture once per surface and reference, and the places whenever a defect changed."""
        if of != self._asked:
            self._asked, self._picture, self._places, self._defects = of, None, None, ()
        if inspection.defects is not self._defects or self._places is None:
            self._defects = inspection.defects
            look = guarded(self._page, "The dies were not overlaid")(self._look)
            self._worker.ask(lambda: look(of))

    def _look(self, of: tuple[Any, ...]) -> None:
        """Compute places and picture on the worker's thread; drop the result if the surface has changed by then."""
        views = self._page.session.defects.views
        places = views.repeats()
        if of == self._asked:
            self._places = places
            self._page.redraw()
        if of == self._asked and self._picture is None:
            picture = views.die().result()
            if of == self._asked:
                self._picture = picture or DiePicture(why_not="No die was scanned completely.")
                self._page.redraw()
