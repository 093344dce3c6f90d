"""The panel of the fourth step: a tool, its answer while the handles move, and what the answer rests on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import viser

from wafer_viewer.gui import html
from wafer_viewer.gui import measure_words as words
from wafer_viewer.gui.guard import guarded
from wafer_viewer.gui.kit import Cell, Choice, Field, button, leading, set_prop
from wafer_viewer.gui.latest import Latest
from wafer_viewer.gui.page import Page
from wafer_viewer.gui.view import Tool, View
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.findings import AnyFinding, Profile, ProfileCurve, StepHeight
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state import Snapshot

TOOLS: tuple[tuple[Tool, str], ...] = (("profile", "Profile"), ("step", "Step"))
_TITLES = {
    "none": ("Measure", "Choose what to measure."),
    "profile": ("Profile", "Drag the two handles over the surface."),
    "step": ("Step height", "Drag the upper and the lower region over the surface."),
}


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """What came of measuring at the handles' places: a result, for a profile its curve, or why there is none."""

    finding: AnyFinding | None = None
    curve: ProfileCurve | None = None
    problem: str = ""


class MeasurePanel:
    """Profile and step height, live; a result that is kept goes to the list on the left."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._worker = Latest("measure")
        self._asked: object = None
        self.answer = Answer()
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._build()

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the panel up to date, and have the handles' places measured when they moved."""
        there = view.step == "measure" and not view.explains
        set_prop(self._folder, "visible", there)
        if not there:
            return
        self._measure_if_moved(snapshot, view)
        chosen = next((f for f in snapshot.findings if f.number == view.selected), None)
        finding = chosen or self.answer.finding
        self._title.show(html.title(*_TITLES[view.tool]))
        self._notes.show(self._page.notes(snapshot))
        self._tool.show(view.tool)
        set_prop(self._name, "visible", chosen is None and finding is not None)
        set_prop(self._width.handle, "visible", view.tool == "profile" and chosen is None)
        self._width.show(line.width_um if (line := view.active_line) else 0.0)
        if finding is None:
            waits = html.micro(self.answer.problem) or "The answer comes as soon as the handles lie on the surface."
            self._answer.show(html.empty(waits))
            self._source.show("")
        else:
            name = chosen.name if chosen else f"{_TITLES[view.tool][0]}, not kept yet"
            self._answer.show(_card(finding, name))
            self._source.show(
                words.source(finding) + words.budget(words.main_length(finding)) + '<div style="height:8px"></div>'
            )
        read_only = snapshot.dataset.read_only if snapshot.dataset else None
        set_prop(self._keep, "visible", chosen is None)
        set_prop(self._keep, "disabled", finding is None or read_only is not None)
        self._why.show(f'<div class="wv-why">Not kept: {html.safe(read_only)}</div>' if read_only else "")

    def close(self) -> None:
        """Stop measuring: the browser has gone."""
        self._worker.close()

    def use(self, tool: Tool) -> None:
        """Take a tool, in the step where it is used."""
        if self._page.session.snapshot.surface is not None:
            self._page.change(step="measure", tool=tool, selected=None, why=None)

    def _build(self) -> None:
        gui = self._page.gui
        self._title = Cell(gui)
        self._notes = Cell(gui)
        self._tool = Choice(gui, "Tool", TOOLS, self.use)
        width = gui.add_number("Width, µm", 0.0, min=0.0, step=0.5, visible=False)
        self._width: Field[float] = Field(width, self._widen, self._page, "The width stays")
        self._answer = Cell(gui)
        self._name = gui.add_text("Name", "", visible=False)
        self._source = Cell(gui)
        self._why = Cell(gui)
        self._keep = button(
            gui, "Keep result", viser.Icon.CHECK, guarded(self._page, "The result was not kept")(self._keep_it)
        )
        leading(gui, self._keep)

    def _widen(self, event: Any) -> None:
        """Average over a strip of that width across the line."""
        view, width_um = self._page.view, float(event.target.value)
        widened = (replace(line, width_um=width_um) if k == view.line else line for k, line in enumerate(view.lines))
        self._page.change(lines=tuple(widened))

    def _measure_if_moved(self, snapshot: Snapshot, view: View) -> None:
        stamp = snapshot.surface.stamp if snapshot.surface else None
        places = {"none": (), "profile": (view.active_line,), "step": (view.upper, view.lower)}[view.tool]
        asked = (view.tool, places, view.show, stamp)
        if asked == self._asked:
            return
        self._asked = asked
        if not places or any(place is None for place in places) or stamp is None:
            self.answer = Answer()
            return
        self._worker.ask(lambda: guarded(self._page, "The measurement stopped")(self._measure)(view))

    def _measure(self, view: View) -> None:
        try:
            self.answer = self._measured(view)
        except WaferViewerError as fault:
            self.answer = Answer(problem=str(fault))
        self._page.redraw()

    def _measured(self, view: View) -> Answer:
        session = self._page.session
        if view.tool == "profile" and (line := view.active_line) is not None:
            profile, curve = session.profile(line, view.show)
            return Answer(profile, curve)
        if view.upper is not None and view.lower is not None:
            return Answer(session.step_height(view.upper, view.lower, view.show))
        return Answer()

    def _keep_it(self, _: Any) -> None:
        page, finding = self._page, self.answer.finding
        if finding is None:
            return
        name = self._name.value.strip()

        def kept(result: AnyFinding) -> None:
            self._name.value = ""
            page.change(selected=result.number)

        page.ask("The result was not kept", page.session.keep(replace(finding, name=name)), kept)


def _card(finding: AnyFinding, name: str) -> str:
    match finding:
        case Profile():
            return words.answer(f"{name} · total height Pt", finding.pt)
        case StepHeight():
            return words.answer(name, finding.height)
        case _:
            return words.answer(name, words.main_length(finding))
