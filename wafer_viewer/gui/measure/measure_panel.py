"""Panel of the step Measure: tool, options, levelling, live result, and its evidence."""

from __future__ import annotations

from collections.abc import Callable
from operator import attrgetter
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.gui.measure.live_measurement import Answer, Answering, LiveProfiles
from wafer_viewer.gui.measure.profile_views import ProfileSection
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.preconditions import require_step
from wafer_viewer.gui.presenters import measurement as words
from wafer_viewer.gui.presenters.measurement import ZERO, not_evaluated, source
from wafer_viewer.gui.scenes.scene_view import SceneView
from wafer_viewer.gui.scenes.thumbnails import painted
from wafer_viewer.gui.state.view_state import Tool, View
from wafer_viewer.gui.tools.region_tools import has_required_kinds
from wafer_viewer.gui.tools.tool_palette import tool_cards
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import Debouncer, LatestOnlyWorker, guarded
from wafer_viewer.gui.widgets.controls import (
    BoundInput,
    HtmlBlock,
    button,
    command_button,
    controlled,
    leading,
    outlined,
    set_prop,
)
from wafer_viewer.gui.widgets.number_field import OptionalNumber, number_of, text_of
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.measuring_tool import ChoiceControl, Control, ToolName
from wafer_viewer.model.measurement.tool_options import LevelBy, Levelling
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state.snapshot import Snapshot

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

    def show(self, view: View, *, stored: bool) -> None:
        """Bring the section up to date; it is shown for the step tool while no saved result is selected."""
        visible = view.tool == "step" and not stored
        set_prop(self._button, "visible", visible)
        set_prop(self._button, "disabled", self._looking)
        set_prop(self._button, "label", LOOKING if self._looking else FIND)
        problem = self._problem if visible and not self._looking else ""
        self._why.show(
            Markup('<div class="wv-why">{}</div>').format(html.with_micro_sign(problem)) if problem else Markup()
        )

    def _look_for(self, _: Any) -> None:
        if not self._looking:
            self._looking, self._problem = True, ""
            self._worker.ask(lambda: guarded(self._page, "The faces were not found")(self._find)())
            self._page.redraw()

    def _find(self) -> None:
        before = self._page.view
        try:
            regions = self._page.session.gauge.find_faces(max(0, before.show))
            if self._page.view.tool == "step":
                self._page.change(places=regions)
        except WaferViewerError as fault:
            self._problem = str(fault)
        finally:
            self._looking = False
            self._page.redraw()


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
        self._status = HtmlBlock(page.gui)
        page.on_pick("stage-zero", lambda _: page.change(levelling=Levelling(), range_um=None))

    def show(self, view: View) -> None:
        """Bring the section up to date."""
        reads_heights = view.tool == "none" or not TOOLS[view.tool].on_picture
        set_prop(self._choice.handle, "visible", reads_heights)
        if not reads_heights:
            self._status.show("")
            return
        by = view.levelling.by
        self._choice.show(next(name for name, label in NAMES.items() if label == by))
        back = (
            Markup(' <span class="wv-link" {}>Back to the stage</span>').format(html.pick("stage-zero"))
            if by != "stage"
            else Markup()
        )
        how = f" {_HOW[by]}" if by in _HOW else ""
        text = f"Heights are read from {ZERO[by]}.{how}"
        self._status.show(
            Markup('<div class="wv-zero{}">{}{}</div>').format(" on" if by != "stage" else "", text, back)
        )

    def _choose(self, event: Any) -> None:
        levelling = self._scene.first_levelling(NAMES[event.target.value])
        self._page.change(levelling=levelling, range_um=None)


FAILED = "The setting was not changed"


def _widget(gui: Any, control: Control) -> Any:
    """Create the widget of an option."""
    if isinstance(control, ChoiceControl):
        return gui.add_dropdown(control.label, tuple(control.values), hint=control.hint or None)
    return OptionalNumber(gui, control.label, over=control.over, hint=control.hint).handle


def _option_of(control: Control, put_in: Any) -> Any:
    """Return the option's value of a widget value. Raises WaferViewerError if it is not a number."""
    if isinstance(control, ChoiceControl):
        return control.values[put_in]
    return number_of(put_in, control.label, over=control.over)


def _shown(control: Control, value: Any) -> Any:
    """Return the widget value of an option's value."""
    if isinstance(control, ChoiceControl):
        return next((name for name, v in control.values.items() if v == value), next(iter(control.values)))
    return text_of(value)


class OptionsSection:
    """Controls of the active tool; those of the other tools are hidden."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._folders: dict[Tool, Any] = {}
        self._fields: dict[tuple[Tool, str], tuple[Control, BoundInput[Any]]] = {}
        for tool, controls in ((tool.name, tool.controls) for tool in TOOLS.values() if tool.controls):
            self._folders[tool] = folder = page.gui.add_folder(None, visible=False)
            with folder:
                for control in controls:
                    field = BoundInput(_widget(page.gui, control), self._hear(tool, control), page, FAILED)
                    self._fields[tool, control.field] = control, field

    def show(self, view: View, *, stored: bool) -> None:
        """Bring the section up to date; a saved result has no controls."""
        for tool, folder in self._folders.items():
            set_prop(folder, "visible", tool == view.tool and not stored)
        for (tool, name), (control, field) in self._fields.items():
            if tool == view.tool:
                field.show(_shown(control, attrgetter(name)(getattr(view.options, tool))))

    def _hear(self, tool: ToolName, control: Control) -> Callable[[Any], None]:
        def put() -> None:
            options = self._page.view.options
            value = _option_of(control, self._fields[tool, control.field][1].value)
            self._page.change(options=replace(options, **{tool: _with(getattr(options, tool), control.field, value)}))

        if isinstance(control, ChoiceControl):
            return lambda _: put()
        edits = Debouncer(put, guarded(self._page, FAILED))
        return lambda _: edits.made()


def _with(spec: Any, field: str, value: Any) -> Any:
    """Return a copy of a spec with one field changed."""
    outer, _, inner = field.partition(".")
    return replace(spec, **{outer: _with(getattr(spec, outer), inner, value) if inner else value})


__all__ = ["Answer", "MeasurePanel"]

PICTURE_WAIT_S = 1.5
"""Timeout for the thumbnail of a result, after which it is saved without one."""
WAITS = "The result appears when the handles lie on the surface."


class MeasurePanel:
    """Panel of all tools with live results; saved results go to the list on the left."""

    def __init__(self, page: Page, scene: SceneView, curves: LiveProfiles) -> None:
        self._page, self._curves = page, curves
        self._answering = Answering(page)
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._build(scene, curves)

    @property
    def answer(self) -> Answer:
        """Result of the live measurement with the active tool."""
        if self._page.view.tool == "profile":
            return Answer(self._curves.answer.finding, self._curves.answer.problem)
        return self._answering.answer

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the panel up to date, and measure again if handles have moved."""
        visible = view.step == "measure" and not view.explains
        set_prop(self._folder, "visible", visible)
        if not visible:
            return
        self._answering.follow(snapshot, view)
        chosen = next((f for f in snapshot.findings if f.number == view.selected), None)
        finding = chosen or self.answer.finding
        self._title.show(_title(view.tool))
        self._notes.show(self._page.notes(snapshot))
        self._tools.show(tool_cards() if view.tool == "none" and chosen is None else "")
        self._show_answer(view, finding, chosen)
        self._level.show(view)
        self._faces.show(view, stored=chosen is not None)
        self._options.show(view, stored=chosen is not None)
        self._profiles.show(snapshot, view)
        self._source.show(_evidence_html(finding) if finding is not None else "")
        self._show_keep(snapshot, view, finding, chosen)

    def close(self) -> None:
        """Stop measuring, when the browser has disconnected."""
        self._answering.close()

    def use(self, tool: Tool) -> None:
        """Activate a tool and go to the step Measure; a region that suits both tools keeps its position."""
        if self._page.session.snapshot.surface is None:
            return
        view = self._page.view
        stays = False
        if tool not in ("none", "profile") and view.tool != "none" and len(view.places) == 1:
            stays = TOOLS[tool].places == TOOLS[view.tool].places and has_required_kinds(TOOLS[tool], view.places)
        self._page.change(step="measure", tool=tool, places=view.places if stays else (), selected=None, why=None)

    def _build(self, scene: SceneView, curves: LiveProfiles) -> None:
        gui = self._page.gui
        self._title = HtmlBlock(gui)
        self._notes = HtmlBlock(gui)
        self._tools = HtmlBlock(gui)
        self._answer = HtmlBlock(gui)
        self._name = controlled(gui.add_text("Name", "", visible=False))
        self._level = LevellingSection(self._page, scene)
        self._faces = FacesSection(self._page)
        self._options = OptionsSection(self._page)
        self._profiles = ProfileSection(self._page, curves)
        self._source = HtmlBlock(gui)
        self._why = HtmlBlock(gui)
        self._keep = command_button(
            gui, "Keep result", viser.Icon.CHECK, guarded(self._page, "The result was not kept")(self._keep_it)
        )
        leading(gui, self._keep)

    def _show_answer(self, view: View, finding: AnyResult | None, chosen: AnyResult | None) -> None:
        if finding is None:
            waits = html.with_micro_sign(self.answer.problem) or WAITS
            self._answer.show("" if view.tool == "none" else html.empty(waits))
            return
        name = f"{words.symbol(chosen)} · {chosen.name}" if chosen else "Not kept yet"
        self._answer.show(words.card(finding, name))

    def _show_keep(self, snapshot: Snapshot, view: View, finding: AnyResult | None, chosen: AnyResult | None) -> None:
        read_only = snapshot.dataset.read_only if snapshot.dataset else None
        set_prop(self._name, "visible", chosen is None and finding is not None)
        set_prop(self._keep, "visible", chosen is None and view.tool != "none")
        set_prop(self._keep, "disabled", finding is None or read_only is not None)
        self._why.show(Markup('<div class="wv-why">Not kept: {}</div>').format(read_only) if read_only else Markup())

    def keep(self) -> None:
        """Save the live result, as the button does."""
        if self._page.view.step == "measure" and self._keep.visible and not self._keep.disabled:
            self._keep_it(None)

    def why_not_keep(self, snapshot: Snapshot, view: View) -> str | None:
        """Return the reason why no result can be saved now, or None."""
        data = snapshot.dataset
        if (missing := require_step("measure")(snapshot, view)) is not None:
            return missing
        if view.tool == "none" or view.selected is not None:
            return "no tool is active: choose one first."
        if data is not None and data.read_only is not None:
            return data.read_only
        return None if self.answer.finding is not None else self.answer.problem or WAITS

    def _keep_it(self, _: Any) -> None:
        page, finding = self._page, self.answer.finding
        if finding is None:
            return
        name = self._name.value.strip()

        def select_result(result: AnyResult) -> None:
            self._name.value = ""
            page.change(selected=result.number)

        picture = painted(page, finding, PICTURE_WAIT_S)
        page.ask("The result was not kept", page.session.keep(replace(finding, name=name), picture), select_result)


_GAP = Markup('<div style="height:8px"></div>')


def _evidence_html(finding: AnyResult) -> Markup:
    return source(finding) + words.budget(finding.main) + not_evaluated(finding) + _GAP


def _title(tool: Tool) -> Markup:
    if tool == "none":
        return html.title("Measure", "Choose what to measure.")
    others = Markup('<span class="wv-action" title="Key Escape" {}>All tools</span>').format(html.pick("tool", "none"))
    return html.title(TOOLS[tool].title, TOOLS[tool].how, others)
