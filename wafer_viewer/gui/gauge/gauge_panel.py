"""Panel of the gauge check: verdict, evidence, and the commands that lead to a signed check."""

from __future__ import annotations

from datetime import date
from typing import Any

import viser

from wafer_viewer.gui.gauge.face_finder import FaceFinder
from wafer_viewer.gui.gauge.gauge_commands import GaugeActions
from wafer_viewer.gui.gauge.gauge_conditions import TermsSection
from wafer_viewer.gui.gauge.gauge_list import selected_check
from wafer_viewer.gui.gauge.study_section import StudySection
from wafer_viewer.gui.measure.live_measurement import Answering
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.preconditions import require_step
from wafer_viewer.gui.presenters import gauge as words
from wafer_viewer.gui.presenters import gauge_uncertainty as unsure
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.tools.gauge_regions import in_scene
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.command import Command, with_precondition
from wafer_viewer.gui.widgets.controls import HtmlBlock, button, in_a_row, leading, set_prop
from wafer_viewer.gui.widgets.style import by_id
from wafer_viewer.model.gauge.gauge_check import GaugeCheck
from wafer_viewer.model.measurement.step import StepHeight
from wafer_viewer.session.state.snapshot import Snapshot

ICON = viser.Icon
LEAD_PX = 58
"""Height of the leading button with its margins."""
NO_SURFACE = "No surface of the blocks yet.", "Wring them and scan them, or open their dataset."


class GaugePanel:
    """Panel of the present check, or of an earlier one selected on the left."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self.live = Answering(page)
        self.finder = FaceFinder(page)
        self._verbs = GaugeActions(page, self.finder)
        page.on_close(self.live.close)
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._build()

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the panel up to date; find the faces, and measure the step again if they moved."""
        there = view.step == "gauge" and not view.explains
        set_prop(self._folder, "visible", there)
        if not there:
            return
        self.finder.follow(snapshot, view)
        self.live.follow(snapshot, in_scene(view))
        earlier = selected_check(snapshot, view)
        check = earlier or snapshot.gauge.signed or snapshot.gauge.check
        self._title.show(_title(earlier))
        self._notes.show(self._page.notes(snapshot))
        self._show_state(snapshot, view, earlier)
        self._verdict.show(words.verdict_card(check) + words.result(check) if check is not None else "")
        self._show_paper(snapshot, earlier, check)
        self._terms.show(snapshot, earlier is not None)
        self._show_sums(snapshot, view, earlier, check)
        self._studies.show()
        self._show_verbs(snapshot, view, earlier)

    def commands(self) -> list[Command]:
        """Return the commands of a check with their keys."""
        verbs = self._verbs

        def here(_: Snapshot, view: View) -> bool:
            return view.step == "gauge"

        return [
            Command("Next point of the check", "enter", verbs.go_on, ICON.ARROW_RIGHT, group="Gauge check", here=here),
            *with_precondition(
                require_step("gauge"),
                Command("Measure the step", None, verbs.measure, ICON.RULER_MEASURE, group="Gauge check"),
                Command("Find the faces", None, self.finder.again, ICON.SEARCH, group="Gauge check"),
                Command("Sign the check…", None, verbs.sign, ICON.SIGNATURE, group="Gauge check"),
                Command("Certificate…", None, verbs.certificate, ICON.CERTIFICATE, group="Gauge check"),
                Command("Begin a new check", None, verbs.begin_anew, ICON.PLUS, group="Gauge check"),
            ),
        ]

    def _build(self) -> None:
        gui, verbs = self._page.gui, self._verbs
        self._title, self._notes, self._state, self._verdict = (HtmlBlock(gui) for _ in range(4))
        self._paper = HtmlBlock(gui)
        self._terms = TermsSection(self._page)
        self._sums = HtmlBlock(gui)
        self._scale = HtmlBlock(gui)
        self._correct = button(gui, "Correct the z scale…", ICON.ARROWS_VERTICAL, lambda _: verbs.correct())
        in_a_row(gui, [self._correct])
        self._studies = StudySection(self._page)
        HtmlBlock(gui, '<div style="height:10px"></div>')
        self._why = HtmlBlock(gui)
        self._again = button(gui, "Measure again", ICON.REFRESH, lambda _: verbs.measure())
        self._other = button(gui, "Certificate…", ICON.CERTIFICATE, lambda _: verbs.certificate())
        in_a_row(gui, [self._again, self._other], 34)
        gui.add_html(f"<style>{_at_foot(self._again)}{_at_foot(self._other)}</style>")
        self._leads = {
            "certificate": button(gui, "Load the certificate…", ICON.CERTIFICATE, lambda _: verbs.certificate()),
            "measure": button(gui, "Measure the step", ICON.RULER_MEASURE, lambda _: verbs.measure()),
            "sign": button(gui, "Sign and save", ICON.SIGNATURE, lambda _: verbs.sign()),
            "new": button(gui, "New check", ICON.PLUS, lambda _: verbs.begin_anew()),
        }
        for handle in self._leads.values():
            leading(gui, handle)

    def _show_state(self, snapshot: Snapshot, view: View, earlier: GaugeCheck | None) -> None:
        gauge = snapshot.gauge
        if earlier is not None:
            self._state.show("")
        elif gauge.refusal is not None:
            self._state.show(words.rejected_scan_note(gauge.refusal, bool(gauge.repeats)))
        elif snapshot.surface is None and not gauge.repeats:
            self._state.show(html.empty(*NO_SURFACE))
        else:
            self._state.show(self._faces_state_html(snapshot, view))

    def _faces_state_html(self, snapshot: Snapshot, view: View) -> str:
        """Return the state of the face regions before the step is measured, as HTML."""
        if self.finder.looking:
            return html.empty("Looking for the two faces.")
        if self.finder.problem and not view.faces:
            way = f'<span class="wv-link" {html.pick("gauge-lay")}>Place the regions by hand</span>'
            return html.note("attention", "The faces were not found", self.finder.problem, way)
        if view.faces and not isinstance(self.live.answer.finding, StepHeight) and self.live.answer.problem:
            return html.note("attention", "Nothing is measured there", self.live.answer.problem)
        waits = snapshot.gauge.check is None and snapshot.gauge.signed is None and bool(view.faces)
        return html.empty("Drag the regions onto the two faces, then measure.") if waits else ""

    def _show_paper(self, snapshot: Snapshot, earlier: GaugeCheck | None, check: GaugeCheck | None) -> None:
        paper = earlier.certificate if earlier is not None else snapshot.gauge.certificate
        taken = earlier.repeats if earlier is not None else snapshot.gauge.repeats
        may_drop = earlier is None and bool(snapshot.gauge.repeats)
        self._paper.show(words.repeats(taken, check, may_drop) + words.certificate(paper, date.today()))

    def _show_sums(self, snapshot: Snapshot, view: View, earlier: GaugeCheck | None, check: GaugeCheck | None) -> None:
        live = self.live.answer.finding
        step = live if isinstance(live, StepHeight) and earlier is None else None
        upper, lower = (check.upper, check.lower) if check is not None else view.faces or (None, None)
        parts = [words.conditions(step, check, upper, lower)]
        if check is not None:
            parts += [unsure.budget(check), unsure.not_evaluated(check)]
        if earlier is None:
            parts.append(unsure.capability(snapshot.gauge.capability))
        self._sums.show("".join(parts))
        offered = snapshot.gauge.correction if earlier is None else None
        self._scale.show(unsure.correction(offered))
        set_prop(self._correct, "visible", offered is not None)

    def _show_verbs(self, snapshot: Snapshot, view: View, earlier: GaugeCheck | None) -> None:
        gauge, own = snapshot.gauge, earlier is None
        lead = self._verbs.leading(snapshot) if own else "new"
        for name, handle in self._leads.items():
            set_prop(handle, "visible", own and name == lead)
        why_not = self._verbs.why_not(snapshot, view, lead)
        set_prop(self._leads[lead], "disabled", why_not is not None)
        set_prop(self._again, "visible", own)
        set_prop(self._other, "visible", own)
        may_measure = self._verbs.why_not(snapshot, view, "measure") is None
        set_prop(self._again, "disabled", not (may_measure and gauge.repeats))
        why = f'<div class="wv-why">Not yet: {html.safe(html.with_micro_sign(why_not))}</div>' if why_not else ""
        self._why.show(why if own else "")


def _at_foot(handle: Any) -> str:
    """Return CSS that keeps a button visible above the leading button while the panel scrolls."""
    at, sticks = by_id(handle._impl.uuid), f"position:sticky;bottom:{LEAD_PX}px;z-index:3;padding-top:6px"
    return f"div:has(>{at}){{{sticks};background:var(--panel);box-shadow:6px 0 0 var(--panel)}}"


def _title(earlier: GaugeCheck | None) -> str:
    if earlier is None:
        return html.title("Gauge check", "Two gauge blocks, step against the certificate.")
    back = f'<span class="wv-action" {html.pick("gauge-record", earlier.at)}>Back to this check</span>'
    below = f"Signed by {earlier.signed_by}, {words.day_and_time(earlier.at)}."
    return html.title("Earlier check", below, back)
