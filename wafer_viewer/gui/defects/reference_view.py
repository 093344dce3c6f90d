"""Sheet over the scene that compares the defect under review with other dies and the last scan; key Z."""

from __future__ import annotations

from typing import Any

import viser

from wafer_viewer.gui.defects.reference_view_html import HEAD_PX, PAD_PX, Sizes, head, sheet
from wafer_viewer.gui.overlays.scene_sheet import OverScene
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.preconditions import no_defect
from wafer_viewer.gui.presenters.review.defect_items import chosen_defect
from wafer_viewer.gui.presenters.review.review_items import neighbour
from wafer_viewer.gui.state.view_state import OF_DEFECT, View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.command import Command, with_precondition
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.gui.widgets.latest_only import LatestOnlyWorker
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.inspection.defect import Defect
from wafer_viewer.session.rendering.comparison_views import ComparisonViews
from wafer_viewer.session.state.snapshot import Snapshot

WAITING_PX = 120
Asked = tuple[Any, ...]


class DefectBeside:
    """Comparison sheet of the defect under review; its pictures are requested on a worker thread."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._sheet = OverScene(page)
        self._worker = LatestOnlyWorker("a defect compared")
        self._asked: Asked | None = None
        self._answer: ComparisonViews | None = None
        self._told = ""
        page.on_close(self._worker.close)
        page.on_pick("sheet", lambda which: page.change(sheet=which))

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the sheet up to date."""
        defect = chosen_defect(snapshot, view.review) if view.sheet_over == "beside" else None
        if defect is None or snapshot.surface is None or snapshot.dataset is None:
            self._sheet.show("")
            return
        recipe = snapshot.inspection.inspection.recipe if snapshot.inspection.inspection is not None else None
        self._ask((defect.number, defect.outline, snapshot.dataset.path, snapshot.surface.stamp, recipe))
        sizes = Sizes.within(self._sheet.room)
        if self._answer is not None:
            self._sheet.show(sheet(defect, self._answer, sizes), sizes.sheet_px)
        else:
            self._sheet.show(_placeholder_html(defect, self._told), HEAD_PX + WAITING_PX + 2 * PAD_PX)

    def commands(self) -> list[Command]:
        """Return the command that opens and closes the sheet."""
        icon = viser.Icon.LAYOUT_COLUMNS
        return with_precondition(no_defect, Command("Compare the defect", "Z", self.toggle, icon, group="Review"))

    def toggle(self) -> None:
        """Open or close the sheet."""
        shown = self._page.view.sheet_over == "beside"
        self._page.change(sheet="none" if shown else "beside")

    def _ask(self, asked: Asked) -> None:
        """Request the pictures, once per defect and surface."""
        if asked != self._asked:
            self._asked, self._answer, self._told = asked, None, ""
            look = guarded(self._page, "The pictures were not made")(self._look)
            self._worker.ask(lambda: look(asked))

    def _look(self, asked: Asked) -> None:
        """Fetch the pictures on the worker's thread; drop them if another defect is under review by then."""
        answer, told = None, "This place was not scanned."
        try:
            answer = self._page.session.defects.views.beside(asked[0]).result()
        except WaferViewerError as fault:
            told = str(fault)
        if asked == self._asked:
            self._answer, self._told = answer, told
            self._page.redraw()
            self._make_next(asked[0])

    def _make_next(self, number: int) -> None:
        """Request the pictures of the next defect ahead of time; the painter caches them."""
        page = self._page
        view, snapshot = page.view, page.session.snapshot
        item = neighbour(snapshot, f"{OF_DEFECT}{number}", 1, view.review_filter, view.defects)
        if item is not None and item.defect not in (None, number):
            page.session.defects.views.beside(item.defect)


def _placeholder_html(defect: Defect, told: str) -> str:
    """Return the placeholder shown until the pictures are ready, or if there are none, as HTML."""
    said = html.empty(html.with_micro_sign(told) if told else "Making the pictures …")
    return f'{head(defect)}<div style="height:{WAITING_PX}px">{said}</div>'
