"""Panel "Why this height?", which replaces the step's panel and requests the focus evidence of a pixel."""

from __future__ import annotations

from collections.abc import Hashable
from concurrent.futures import Future
from dataclasses import dataclass, replace

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters import focus_evidence as words
from wafer_viewer.gui.scene.heightfield import Place
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import HtmlBlock, set_prop
from wafer_viewer.gui.widgets.error_guard import tell_failure
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.surface.focus_curve import FocusCurve
from wafer_viewer.session.state.snapshot import Snapshot

TITLE = "Why this height?"
FAILED = "The frames were not read"


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Focus curve of the selected pixel (of the previous pixel while `reading`), or the problem."""

    curve: FocusCurve | None = None
    problem: str = ""
    reading: bool = False


class WhyPanel:
    """Answer, gate verdicts and competing peaks of one pixel; a click selects another pixel."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self.evidence = Evidence()
        self._clicked: tuple[Place, Hashable] | None = None
        self._asked: Hashable = None
        self._of: Hashable = None
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._title = HtmlBlock(page.gui)
            self._notes = HtmlBlock(page.gui)
            self._body = HtmlBlock(page.gui)
        page.on_pick("why", lambda _: self.toggle())
        page.on_pick("why-close", lambda _: self.close())

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the panel up to date; request the evidence of another pixel, close it for another surface."""
        set_prop(self._folder, "visible", view.explains)
        if not view.explains:
            self._asked, self.evidence = None, Evidence()
            return
        if self._asked is not None and self._of != surface_of(snapshot, view):
            self.close()
            return
        self._ask_if_new(snapshot, view)
        curve = self.evidence.curve
        self._title.show(
            html.title(
                TITLE,
                words.pixel_position_text(curve) if curve else words.format_position(view.why),
                words.close_action(),
            )
        )
        self._notes.show(self._page.notes(snapshot))
        self._body.show(self._said())

    def clicked(self, x_um: float, y_um: float) -> None:
        """Remember a click on the surface; explain that place at once if the panel is open."""
        page = self._page
        self._clicked = (x_um, y_um), surface_of(page.session.snapshot, page.view)
        if page.view.explains:
            page.change(why=(x_um, y_um))

    def toggle(self) -> None:
        """Explain the place that was clicked last, or close the panel."""
        page = self._page
        if page.view.explains:
            self.close()
        elif self._clicked is not None and self._clicked[1] == surface_of(page.session.snapshot, page.view):
            page.change(why=self._clicked[0])
        elif page.view.on_surface:
            page.say(TITLE, "Click a place on the surface first.")

    def close(self) -> None:
        """Close the panel."""
        self._page.change(why=None)

    def _said(self) -> str:
        curve = self.evidence.curve
        if curve is None:
            return ""
        said = "".join(part(curve) for part in (words.answer, words.verdicts, words.rivals))
        return f'<div class="wv-pale">{said}</div>' if self.evidence.reading else said

    def _ask_if_new(self, snapshot: Snapshot, view: View) -> None:
        asked = (view.why, view.show, _stamp(snapshot, view))
        if asked == self._asked or view.why is None:
            return
        self._asked, self._of = asked, surface_of(snapshot, view)
        self.evidence = replace(self.evidence, reading=True, problem="")
        answer = self._page.session.focus_curve(*view.why, max(0, view.show))
        answer.add_done_callback(lambda done: self._answered(asked, done))

    def _answered(self, asked: Hashable, done: Future[FocusCurve]) -> None:
        if asked != self._asked or done.cancelled():
            return
        fault = done.exception()
        if fault is None:
            self.evidence = Evidence(done.result())
        elif isinstance(fault, WaferViewerError):
            self.evidence = Evidence(problem=str(fault))
        else:
            tell_failure(self._page, FAILED, fault)
            self.evidence = Evidence(problem=f"{FAILED}.")
        self._page.redraw()


def surface_of(snapshot: Snapshot, view: View) -> Hashable:
    """Return the key of the displayed surface: dataset path and field."""
    return (snapshot.dataset.path if snapshot.dataset else None, view.show)


def _stamp(snapshot: Snapshot, view: View) -> int | None:
    if view.show:
        return snapshot.dataset.stamps.get(view.show) if snapshot.dataset else None
    return snapshot.surface.stamp if snapshot.surface else None
