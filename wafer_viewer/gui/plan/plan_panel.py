"""Panel of the step Plan: sample, field grid, focus sweep, and cost of each scan strategy."""

from __future__ import annotations

import dataclasses
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import viser

from wafer_viewer.gui.page.import_export_dialogs import load_plan_dialog, save_dialog
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.plan.align_section import Aligning, AlignSection
from wafer_viewer.gui.plan.job_dialogs import job_table, jobs_dialog, load_job, required_job, start_dialog
from wafer_viewer.gui.plan.operator_view import OperatorView, folded, unfold
from wafer_viewer.gui.plan.plan_form import PlanForm, form_of, job_of, stored_form, text_of, with_typed_range
from wafer_viewer.gui.plan.release_section import ReleaseSection
from wafer_viewer.gui.presenters import plan as words
from wafer_viewer.gui.presenters import preflight
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import BoundInput, HtmlBlock, button, duo, in_a_row, leading, set_prop
from wafer_viewer.gui.widgets.debounce import Debouncer
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.gui.widgets.number_field import OptionalPair
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.spec import replace
from wafer_viewer.session.core.dataset_library import today
from wafer_viewer.session.planning.plan_editor import PLAN_ENDING, suggested_name
from wafer_viewer.session.planning.preflight import PreflightCheck, preflight_of_snapshot, stops
from wafer_viewer.session.state.snapshot import Draft, Snapshot, Typed


class PlanPanel:
    """Panel of sample, field grid, focus sweep, strategy and start; for a released job the operator actions only."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._edits = Debouncer(self._commit, guarded(page, "The plan was not changed"))
        self._typed_range_um: tuple[float, float] | None = None
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._build()
        page.on_pick("strategy", self._choose_strategy)
        page.on_pick("job", lambda path: load_job(page, Path(path)))
        page.on_pick("jobs", lambda _: jobs_dialog(page))
        page.on_pick("cover", lambda _: self._cover())
        page.on_pick("undo", lambda _: page.ask("Nothing was undone", page.session.undo()))
        page.on_pick("redo", lambda _: page.ask("Nothing was redone", page.session.redo()))

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Update the panel."""
        set_prop(self._folder, "visible", view.step == "plan")
        if view.step != "plan":
            return
        checks = self._checks(snapshot)
        self._actions.show(snapshot, view, checks)
        set_prop(self._form, "visible", not folded(snapshot, view))
        if not folded(snapshot, view):
            self._show_everything(snapshot, snapshot.draft, checks)
        why = self._why_not(snapshot, checks)
        set_prop(self._start, "disabled", why is not None)
        told = bool(stops(checks)) and folded(snapshot, view)
        self._foot.show("" if told else words.start_hint(snapshot.draft, why))

    def start(self) -> None:
        """Start the scan and go to Acquire; ask for confirmation first if a preflight check is open."""
        checks = self._checks(self._page.session.snapshot)
        if all(check.state == "ok" for check in checks):
            self._start_now()
        else:
            start_dialog(self._page, checks, self._start_now)

    def save(self) -> None:
        """Open the dialog that saves the plan."""
        page = self._page
        name = f"{suggested_name(required_job(page))}{PLAN_ENDING}"
        save_dialog(page, "Save the plan", name, page.session.save_plan, "Plan saved", "The plan was not saved")

    def why_not(self, snapshot: Snapshot) -> str | None:
        """Return why the scan cannot start now, or None."""
        return self._why_not(snapshot, self._checks(snapshot))

    def _start_now(self) -> None:
        page = self._page
        page.ask("The scan did not start", page.session.start_scan(), lambda _: page.change(step="acquire"))

    def _checks(self, snapshot: Snapshot) -> tuple[PreflightCheck, ...]:
        return preflight_of_snapshot(snapshot, self._page.session.latest_frame, today())

    def _why_not(self, snapshot: Snapshot, checks: tuple[PreflightCheck, ...]) -> str | None:
        draft, rig = snapshot.draft, snapshot.rig
        if snapshot.scanning:
            return "a scan is running."
        if rig.state != "ready":
            return rig.message or f"the rig is {rig.state}."
        if draft.typed is not None or draft.job is None:
            return draft.typed.problem if draft.typed else "the sample has no size."
        if draft.problem or draft.plan is None:
            return draft.problem or "the time of the plan is being estimated."
        return next((f"{check.found} {check.mend}" for check in stops(checks)), None)

    # --- building

    def _build(self) -> None:
        gui = self._page.gui
        aligning = Aligning(self._page)
        self._actions = OperatorView(self._page, aligning)
        self._form = gui.add_folder(None)
        with self._form:
            self._build_form(aligning)
        self._foot = HtmlBlock(gui)
        self._start = button(gui, "Start scan", viser.Icon.PLAYER_PLAY, self._on("The scan did not start", self.start))
        leading(gui, self._start, 46)

    def _build_form(self, aligning: Aligning) -> None:
        gui = self._page.gui
        self._title = HtmlBlock(gui)
        self._notes = HtmlBlock(gui)
        self._jobs = HtmlBlock(gui)
        self._build_sample()
        self._build_grid()
        self._build_sweep()
        self._strategies = HtmlBlock(gui)
        save = button(gui, "Save plan…", viser.Icon.DEVICE_FLOPPY, self._on("The plan was not saved", self.save))
        load = button(gui, "Load plan…", viser.Icon.FOLDER_OPEN, lambda _: load_plan_dialog(self._page))
        in_a_row(gui, [save, load])
        self._release = ReleaseSection(self._page)
        self._align = AlignSection(aligning, "Align")
        self._preflight = HtmlBlock(gui)

    def _build_sample(self) -> None:
        gui = self._page.gui
        HtmlBlock(gui, html.head("Sample"))
        self._name = self._field(gui.add_text("Name", ""))
        duo(gui)
        self._lot, self._wafer = self._field(gui.add_text("Lot", "")), self._field(gui.add_text("Wafer", ""))
        duo(gui)
        self._product = self._field(gui.add_text("Product", ""))
        self._operator = self._field(gui.add_text("Operator", ""))
        self._size = self._field(OptionalPair(gui, "Size, mm", over=0).handle)

    def _build_grid(self) -> None:
        gui = self._page.gui
        self._grid_head = HtmlBlock(gui)
        self._grid_fields = gui.add_folder(None, visible=False)
        with self._grid_fields:
            self._columns_rows = self._field(gui.add_vector2("Columns, rows", (1.0, 1.0), min=(1, 1), step=1))
            self._overlap = self._field(gui.add_slider("Overlap, %", 0.0, 50.0, 0.5, 10.0))
            self._centre = self._field(gui.add_vector2("Centre, µm", (0.0, 0.0), step=0.1))
            cover = button(
                gui, "Cover the sample", viser.Icon.ARROWS_MAXIMIZE, self._on("The grid was not changed", self._cover)
            )
            centre = button(
                gui, "Move to stage", viser.Icon.CROSSHAIR, self._on("The grid was not changed", self._to_stage)
            )
            self._moves = (cover, centre)
            in_a_row(gui, self._moves)

    def _build_sweep(self) -> None:
        gui = self._page.gui
        self._sweep_head = HtmlBlock(gui)
        self._sweep_fields = gui.add_folder(None, visible=False)
        with self._sweep_fields:
            sweep = gui.add_vector2("From, to, µm", (0.0, 0.0), step=0.5)
            self._range: BoundInput[tuple[float, float]] = BoundInput(
                sweep, self._typed, self._page, "The plan was not changed"
            )
            self._step = self._field(gui.add_number("Step, µm", 1.0, min=0.0, step=0.05))
            self._exposures = self._field(gui.add_text("Exposures, µs", "100"))
            self._depth = HtmlBlock(gui)

    @property
    def _prepared(self) -> tuple[BoundInput[Any], ...]:
        """Inputs fixed by a released job; the other inputs identify the wafer."""
        places = (self._product, self._size, self._columns_rows, self._overlap, self._centre)
        return (*places, self._range, self._step, self._exposures)

    def _field(self, handle: Any) -> BoundInput[Any]:
        return BoundInput(handle, lambda _: self._edits.made(), self._page, "The plan was not changed")

    def _on(self, name: str, verb: Any) -> Any:
        return guarded(self._page, name)(lambda _: verb())

    # --- the form

    def _show_everything(self, snapshot: Snapshot, draft: Draft, checks: tuple[PreflightCheck, ...]) -> None:
        if not self._edits.under_way:
            self._show_form(_form_of(draft))
        self._show_words(snapshot, draft)
        self._grid_fields.visible = draft.job is not None and draft.job.grid is not None
        self._sweep_fields.visible = draft.job is not None
        released = draft.job is not None and draft.job.released
        for field in self._prepared:
            field.enable(not released)
        for handle in self._moves:
            set_prop(handle, "disabled", released)
        self._release.show(snapshot)
        self._align.show(snapshot, True)
        self._preflight.show(preflight.section(checks))

    @property
    def _fields(self) -> dict[str, BoundInput[Any]]:
        """Inputs by the field names of `PlanForm`."""
        return {
            "name": self._name,
            "lot": self._lot,
            "wafer_id": self._wafer,
            "product": self._product,
            "operator": self._operator,
            "size_mm": self._size,
            "columns_rows": self._columns_rows,
            "overlap_percent": self._overlap,
            "centre_um": self._centre,
            "range_um": self._range,
            "step_um": self._step,
            "exposures_us": self._exposures,
        }

    def _show_form(self, form: PlanForm) -> None:
        for name, field in self._fields.items():
            field.show(getattr(form, name))

    def _read_form(self, draft: Draft) -> PlanForm:
        """Return the session's form with the edited inputs; other inputs may not be up to date yet."""
        typed = {name: field.value for name, field in self._fields.items() if field.edited}
        return dataclasses.replace(_form_of(draft), **typed)

    def _typed(self, event: Any) -> None:
        self._typed_range_um = event.target.value
        self._edits.made()

    def _commit(self) -> Future[Any] | None:
        page, snapshot = self._page, self._page.session.snapshot
        typed = self._read_form(snapshot.draft)
        try:
            form = with_typed_range(typed, snapshot.draft.job, self._typed_range_um)
            job = job_of(form, snapshot.draft.job, snapshot.rig.limits)
        except PlanError as fault:
            return page.session.keep_typed(Typed(text_of(typed), str(fault)))
        if job == snapshot.draft.job:
            return page.session.keep_typed(None)
        answer = page.session.edit_job(job)
        page.ask("The plan was not changed", answer)
        return answer

    def _choose_strategy(self, name: str) -> None:
        job = self._page.session.snapshot.draft.job
        if job is not None:
            self._page.ask("The strategy was not changed", self._page.session.edit_job(replace(job, strategy=name)))

    def _cover(self) -> None:
        self._page.ask("The grid was not changed", self._page.session.cover_sample())

    def _to_stage(self) -> None:
        self._page.ask("The grid was not changed", self._page.session.centre_on_stage())

    def _show_words(self, snapshot: Snapshot, draft: Draft) -> None:
        below = (
            "Lay out the fields, choose the focus range and the fastest strategy."
            if draft.job
            else "Enter the size of the sample; the grid follows."
        )
        released = draft.job is not None and draft.job.released
        title = f"{draft.job.product}, revision {draft.job.revision}" if draft.job and released else "Plan the scan"
        below = "Released: only the names of the wafer can be typed." if released else below
        self._title.show(html.title(title, below, unfold(False) if released else words.history(draft)))
        jobs = snapshot.operating.jobs if draft.job is None else ()
        self._jobs.show(job_table(jobs, "job") if jobs else "")
        self._notes.show(self._page.notes(snapshot))
        self._grid_head.show(words.grid(snapshot))
        self._sweep_head.show(words.sweep(draft))
        self._depth.show(words.depth_of_field_warning(snapshot, draft))
        self._strategies.show(words.strategies(snapshot, draft))


def _form_of(draft: Draft) -> PlanForm:
    return stored_form(draft.typed) or form_of(draft.job)
