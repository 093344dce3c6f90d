"""Panel of the step Plan: sample, field grid, focus sweep, and cost of each scan strategy."""

from __future__ import annotations

import dataclasses
import math
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import viser

from wafer_viewer.gui.page.import_export_dialogs import load_plan_dialog, save_dialog
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.plan.align_section import Aligning, AlignSection, OperatorView, folded, unfold
from wafer_viewer.gui.plan.job_dialogs import job_table, jobs_dialog, load_job, required_job, start_dialog
from wafer_viewer.gui.plan.plan_sections import ExposureSection, FollowSection, ReleaseSection
from wafer_viewer.gui.presenters import plan as preflight
from wafer_viewer.gui.presenters import plan as words
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import Debouncer, guarded
from wafer_viewer.gui.widgets.controls import (
    BoundInput,
    HtmlBlock,
    command_button,
    controlled,
    duo,
    in_a_row,
    leading,
    set_prop,
    with_decimals,
)
from wafer_viewer.gui.widgets.number_field import OptionalPair, Pair, pair_of, pair_text
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep, FollowFocus
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.errors import PlanError, WaferViewerError
from wafer_viewer.model.job import Compression, Job
from wafer_viewer.model.spec import replace
from wafer_viewer.session.core.dataset_library import today
from wafer_viewer.session.planning.plan_editor import PLAN_ENDING, suggested_name
from wafer_viewer.session.planning.preflight import PreflightCheck, preflight_of_snapshot, stops
from wafer_viewer.session.state.snapshot import Draft, Snapshot, Typed

FIRST_FRAMES = 31
"""Number of frames of the first sweep over a sample of which only the size is known."""
FOLLOW_LABEL = "Below, above focus, µm"
FOLLOW_HINT = (
    "Depth about the focus, such as 5, 5: a coarse look finds the focus, and every field takes its own part of the "
    "sweep. Empty: the whole sweep."
)


COMPRESSIONS: dict[Compression, str] = {
    "none": "As they are",
    "zstd": "Compressed, zstd",
    "deflate": "Compressed, deflate",
    "jpeg2000": "Compressed, JPEG 2000",
}
COMPRESSION_HINT = (
    "Without loss, field by field once the heights are made: zstd is read fastest, JPEG 2000 is smallest and slow, "
    "deflate opens in most programs."
)


@dataclass(frozen=True, slots=True)
class PlanForm:
    """Inputs of the plan panel, in the units shown there."""

    name: str = ""
    lot: str = ""
    wafer_id: str = ""
    product: str = ""
    operator: str = ""
    size_mm: str = ""
    columns_rows: tuple[float, float] = (1.0, 1.0)
    overlap_percent: float = 10.0
    centre_um: tuple[float, float] = (0.0, 0.0)
    range_um: tuple[float, float] = (0.0, 0.0)
    step_um: float = 1.0
    exposures_us: str = "100"
    follow_um: str = ""
    compression: str = COMPRESSIONS["none"]


def form_of(job: Job | None) -> PlanForm:
    """Return the form of a job; an empty form without a job."""
    if job is None:
        return PlanForm()
    sample, grid, sweep = job.sample, job.grid, job.sweep
    z0_um = job.z_start_um if grid else min(f.z_start_um for f in job.fields)
    return PlanForm(
        name=sample.name,
        lot=sample.lot,
        wafer_id=sample.wafer_id,
        product=sample.product,
        operator=sample.operator,
        size_mm=_size_text(sample),
        columns_rows=(float(grid.cols), float(grid.rows)) if grid else (1.0, 1.0),
        overlap_percent=round(100 * grid.overlap_x_fraction, 2) if grid else 0.0,
        centre_um=_rounded(grid.center_um) if grid else (0.0, 0.0),
        range_um=_rounded((z0_um, z0_um + sweep.range_um)),
        step_um=sweep.z_step_um,
        exposures_us=", ".join(f"{e:g}" for e in job.exposures_us),
        follow_um=_follow_text(job.follow_focus),
        compression=COMPRESSIONS[job.compression],
    )


def text_of(form: PlanForm) -> str:
    """Serialise a form as JSON, to store it while it is not a valid plan."""
    return msgspec.json.encode(form).decode()


def stored_form(typed: Typed | None) -> PlanForm | None:
    """Return the stored form; None if there is none, or one of another version."""
    try:
        return msgspec.json.decode(typed.form, type=PlanForm) if typed is not None else None
    except (msgspec.DecodeError, msgspec.ValidationError):
        return None


def job_of(form: PlanForm, old: Job | None, limits: RigLimits | None) -> Job:
    """Return the job of a form; settings of the old job that the form does not show are kept.

    Raises PlanError with a message for the user if the form is not a valid job.
    """
    if old is None:
        return _first_job(form, limits)
    before = form_of(old)
    return replace(
        old,
        sample=_sample(form, old.sample),
        grid=_grid(form, before, old.grid) if old.grid else None,
        z_start_um=old.z_start_um if form.range_um[0] == before.range_um[0] else form.range_um[0],
        sweep=old.sweep if _same_sweep(form, before) else sweep_of(form),
        exposures_us=_exposures(form.exposures_us),
        follow_focus=old.follow_focus if form.follow_um == before.follow_um else _follow(form, old.follow_focus),
        compression=_compression(form),
    )


def sweep_of(form: PlanForm) -> FocusSweep:
    """Return the focus sweep from the lowest z upward, with as many frames as fit; raise PlanError if invalid."""
    low, high = form.range_um
    if form.step_um <= 0:
        raise PlanError(f"The step of the focus sweep is {form.step_um:g} µm: it must be over 0.")
    if high <= low:
        raise PlanError(f"The focus sweep goes from {low:g} to {high:g} µm: the second must be higher than the first.")
    return FocusSweep(z_step_um=form.step_um, n_frames=_frames_in(form.range_um, form.step_um))


def _frames_in(range_um: tuple[float, float], step_um: float) -> int:
    return 1 + math.floor((range_um[1] - range_um[0]) / step_um + 1e-6)


def with_typed_range(form: PlanForm, job: Job | None, typed_um: tuple[float, float] | None) -> PlanForm:
    """Return the form with the typed focus range instead of the range rounded to full steps.

    A coarse step shortens the displayed range; a finer step entered next must restore it.
    """
    if job is None or typed_um is None:
        return form
    before = form_of(job)
    untouched = form.range_um == before.range_um and typed_um[0] == before.range_um[0] and typed_um[1] > typed_um[0]
    led_here = untouched and _frames_in(typed_um, job.sweep.z_step_um) == job.sweep.n_frames
    return dataclasses.replace(form, range_um=typed_um) if led_here else form


def _first_job(form: PlanForm, limits: RigLimits | None) -> Job:
    size_um = _size_um(form)
    if limits is None:
        raise PlanError("The rig has not reported its limits yet: the grid follows when it is ready.")
    if size_um is None:
        raise PlanError("The sample has no size yet: type its width and height in mm, such as 12.5 × 8.")
    width_um, height_um = size_um
    step_um = max(0.5, math.floor(limits.depth_of_field_um) / 2)
    return Job(
        sample=_sample(form, Sample()),
        grid=FieldGrid.covering(
            width_um, height_um, field_width_um=limits.field_width_um, field_height_um=limits.field_height_um
        ),
        z_start_um=-step_um * (FIRST_FRAMES - 1) / 2,
        sweep=FocusSweep(z_step_um=step_um, n_frames=FIRST_FRAMES),
        exposures_us=_exposures(form.exposures_us),
        compression=_compression(form),
    )


def _compression(form: PlanForm) -> Compression:
    return next(codec for codec, title in COMPRESSIONS.items() if title == form.compression)


def _size_um(form: PlanForm) -> Pair | None:
    """Return width and height of the sample; None if they are not given."""
    try:
        size_mm = pair_of(form.size_mm, "Size, mm", over=0)
    except WaferViewerError as fault:
        raise PlanError(str(fault)) from fault
    return None if size_mm is None else (1000 * size_mm[0], 1000 * size_mm[1])


def _size_text(sample: Sample) -> str:
    size_um = sample.size_um
    return "" if size_um is None else pair_text((round(size_um[0] / 1000, 4), round(size_um[1] / 1000, 4)))


def _sample(form: PlanForm, old: Sample) -> Sample:
    width_um, height_um = _size_um(form) or (None, None)
    if form.size_mm == _size_text(old):
        width_um, height_um = old.width_um, old.height_um
    return replace(
        old,
        name=form.name.strip(),
        lot=form.lot.strip(),
        wafer_id=form.wafer_id.strip(),
        product=form.product.strip(),
        operator=form.operator.strip(),
        width_um=width_um,
        height_um=height_um,
    )


def _grid(form: PlanForm, before: PlanForm, old: FieldGrid) -> FieldGrid:
    """Return the grid around the form's centre; around the old, unrounded centre if it is unchanged."""
    grid = old
    if form.overlap_percent != before.overlap_percent:
        overlap = form.overlap_percent / 100
        grid = replace(grid, overlap_x_fraction=overlap, overlap_y_fraction=overlap)
    if form.columns_rows != before.columns_rows:
        cols, rows = (round(n) for n in form.columns_rows)
        grid = grid.resized(rows=rows, cols=cols)
    centre = old.center_um if form.centre_um == before.centre_um else form.centre_um
    return old if grid == old and centre == old.center_um else grid.centred_on(*centre)


def _same_sweep(form: PlanForm, before: PlanForm) -> bool:
    return form.step_um == before.step_um and form.range_um == before.range_um


def _exposures(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.replace(";", ",").split(",") if part.strip())
    except ValueError:
        raise PlanError(f"The exposures read '{text}': they must be times in µs, separated by commas.") from None


def _follow(form: PlanForm, old: FollowFocus | None) -> FollowFocus | None:
    """Return the depth about the focus; None where it is empty, and the whole sweep is taken."""
    try:
        depth_um = pair_of(form.follow_um, FOLLOW_LABEL)
    except WaferViewerError as fault:
        raise PlanError(str(fault)) from fault
    if depth_um is None:
        return None
    return replace(old or FollowFocus(), below_um=depth_um[0], above_um=depth_um[1])


def _follow_text(follow: FollowFocus | None) -> str:
    return "" if follow is None else pair_text((follow.below_um, follow.above_um), ", ")


def _rounded(pair: tuple[float, float]) -> tuple[float, float]:
    return round(pair[0], 2), round(pair[1], 2)


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
        visible = view.step == "plan" and not view.live
        set_prop(self._folder, "visible", visible)
        if not visible:
            return
        checks = self._checks(snapshot)
        self._actions.show(snapshot, view, checks)
        set_prop(self._form, "visible", not folded(snapshot, view))
        if not folded(snapshot, view):
            self._show_everything(snapshot, snapshot.draft, checks)
            self._following.show(snapshot, view)
        why = self._why_not(snapshot, checks)
        set_prop(self._start, "disabled", why is not None)
        explained = bool(stops(checks)) and folded(snapshot, view)
        self._foot.show("" if explained else words.start_hint(snapshot.draft, why))

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
        if not rig.can_start:
            return rig.message or f"the rig is {rig.state}."
        operating = snapshot.control.refusal("Job released") is not None
        if operating and not (draft.job is not None and draft.job.released):
            return "choose a released job: operators run no other plan."
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
        self._start = command_button(
            gui, "Start scan", viser.Icon.PLAYER_PLAY, self._on("The scan did not start", self.start)
        )
        leading(gui, self._start, 46)

    def _build_form(self, aligning: Aligning) -> None:
        gui = self._page.gui
        self._title = HtmlBlock(gui)
        self._notes = HtmlBlock(gui)
        self._jobs = HtmlBlock(gui)
        self._build_sample()
        self._build_grid()
        self._build_sweep()
        self._following = FollowSection(self._page)
        self._strategies = HtmlBlock(gui)
        save = command_button(
            gui,
            "Save plan…",
            viser.Icon.DEVICE_FLOPPY,
            self._on("The plan was not saved", self.save),
            action="Plan saved",
        )
        load = command_button(gui, "Load plan…", viser.Icon.FOLDER_OPEN, lambda _: load_plan_dialog(self._page))
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
        self._product = self._prepared_field(gui.add_text("Product", ""))
        self._operator = self._field(gui.add_text("Operator", ""))
        self._size = self._prepared_field(OptionalPair(gui, "Size, mm", over=0).handle)

    def _build_grid(self) -> None:
        gui = self._page.gui
        self._grid_head = HtmlBlock(gui)
        self._grid_fields = gui.add_folder(None, visible=False)
        with self._grid_fields:
            self._columns_rows = self._prepared_field(gui.add_vector2("Columns, rows", (1.0, 1.0), min=(1, 1), step=1))
            self._overlap = self._prepared_field(gui.add_slider("Overlap, %", 0.0, 50.0, 0.5, 10.0))
            self._centre = self._prepared_field(with_decimals(gui.add_vector2("Centre, µm", (0.0, 0.0), step=0.1), 2))
            failed = "The grid was not changed"
            cover = command_button(
                gui,
                "Cover the sample",
                viser.Icon.ARROWS_MAXIMIZE,
                self._on(failed, self._cover),
                action="Plan saved",
            )
            centre = command_button(
                gui, "Move to stage", viser.Icon.CROSSHAIR, self._on(failed, self._to_stage), action="Plan saved"
            )
            self._moves = (cover, centre)
            in_a_row(gui, self._moves)

    def _build_sweep(self) -> None:
        gui = self._page.gui
        self._sweep_head = HtmlBlock(gui)
        self._sweep_fields = gui.add_folder(None, visible=False)
        with self._sweep_fields:
            sweep = with_decimals(gui.add_vector2("From, to, µm", (0.0, 0.0), step=0.5), 2)
            self._range: BoundInput[tuple[float, float]] = BoundInput(
                controlled(sweep, "Plan saved"), self._typed, self._page, "The plan was not changed"
            )
            self._step = self._prepared_field(with_decimals(gui.add_number("Step, µm", 1.0, min=0.0, step=0.05), 3))
            self._follow = self._prepared_field(OptionalPair(gui, FOLLOW_LABEL, between=", ", hint=FOLLOW_HINT).handle)
            self._exposures = self._prepared_field(gui.add_text("Exposures, µs", "100"))
            self._exposure = ExposureSection(self._page)
            self._compression = self._prepared_field(
                gui.add_dropdown("Frames on disk", tuple(COMPRESSIONS.values()), hint=COMPRESSION_HINT)
            )
            self._depth = HtmlBlock(gui)

    @property
    def _prepared(self) -> tuple[BoundInput[Any], ...]:
        """Inputs fixed by a released job; the other inputs identify the wafer."""
        places = (self._product, self._size, self._columns_rows, self._overlap, self._centre)
        return (*places, self._range, self._step, self._follow, self._exposures, self._compression)

    def _field(self, handle: Any) -> BoundInput[Any]:
        return BoundInput(controlled(handle), lambda _: self._edits.made(), self._page, "The plan was not changed")

    def _prepared_field(self, handle: Any) -> BoundInput[Any]:
        """Return an input of what an engineer prepares."""
        bound = self._field(handle)
        controlled(bound.handle, "Plan saved")
        return bound

    def _on(self, name: str, verb: Any) -> Any:
        return guarded(self._page, name)(lambda _: verb())

    # --- the form

    def _show_everything(self, snapshot: Snapshot, draft: Draft, checks: tuple[PreflightCheck, ...]) -> None:
        if not self._edits.under_way:
            self._show_form(form_of_draft(snapshot))
        self._show_words(snapshot, draft)
        self._grid_fields.visible = draft.job is not None and draft.job.grid is not None
        self._sweep_fields.visible = draft.job is not None
        released = draft.job is not None and draft.job.released
        for field in self._prepared:
            field.enable(not released)
        for handle in self._moves:
            set_prop(handle, "disabled", released)
        self._exposure.show(snapshot)
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
            "follow_um": self._follow,
            "columns_rows": self._columns_rows,
            "overlap_percent": self._overlap,
            "centre_um": self._centre,
            "range_um": self._range,
            "step_um": self._step,
            "exposures_us": self._exposures,
            "compression": self._compression,
        }

    def _show_form(self, form: PlanForm) -> None:
        for name, field in self._fields.items():
            field.show(getattr(form, name))

    def _read_form(self, snapshot: Snapshot) -> PlanForm:
        """Return the session's form with the edited inputs; other inputs may not be up to date yet."""
        typed = {name: field.value for name, field in self._fields.items() if field.edited}
        return dataclasses.replace(form_of_draft(snapshot), **typed)

    def _typed(self, event: Any) -> None:
        self._typed_range_um = event.target.value
        self._edits.made()

    def _commit(self) -> Future[Any] | None:
        page, snapshot = self._page, self._page.session.snapshot
        typed = self._read_form(snapshot)
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


def form_of_draft(snapshot: Snapshot) -> PlanForm:
    """Return the form of the draft; before there is a plan, it names the person who is signed in."""
    draft = snapshot.draft
    if (typed := stored_form(draft.typed)) is not None:
        return typed
    return form_of(draft.job) if draft.job is not None else PlanForm(operator=snapshot.control.author(""))
