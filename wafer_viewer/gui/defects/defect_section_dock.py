"""Bottom panel with the profile through the defect under review, and the same row of a neighbouring die."""

from __future__ import annotations

from collections.abc import Iterator

from wafer_viewer.draw.charts.profile_axes import frame_of
from wafer_viewer.draw.charts.profile_plot import profile_plot_html
from wafer_viewer.draw.colormaps import PROFILE_COLOURS
from wafer_viewer.gui.page.bottom_panel import BottomPanel
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.measurement import format_quantity
from wafer_viewer.gui.presenters.review.defect_items import chosen_defect
from wafer_viewer.gui.presenters.review.defect_sections import DefectCut, cut_through
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import HtmlBlock
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.gui.widgets.latest_only import LatestOnlyWorker
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.inspection.defect import Defect
from wafer_viewer.model.measurement.sections import Section, SectionAsked
from wafer_viewer.session.state.snapshot import Snapshot

CUTTING = "Measuring the profile …"


class DefectDock:
    """Header with figures, and the plot, for the defect under review."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._worker = LatestOnlyWorker("section through a defect")
        self._asked: tuple[DefectCut, int] | None = None
        self._sections: tuple[Section, ...] = ()
        self._problem = ""
        self._panel = BottomPanel(page, "defect")
        with self._panel.tab:
            self._plot = HtmlBlock(page.gui)
        page.on_close(self._worker.close)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the curve up to date."""
        defect = chosen_defect(snapshot, view.review)
        if not self._panel.show(view) or defect is None or snapshot.surface is None:
            return
        cut = cut_through(defect, snapshot.inspection.inspection, snapshot.surface.pixel_um)
        if (cut, snapshot.surface.stamp) != self._asked:
            self._asked, self._sections, self._problem = (cut, snapshot.surface.stamp), (), ""
            measure = guarded(self._page, "The profile was not measured")(self._measure)
            asked = self._asked
            self._worker.ask(lambda: measure(asked))
        self._plot.show(f'<div class="wv-below">{self._head(defect, cut)}{self._curves()}</div>')

    def _measure(self, asked: tuple[DefectCut, int]) -> None:
        """Measure the profiles on the worker's thread; drop the result if another defect is under review by then."""
        cut, problem = asked[0], ""
        sections: list[Section] = []
        for place, line in enumerate(cut.lines):
            try:
                wanted = SectionAsked(place, line, cut.show, cut.levelling)
                sections.append(self._page.session.sections.section(wanted))
            except WaferViewerError as fault:
                problem = problem or (str(fault) if place == 0 else "")
        if asked == self._asked:
            self._sections, self._problem = tuple(sections), problem
            self._page.redraw()

    def _head(self, defect: Defect, cut: DefectCut) -> str:
        words = " ".join(f"<span>{part}</span>" for part in _header_parts(defect, cut, len(self._sections)))
        return f'<div class="wv-dock wv-tight"><b>Profile through the defect</b>{words}</div>'

    def _curves(self) -> str:
        if self._problem:
            return html.note("attention", "No profile", self._problem)
        if not self._sections:
            return html.empty(CUTTING)
        return profile_plot_html(self._sections, frame_of(self._sections), ())


def _header_parts(defect: Defect, cut: DefectCut, n_curves: int) -> Iterator[str]:
    height = f"height <b>{format_quantity(defect.height.quantity, signed=True)}</b>"
    yield f'{html.chip("A", PROFILE_COLOURS[0])} {height} <span class="dim wv-hint">through the middle</span>'
    if cut.beside and n_curves > 1:
        beside = f"same row, die {html.safe(cut.beside)}"
        yield f'{html.chip("B", PROFILE_COLOURS[1])} <span class="dim" title="{beside}">{beside}</span>'
