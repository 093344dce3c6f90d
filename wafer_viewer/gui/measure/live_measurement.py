"""Live measurement with the active tool on a worker thread, updated while handles move."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.tools.region_tools import has_required_kinds
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.gui.widgets.latest_only import LatestOnlyWorker
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.session.state.snapshot import Snapshot


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """Result of the live measurement, or the reason why there is none."""

    finding: AnyResult | None = None
    problem: str = ""


class Answering:
    """Live measurement; `answer` holds the newest result, and the page is redrawn when it changes."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._worker = LatestOnlyWorker("measure")
        self._asked: tuple[object, ...] | None = None
        self.answer = Answer()

    def follow(self, snapshot: Snapshot, view: View) -> None:
        """Request a measurement if the tool, its regions or options, the levelling or the surface have changed."""
        asked = (view.tool, _places(view), view.options, view.levelling, view.show, _stamp(snapshot, view.show))
        if asked == self._asked:
            return
        if self._asked is None or asked[0] != self._asked[0]:
            self.answer = Answer()
        self._asked = asked
        if asked[-1] is None or not _places(view):
            self.answer = Answer()
            return
        self._worker.ask(lambda: guarded(self._page, "The measurement failed")(self._measure)(view, asked))

    def close(self) -> None:
        """Stop measuring, when the browser has disconnected."""
        self._worker.close()

    def _measure(self, view: View, asked: tuple[object, ...]) -> None:
        try:
            answer = self._measured(view)
        except WaferViewerError as fault:
            answer = Answer(problem=str(fault))
        if self._asked is not None and asked[0] == self._asked[0]:
            self.answer = answer  # of the tool in use: one that came too late would stand under another's title
        self._page.redraw()

    def _measured(self, view: View) -> Answer:
        if view.tool == "none":
            return Answer()
        return Answer(self._page.session.measure(view.tool, view.places, view.show, view.levelling, view.options))


def _places(view: View) -> object:
    """Return the regions of the active tool; empty if it has none yet, and for profiles, which have curves instead."""
    if view.tool == "none" or view.tool == "profile":
        return ()
    return view.places if has_required_kinds(TOOLS[view.tool], view.places) else ()


def _stamp(snapshot: Snapshot, show: int) -> object:
    """Return a stamp that changes with the displayed surface; None without one."""
    if show > 0:
        return snapshot.dataset.stamps.get(show) if snapshot.dataset else None
    return snapshot.surface.stamp if snapshot.surface else None
