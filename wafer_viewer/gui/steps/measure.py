"""The step Measure: tool, options, levelling, live result and its evidence."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.gui.elements.elements import Button, Dropdown, Element, Elements, Html, NumberOrEmpty, Stack, Text
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.measure.live_measurement import LiveProfiles, live_measurement
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.preconditions import require_step
from wafer_viewer.gui.presenters import measurement as words
from wafer_viewer.gui.presenters.measurement import ZERO, not_evaluated, source
from wafer_viewer.gui.scenes.thumbnails import painted
from wafer_viewer.gui.state.view_state import Tool, View
from wafer_viewer.gui.steps.profiles import profile_inputs
from wafer_viewer.gui.tools.region_tools import has_required_kinds
from wafer_viewer.gui.tools.tool_palette import tool_cards
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.ask import Answer
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.measuring_tool import ChoiceControl, Control, MeasuringTool
from wafer_viewer.model.measurement.tool_options import LevelBy, Levelling
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace, value_at, with_field
from wafer_viewer.session.state.snapshot import Snapshot

MEASUREMENT, FACES = "measure", "faces of a step"
NOT_KEPT, FAILED = "The result was not kept", "The zero of heights was not changed"
NAME_HINT = "Of the result in lists, exports and reports; empty: the tool's name with a number"
ZERO_HINT = "Zero of the heights: the stage's, or a plane or form fitted to the surface"
FIND, LOOKING, NOT_FOUND = "Find the faces", "Finding the faces …", "The faces were not found"
LEVELLINGS: dict[str, LevelBy] = {
    "Stage": "stage",
    "Three points": "three points",
    "Plane": "plane",
    "Region": "region",
    "Form": "form",
}
_HOW = {"three points": "Drag the points 1, 2, 3.", "region": "Drag the region Zero."}
PICTURE_WAIT_S = 1.5
"""Timeout for the thumbnail of a result, after which it is saved without one."""
WAITS = "The result appears when the handles lie on the surface."
_GAP = Markup('<div style="height:8px"></div>')


@dataclass(frozen=True, slots=True)
class MeasureState:
    """State of the step.

    curves: those of the profile tool. first_levelling: initial levelling of a kind, placed by what is in view. name:
    typed for the next result.
    """

    curves: LiveProfiles
    first_levelling: Callable[[LevelBy], Levelling]
    name: str = ""


def measure_step(here: Here[MeasureState]) -> Elements | None:
    """Return the panel of all tools; measure again if handles have moved."""
    snapshot, view = here.snapshot, here.view
    if view.step != "measure" or view.explains:
        return None
    live_measurement(here.page, MEASUREMENT, snapshot, view)
    chosen = next((f for f in snapshot.findings if f.number == view.selected), None)
    finding, stored = chosen or _answer(here).value, chosen is not None
    tool = TOOLS.get(view.tool) if not stored else None
    return [
        Html(_title(view.tool)),
        Html(here.page.notes(snapshot)),
        Html(tool_cards() if view.tool == "none" and not stored else ""),
        Html(_result(here, finding, chosen)),
        _name(here) if finding is not None and not stored else None,
        Stack(_levelling(here)),
        Stack(_faces(here)) if tool is not None and tool.name == "step" else None,
        Stack(tuple(_options(here, tool)), key=tool.name) if tool is not None else None,
        profile_inputs(here, here.own.curves) if view.tool == "profile" else None,
        Html(_evidence(finding) if finding is not None else ""),
        Stack(tuple(_keeping(here, finding, stored=stored))),
    ]


def keep_result(here: Here[MeasureState]) -> None:
    """Save the live result, under the name that was typed."""
    page, finding = here.page, _answer(here).value
    if finding is None or why_not_keep(here, page.session.snapshot, page.view) is not None:
        return

    def select_result(result: AnyResult) -> None:
        here.keep(name="")
        page.change(selected=result.number)

    named = replace(finding, name=here.own.name.strip())
    picture = painted(page, finding, PICTURE_WAIT_S)
    page.ask(NOT_KEPT, page.session.keep(named, picture), select_result)


def why_not_keep(here: Here[MeasureState], snapshot: Snapshot, view: View) -> str | None:
    """Return the reason why no result can be saved now, or None."""
    data = snapshot.dataset
    if (missing := require_step("measure")(snapshot, view)) is not None:
        return missing
    if view.tool == "none" or view.selected is not None:
        return "no tool is active: choose one first."
    if data is not None and data.read_only is not None:
        return data.read_only
    answer = _answer(here)
    return None if answer.value is not None else answer.problem or WAITS


def use_tool(page: Page, tool: Tool) -> None:
    """Activate a tool and go to the step Measure; a region that suits both tools keeps its position."""
    if page.session.snapshot.surface is None:
        return
    view = page.view
    stays = False
    if tool not in ("none", "profile") and view.tool != "none" and len(view.places) == 1:
        stays = TOOLS[tool].places == TOOLS[view.tool].places and has_required_kinds(TOOLS[tool], view.places)
    page.change(step="measure", tool=tool, places=view.places if stays else (), selected=None, why=None)


def _name(here: Here[MeasureState]) -> Element:
    return Text("Name", here.own.name, lambda name: here.keep(name=name), NAME_HINT, commands=True)


def _faces(here: Here[MeasureState]) -> Elements:
    """Return the button that finds the faces of a step, with the reason below it if none were found."""
    page, show, found = here.page, max(0, here.view.show), here.ask.known(FACES)

    def find() -> tuple[Region, ...]:
        regions = page.session.gauge.find_faces(show)
        if page.view.tool == "step":
            page.change(places=regions)
        return regions

    def look() -> None:
        here.ask(FACES, object(), find, NOT_FOUND)
        page.redraw()

    problem = html.typeset(found.problem) if not found.computing else ""
    title, icon = LOOKING if found.computing else FIND, viser.Icon.SEARCH
    return [
        Button(title, look, icon, "outlined", disabled=found.computing, failed=NOT_FOUND),
        Html(Markup('<div class="wv-why">{}</div>').format(problem) if problem else ""),
    ]


def _options(here: Here[MeasureState], tool: MeasuringTool) -> Iterator[Element]:
    """Yield an input for each option of a tool."""
    for control in tool.controls:
        yield _option(here, tool, control, value_at(here.view.options, f"{tool.name}.{control.field}"))


def _option(here: Here[MeasureState], tool: MeasuringTool, control: Control, value: Any) -> Element:
    def put(value: Any) -> None:
        here.page.change(options=with_field(here.page.view.options, f"{tool.name}.{control.field}", value))

    if isinstance(control, ChoiceControl):
        values = control.values
        name = next((name for name, v in values.items() if v == value), next(iter(values)))
        return Dropdown(control.label, name, lambda n: put(values[n]), control.hint, options=tuple(values))
    return NumberOrEmpty(control.label, value, put, control.hint, over=control.over)


def _evidence(finding: AnyResult) -> Markup:
    return source(finding) + words.budget(finding.main) + not_evaluated(finding) + _GAP


def _title(tool: Tool) -> Markup:
    if tool == "none":
        return html.title("Measure", "Choose what to measure.")
    others = Markup('<span class="wv-action" title="Key Escape" {}>All tools</span>').format(html.pick("tool", "none"))
    return html.title(TOOLS[tool].title, TOOLS[tool].how, others)


def _answer(here: Here[MeasureState]) -> Answer:
    """Return the live result of the active tool."""
    return here.own.curves.answer if here.page.view.tool == "profile" else here.ask.known(MEASUREMENT)


def _result(here: Here[MeasureState], finding: AnyResult | None, chosen: AnyResult | None) -> Markup:
    if finding is not None:
        return words.card(finding, f"{words.symbol(chosen)} · {chosen.name}" if chosen else "Not kept yet")
    if here.view.tool == "none":
        return Markup()
    return html.empty(html.typeset(_answer(here).problem) or WAITS)


def _levelling(here: Here[MeasureState]) -> Elements:
    """Return the choice of the zero of heights, a sentence that states it, and a link back to the stage's."""
    view, by = here.view, here.view.levelling.by
    if view.tool != "none" and TOOLS[view.tool].on_picture:
        return []
    text, off = f"Heights are read from {ZERO[by]}." + (f" {_HOW[by]}" if by in _HOW else ""), by != "stage"
    back = Markup(' <span class="wv-link" {}>Back to the stage</span>').format(html.pick("stage-zero")) if off else ""

    name = next(name for name, kind in LEVELLINGS.items() if kind == by)

    def put(name: str) -> None:
        here.page.change(levelling=here.own.first_levelling(LEVELLINGS[name]), range_um=None)

    return [
        Dropdown("Heights from", name, put, ZERO_HINT, failed=FAILED, options=tuple(LEVELLINGS)),
        Html(Markup('<div class="wv-zero{}">{}{}</div>').format(" on" if off else "", text, back)),
    ]


def _keeping(here: Here[MeasureState], finding: AnyResult | None, *, stored: bool) -> Iterator[Element]:
    data = here.snapshot.dataset
    read_only = data.read_only if data is not None else None
    yield Html(Markup('<div class="wv-why">Not kept: {}</div>').format(read_only) if read_only else "")
    if not stored and here.view.tool != "none":
        off = finding is None or read_only is not None
        keep, icon = partial(keep_result, here), viser.Icon.CHECK
        yield Button("Keep result", keep, icon, "leading", disabled=off, commands=True, failed=NOT_KEPT)
