"""Live measurements and profile curves on a worker thread, updated while handles are dragged."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.tools.region_tools import has_required_kinds
from wafer_viewer.gui.widgets.ask import Answer
from wafer_viewer.gui.widgets.callbacks import LatestOnlyWorker, guarded
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.measurements import Profile
from wafer_viewer.model.measurement.sections import Gap, Section, SectionRequest, cursor_difference
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.session.state.snapshot import Snapshot


def live_measurement(page: Page, name: str, snapshot: Snapshot, view: View) -> Answer[AnyResult]:
    """Return the newest result of the tool in use; it is measured again when its regions or options have changed."""
    tool, places, surface = view.tool, _places(view), _stamp(snapshot, view.show)
    stamp = (places, view.options, view.levelling, view.show, surface)

    def measured() -> AnyResult:
        return page.session.measure(tool, view.places, view.show, view.levelling, view.options)

    ready = tool != "none" and bool(places) and surface is not None
    return page.answers(name, stamp, measured if ready else None, "The measurement failed", about=tool)


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


IMPERCEPTIBLE_S = 0.03


@dataclass(frozen=True, slots=True)
class Missing:
    """Reason why there is no curve."""

    why: str


class LiveProfiles:
    """Curves of all lines, and a second one for each comparison of the active line."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._worker = LatestOnlyWorker("profile")
        self._sections: dict[SectionRequest, Section | Missing] = {}
        self._requested: object = None
        self._surface: object = None
        self._line = 0
        self._lock, self._measured = threading.Lock(), threading.Event()
        self._changed: Callable[[], None] = lambda: None
        self.sections: tuple[Section, ...] = ()
        self.problems: tuple[str, ...] = ()
        page.on_close(self._worker.close)

    def on_change(self, callback: Callable[[], None]) -> None:
        """Set the callback for new curves; it runs on the measuring thread."""
        self._changed = callback

    @property
    def active(self) -> Section | None:
        """Curve of the active line; None without one."""
        return next((s for s in self.sections if s.asked.place == self._line and not s.asked.is_second), None)

    @property
    def gap(self) -> Gap | None:
        """Cursor readings on the active line's curve, at the nearest measured points; None without a curve."""
        active = self.active
        return None if active is None else cursor_difference(active.curve, self._page.view.plot.cursors)

    def cursor_shares(self, view: View) -> tuple[float, float]:
        """Return the cursor positions as shares of the active line's length; the requested ones without a curve."""
        read, active = self.gap, self.active
        if read is None or active is None or view.tool != "profile":
            return view.plot.cursors
        length_um = float(active.curve.distance_um[-1])
        return read.at_um[0] / length_um, read.at_um[1] / length_um

    @property
    def answer(self) -> Answer[Profile]:
        """Result of the active line, or the first problem."""
        active = self.active
        return Answer(active.profile if active else None, self.problems[0] if self.problems else "")

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Request the curves that have changed; none are measured unless profiles are displayed."""
        self._ask(snapshot)

    def follow(self) -> None:
        """Update the curves after a handle has moved, before its line is sent, so that one frame shows both.

        Waits at most `IMPERCEPTIBLE_S`, which is imperceptible.
        """
        self._ask(self._page.session.snapshot)
        self._measured.wait(IMPERCEPTIBLE_S)

    def _ask(self, snapshot: Snapshot) -> None:
        """Request curves for the newest view; the page may be drawing an older one while a handle moves."""
        with self._lock:
            view = self._page.view
            if view.step != "measure" or view.tool != "profile" or snapshot.surface is None:
                return
            self._line = view.line
            surface, wanted = _profile_stamp(snapshot, view.show), tuple(_section_requests(view))
            if (surface, wanted) == self._requested:
                return
            self._requested = surface, wanted
            self._measured.clear()
            measure = guarded(self._page, "The measurement failed")(self._measure)
            self._worker.ask(lambda: measure(surface, wanted))

    def _measure(self, surface: object, wanted: tuple[SectionRequest, ...]) -> None:
        if surface != self._surface:
            self._surface, self._sections = surface, {}
        answers = {request: self._sections.get(request) or self._section(request) for request in wanted}
        self._sections = answers
        self.sections = tuple(answer for answer in answers.values() if isinstance(answer, Section))
        self.problems = tuple(answer.why for answer in answers.values() if isinstance(answer, Missing))
        self._changed()
        self._measured.set()
        self._page.redraw()

    def _section(self, request: SectionRequest) -> Section | Missing:
        try:
            return self._page.session.sections.section(request)
        except WaferViewerError as fault:
            return Missing(str(fault))


def _section_requests(view: View) -> Iterator[SectionRequest]:
    """Yield the request of every line, followed for the active one by its comparisons."""
    for place, line in enumerate(view.lines):
        yield SectionRequest(place, line, view.show, view.levelling, slab=view.look == "points" and line.kind == "line")
        if place == view.line and view.plot.cleaned:
            yield SectionRequest(place, line, view.show, view.levelling, cleaned=True)
        if place == view.line and view.plot.of is not None:
            yield SectionRequest(place, line, 0, view.levelling, of=view.plot.of)


def _profile_stamp(snapshot: Snapshot, show: int) -> object:
    """Return a stamp that changes with the measured heights; None without a surface."""
    data, surface = snapshot.dataset, snapshot.surface
    if data is None or surface is None:
        return None
    return data.path, surface.result, surface.stamp if show <= 0 else data.stamps.get(show), show
