"""Panel of the step Measure: tool, live result, and its evidence."""

from __future__ import annotations

from typing import Any

import viser

from wafer_viewer.gui.measure.faces_section import FacesSection
from wafer_viewer.gui.measure.levelling_section import LevellingSection
from wafer_viewer.gui.measure.live_measurement import Answer, Answering
from wafer_viewer.gui.measure.live_profiles import LiveProfiles
from wafer_viewer.gui.measure.options_section import OptionsSection
from wafer_viewer.gui.measure.profile_section import ProfileSection
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.preconditions import require_step
from wafer_viewer.gui.presenters import measurement as words
from wafer_viewer.gui.presenters.provenance import source
from wafer_viewer.gui.presenters.steps import not_evaluated
from wafer_viewer.gui.scenes.scene_view import SceneView
from wafer_viewer.gui.scenes.thumbnails import painted
from wafer_viewer.gui.state.view_state import Tool, View
from wafer_viewer.gui.tools.region_tools import has_required_kinds
from wafer_viewer.gui.tools.tool_palette import tool_cards
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import HtmlBlock, button, leading, set_prop
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state.snapshot import Snapshot

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
        there = view.step == "measure" and not view.explains
        set_prop(self._folder, "visible", there)
        if not there:
            return
        self._answering.follow(snapshot, view)
        chosen = next((f for f in snapshot.findings if f.number == view.selected), None)
        finding = chosen or self.answer.finding
        self._title.show(_title(view.tool))
        self._notes.show(self._page.notes(snapshot))
        self._tools.show(tool_cards() if view.tool == "none" and chosen is None else "")
        self._show_answer(view, finding, chosen)
        self._level.show(view)
        self._faces.show(view, kept=chosen is not None)
        self._options.show(view, kept=chosen is not None)
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
        self._name = gui.add_text("Name", "", visible=False)
        self._level = LevellingSection(self._page, scene)
        self._faces = FacesSection(self._page)
        self._options = OptionsSection(self._page)
        self._profiles = ProfileSection(self._page, curves)
        self._source = HtmlBlock(gui)
        self._why = HtmlBlock(gui)
        self._keep = button(
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
        self._why.show(f'<div class="wv-why">Not kept: {html.safe(read_only)}</div>' if read_only else "")

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

        def kept(result: AnyResult) -> None:
            self._name.value = ""
            page.change(selected=result.number)

        picture = painted(page, finding, PICTURE_WAIT_S)
        page.ask("The result was not kept", page.session.keep(replace(finding, name=name), picture), kept)


_GAP = '<div style="height:8px"></div>'


def _evidence_html(finding: AnyResult) -> str:
    return f"{source(finding)}{words.budget(finding.main)}{not_evaluated(finding)}{_GAP}"


def _title(tool: Tool) -> str:
    if tool == "none":
        return html.title("Measure", "Choose what to measure.")
    others = f'<span class="wv-action" title="Key Escape" {html.pick("tool", "none")}>All tools</span>'
    return html.title(TOOLS[tool].title, TOOLS[tool].how, others)
