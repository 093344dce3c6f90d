"""Operator's view of a released job: wafer, alignment, start; everything else is folded."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any

from markupsafe import Markup

from wafer_viewer.draw.number_format import duration
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.plan.align_section import Aligning, AlignSection
from wafer_viewer.gui.presenters import plan
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callback_timing import Debouncer
from wafer_viewer.gui.widgets.controls import BoundInput, HtmlBlock, add_html, controlled, duo, set_prop
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.model.job import Job
from wafer_viewer.model.spec import replace
from wafer_viewer.session.planning.preflight import PreflightCheck
from wafer_viewer.session.state.snapshot import Snapshot

FAILED = "The names were not changed"
FOCUS = Markup('<i hidden data-arrived="wafer"></i>')
"""Mark that focuses the wafer id once, so that a barcode reader (a keyboard) needs no click."""


class OperatorView:
    """First three of the four operator actions; the fourth, the verdict, follows in Acquire."""

    def __init__(self, page: Page, aligning: Aligning) -> None:
        self._page = page
        self._edits = Debouncer(self._commit, guarded(page, FAILED))
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._title = HtmlBlock(page.gui)
            self._notes = HtmlBlock(page.gui)
            self._build_wafer()
            self._align = AlignSection(aligning, "2 · Align")
            self._checks = HtmlBlock(page.gui)
        page.on_pick("everything", lambda key: page.change(everything=key == "yes"))

    def show(self, snapshot: Snapshot, view: View, checks: tuple[PreflightCheck, ...]) -> None:
        """Update the view; it is visible only if the plan is a released job and the full form is folded."""
        job = snapshot.draft.job
        visible = view.step == "plan" and folded(snapshot, view)
        set_prop(self._folder, "visible", visible)
        self._align.show(snapshot, visible)
        if job is None or not visible:
            self._focus.show("")
            return
        self._title.show(_title(snapshot, job))
        self._notes.show(self._page.notes(snapshot))
        self._focus.show(FOCUS if not job.sample.wafer_id else "")
        if not self._edits.under_way:
            self._wafer_id.show(job.sample.wafer_id)
            self._lot.show(job.sample.lot)
            self._operator.show(job.sample.operator)
        self._checks.show(plan.section(checks, "3 · Start"))

    def _build_wafer(self) -> None:
        gui = self._page.gui
        HtmlBlock(gui, html.head("1 · Wafer", "type the id or scan its barcode"))
        add_html(gui, Markup('<div class="wv-scan"></div>'))
        self._wafer_id = self._field(gui.add_text("Wafer id", ""))
        duo(gui)
        self._lot, self._operator = self._field(gui.add_text("Lot", "")), self._field(gui.add_text("Operator", ""))
        self._focus = HtmlBlock(gui, padded=False)

    def _field(self, handle: Any) -> BoundInput[str]:
        return BoundInput(controlled(handle), lambda _: self._edits.made(), self._page, FAILED)

    def _commit(self) -> Future[Any] | None:
        page, job = self._page, self._page.session.snapshot.draft.job
        if job is None:
            return None
        names = {"wafer_id": self._wafer_id.value, "lot": self._lot.value, "operator": self._operator.value}
        named = replace(job, sample=replace(job.sample, **{key: text.strip() for key, text in names.items()}))
        if named == job:
            page.redraw()
            return None
        answer = page.session.edit_job(named)
        page.ask(FAILED, answer)
        return answer


def folded(snapshot: Snapshot, view: View) -> bool:
    """Return whether only the operator actions of a released job are shown."""
    job = snapshot.draft.job
    return job is not None and job.released and not view.everything


def _title(snapshot: Snapshot, job: Job) -> Markup:
    plan = snapshot.draft.plan
    n = len(job.all_fields())
    takes = f" · {duration(plan.predicted_s)}" if plan is not None else ""
    below = f"Revision {job.revision}, released · {n} field{'s' if n > 1 else ''}{takes}"
    return html.title(job.product, below, _other_job() + unfold(True))


def unfold(more: bool) -> Markup:
    """Return the link that unfolds the full panel, or folds it again."""
    name = "Show everything" if more else "Show less"
    return Markup('<span class="wv-action" {}>{}</span>').format(html.pick("everything", "yes" if more else "no"), name)


def _other_job() -> Markup:
    return Markup('<span class="wv-action" {}>Another job…</span>').format(html.command_pick("jobs"))
