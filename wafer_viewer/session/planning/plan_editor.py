"""Plan editor: the plan is recalculated at every change, with undo."""

from __future__ import annotations

import math
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from wafer_viewer.model.acquisition.devices import Overview
from wafer_viewer.model.acquisition.plan import (
    FOLLOW_FOCUS,
    MIN_FRAMES,
    CoarseLook,
    FieldFocus,
    FieldGrid,
    FocusSweep,
    ScanPlan,
)
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.errors import PlanError, RoleError, WaferViewerError
from wafer_viewer.model.job import Job
from wafer_viewer.model.spec import encode, replace
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.session.core.command_queue import CommandQueue, UndoHistory
from wafer_viewer.session.core.commands import command
from wafer_viewer.session.planning.job_releases import (
    as_on_disk,
    as_released,
    for_next_wafer,
    read_job,
    require_as_released,
    require_released,
    write_released,
)
from wafer_viewer.session.state.snapshot import Draft, MarkedPositions, Place, Typed

if TYPE_CHECKING:
    from wafer_viewer.acquire.focus.coarse_look import LookForFocus

PLAN_ENDING = ".toml"
MOST_SHOWN = 5000
"""Greatest number of fields whose focus is shown."""
RIG_STARTS = "The rig is starting: its time is estimated as soon as the rig answers."
UNCONFIRMED = (
    "What was open is open again, and another sample may lie on the stage by now: confirm the sample before anything "
    "moves."
)
NO_JOB = "There is no plan yet: lay a field grid over the sample first."


class PlanEditor:
    """Controller of the plan and its draft in the snapshot; every command returns a future."""

    def __init__(self, command_queue: CommandQueue, folder: Path) -> None:
        self._command_queue, self._folder = command_queue, folder
        self._jobs: UndoHistory[Job | None] = UndoHistory(None)
        self._marks = MarkedPositions()
        self._confirmed = True
        self._typed: Typed | None = None
        self._typed_over: Job | None = None
        self.tour: Job | None = None
        self._look: CoarseLook | None = None
        self._look_of: tuple[object, ...] = ()

    @command
    def edit(self, job: Job | None) -> None:
        """Set the plan; its scan time and size are calculated at once.

        None clears it. Raises PlanError if that changes a released job, RoleError if an operator changes a plan.
        """
        before = self._jobs.value
        if job is not None and not (job.released and before is not None and before.released):
            self._require_engineer()
        require_as_released(before, job)
        if job is not None and before is not None and before.alignment == job.alignment and _another(before, job):
            job = replace(job, alignment=None)
        self._put(job)

    def _require_engineer(self) -> None:
        """Raise RoleError if the holder of the controls may not change plans."""
        if (why := self._command_queue.now.control.refusal("Plan saved")) is not None:
            raise RoleError(why)

    def require_runnable(self, job: Job) -> None:
        """Raise RoleError if the holder of the controls is an operator, and the job is not as it was released."""
        control = self._command_queue.now.control
        if control.refusal("Job released") is not None:
            require_released(self._folder, job, f"{control.name_of(control.holder)} is signed in as operator.")

    def reopen(self, job: Job | None, typed: Typed | None = None) -> None:
        """Restore the plan of the last run; the sample has to be confirmed before a scan.

        The alignment is dropped, because the wafer may have moved.
        """
        self._jobs.restart(None if job is None else replace(job, alignment=None))
        self._confirmed = False
        self.keep_typed.run(typed)

    @command
    def keep_typed(self, typed: Typed | None) -> None:
        """Store form input that makes no plan yet; None when the input is a plan again. Any edit clears it as well."""
        self._typed, self._typed_over = typed, self._jobs.value
        self.price()

    def require_confirmed(self) -> None:
        """Raise PlanError while a restored plan may be of another sample than the one on the stage."""
        if not self._confirmed:
            raise PlanError(UNCONFIRMED)

    @command
    def confirm(self) -> None:
        """Confirm that the sample on the stage is the named one."""
        self._confirmed = True
        self.price()

    @command
    def mark(self, n: int, x_um: float, y_um: float) -> None:
        """Set the stage position of the n-th corner, from 0; after the last one the wafer is aligned.

        Raises PlanError when there are no corners to mark, and when they give no alignment.
        """
        from wafer_viewer.calibrate.wafer_alignment import fit_alignment

        job = self._jobs.value
        if job is None or job.marks is None:
            raise PlanError("The plan names no corners to align by: name them first.")
        self._marks = self._marks.with_place(job, n, (x_um, y_um))
        self._put(replace(job, alignment=None))
        marked_um = [place for place in self._marks.places_um(job) if place is not None]
        if len(marked_um) == len(job.marks.places):
            fitted = fit_alignment(job.marks, marked_um, job.sample.notch)
            self._put(replace(job, alignment=fitted))

    @command
    def unmark(self) -> None:
        """Clear the marked corners."""
        self._marks = MarkedPositions()
        if (job := self._jobs.value) is not None:
            self._put(replace(job, alignment=None))

    @command
    def next_wafer(self) -> None:
        """Start the same job for another wafer; undo cannot restore the data of the last one."""
        self._marks, self._confirmed = MarkedPositions(), True
        self._jobs.restart(self._for_operator(for_next_wafer(self._job())))
        self.price()

    @command
    def copy(self) -> None:
        """Copy a released job to an editable plan for another revision."""
        self._require_engineer()
        self._put(replace(self._job(), released=False, revision="", alignment=None))

    def release(self, settled: Recipe | None, errors_um: tuple[float, float] | None) -> Path:
        """Write and load the job as a released one; settled: the recipe of the displayed surface."""
        ready = as_released(*self.ready(), settled, errors_um)
        path = write_released(self._folder, ready)
        self._take_up(ready)
        return path

    def _put(self, job: Job | None) -> None:
        self._jobs.put(job)
        self.price()

    def _take_up(self, job: Job) -> None:
        """Load a job from a file; a released one has no wafer yet."""
        self._marks, self._confirmed = MarkedPositions(), True
        self._put(self._for_operator(for_next_wafer(job) if job.released else job))

    def _for_operator(self, job: Job) -> Job:
        """Return a job that names no operator yet with the person who is signed in, if somebody is."""
        name = self._command_queue.now.control.author("")
        if job.sample.operator or not name:
            return job
        return replace(job, sample=replace(job.sample, operator=name))

    @command
    def undo(self) -> None:
        """Undo the last edit."""
        self._jobs.undo()
        self.price()

    @command
    def redo(self) -> None:
        """Redo the last undone edit."""
        self._jobs.redo()
        self.price()

    def price(self) -> None:
        """Recalculate the plan of the job: after an edit, and when the rig is ready."""
        job, limits = self._jobs.value, self._command_queue.now.rig.limits
        plan, problem = _plan(job, limits, self._look if job is not None and self._look_of == _place(job) else None)
        typed = self._typed if self._typed_over is job else None
        marked_um = self._marks.places_um(job) if job is not None else ()
        can = self._jobs.can_undo, self._jobs.can_redo
        focus = focus_of(plan, limits)
        draft = Draft(job, plan, problem, *can, free_bytes(self._folder), marked_um, self._confirmed, typed, focus)
        self._command_queue.change(draft=draft)

    def take_look(self, job: Job, look: CoarseLook) -> None:
        """Plan by a coarse look; it holds as long as fields, sweep, exposures and sample stay the same."""
        self._look, self._look_of = look, _place(job)
        self.price()

    @command
    def cover_sample(self) -> None:
        """Set the grid to cover the sample, centred on it."""
        job = self._job()
        x_um, y_um, width_um, height_um = _extent(job, self._command_queue.now.overview)
        covering = covering_grid(self._grid(job), (x_um, y_um), (width_um, height_um))
        self.edit.run(replace(job, grid=covering, fields=()))

    @command
    def centre_on_stage(self) -> None:
        """Centre the grid on the current stage position."""
        job, rig = self._job(), self._command_queue.now.rig
        self.edit.run(replace(job, grid=self._grid(job).centred_on(rig.x_um, rig.y_um), fields=()))

    @command
    def lay_out(self, corners_um: tuple[Place, Place] | None = None, z_um: tuple[float, float] | None = None) -> None:
        """Set the grid to cover the rectangle between two corners, and the sweep to a z range, in one edit.

        None leaves it unchanged. The step of the sweep stays.
        """
        job = self._job()
        if corners_um is not None:
            (xa, ya), (xb, yb) = corners_um
            covering = covering_grid(self._grid(job), ((xa + xb) / 2, (ya + yb) / 2), (abs(xa - xb), abs(ya - yb)))
            job = replace(job, grid=covering, fields=())
        if z_um is not None:
            low_um, high_um = z_um
            if high_um <= low_um:
                raise PlanError(
                    f"The highest point, {high_um:.1f} um, is not above the lowest, {low_um:.1f} um: mark them again."
                )
            step_um = job.sweep.z_step_um
            n_frames = max(MIN_FRAMES, 1 + math.ceil((high_um - low_um) / step_um - 1e-6))
            middle_um = (low_um + high_um) / 2
            start_um = round(middle_um - step_um * (n_frames - 1) / 2, 2)
            job = replace(job, sweep=FocusSweep(z_step_um=step_um, n_frames=n_frames), z_start_um=start_um)
        self.edit.run(job)

    @command
    def take_tour(self) -> None:
        """Load the tour job of the virtual rig."""
        if self.tour is None:
            raise PlanError(
                "The tour needs a virtual rig that answers: wait until it has started, or serve without --rig."
            )
        self._require_engineer()
        self._take_up(self.tour)

    @command
    def load(self, path: Path) -> None:
        """Read a job from PLAN.toml; one that was edited since its release is a plan again.

        Raises RoleError if an operator loads what is not released.
        """
        job = as_on_disk(self._folder, Path(path), read_job(Path(path)))
        self.require_runnable(job)
        self._take_up(job)

    @command.audited("Plan saved")
    def save(self, path: Path | None = None) -> Path:
        """Write the job to PLAN.toml, next to the datasets if no path is given, and return the path."""
        from wafer_viewer.store.io.atomic_files import write_text

        job = self._job()
        target = path or self._folder / f"{suggested_name(job)}{PLAN_ENDING}"
        write_text(target, encode(job))
        return target

    def ready(self) -> tuple[Job, ScanPlan]:
        """Return the job and its plan. Raises PlanError with the reason when there is none to scan."""
        draft = self._command_queue.now.draft
        if draft.typed is not None:
            raise PlanError(draft.typed.problem)
        if draft.job is None or draft.plan is None:
            raise PlanError(draft.problem or NO_JOB)
        return draft.job, draft.plan

    def _job(self) -> Job:
        limits = self._command_queue.now.rig.limits
        if self._jobs.value is not None:
            return self._jobs.value
        if limits is None:
            raise PlanError(RIG_STARTS)
        return self._for_operator(first_job(limits))

    def _grid(self, job: Job) -> FieldGrid:
        if job.grid is not None:
            return job.grid
        limits = self._command_queue.now.rig.limits
        if limits is None:
            raise PlanError(RIG_STARTS)
        return one_field(limits)


def _another(before: Job, after: Job) -> bool:
    """Return whether two jobs are of different wafers, so that the alignment does not carry over."""
    return (before.sample.lot, before.sample.wafer_id) != (after.sample.lot, after.sample.wafer_id)


def first_job(limits: RigLimits) -> Job:
    """Return the initial job: one field and a sweep with steps of half the depth of field."""
    step_um = max(0.1, round(limits.depth_of_field_um / 2, 1))
    return Job(grid=one_field(limits), sweep=FocusSweep(z_step_um=step_um, n_frames=40))


def one_field(limits: RigLimits) -> FieldGrid:
    """Return a grid of one field at the stage's origin."""
    return FieldGrid(rows=1, cols=1, field_width_um=limits.field_width_um, field_height_um=limits.field_height_um)


def covering_grid(grid: FieldGrid, center_um: Place, size_um: tuple[float, float]) -> FieldGrid:
    """Return the smallest grid of the same fields and overlaps that covers a rectangle of width x height."""
    return FieldGrid.covering(
        *size_um,
        field_width_um=grid.field_width_um,
        field_height_um=grid.field_height_um,
        overlap_x_fraction=grid.overlap_x_fraction,
        overlap_y_fraction=grid.overlap_y_fraction,
        center_x_um=center_um[0],
        center_y_um=center_um[1],
    )


def suggested_name(job: Job) -> str:
    """Return a file name from the names of the sample."""
    words = [w for w in (job.sample.lot, job.sample.wafer_id or job.sample.name, job.product) if w][:2]
    plain = "-".join("".join(c if c.isalnum() or c in "._" else "-" for c in w).strip("-.") for w in words)
    return plain or "scan"


def free_bytes(folder: Path) -> int | None:
    """Return the free space of a folder's disk in bytes; None when it is unknown."""
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return None


def plan_of(job: Job, limits: RigLimits, look: CoarseLook | None = None) -> ScanPlan:
    """Plan the scan of a job on a rig, by the coarse look if there is one. Raises PlanError when it is impossible."""
    from wafer_viewer.acquire.focus.windows import plan_following
    from wafer_viewer.acquire.planner import plan_scan

    scan = job.all_fields(), job.sweep, job.exposures_us, limits, job.strategy
    if job.follow_focus is None:
        return plan_scan(*scan)
    return plan_following(*scan, job.follow_focus, look)


def look_for(job: Job, plan: ScanPlan) -> LookForFocus:
    """Return the coarse look of a plan. Raises PlanError if it does not follow the focus."""
    from wafer_viewer.acquire.focus.coarse_look import LookForFocus

    if job.follow_focus is None:
        raise PlanError("The plan does not follow the focus: give it the depth about the focus first.")
    return LookForFocus(job.all_fields(), plan.sweep, plan.exposures_us[0])


def look_further(job: Job, plan: ScanPlan, limits: RigLimits) -> LookForFocus:
    """Return the look at more places, where the prediction of a plan is least certain. Raises PlanError without any."""
    from wafer_viewer.acquire.focus.coarse_look import LookForFocus, more_places

    if plan.coarse_look is None:
        raise PlanError("The plan follows no coarse look yet: look for the focus first, with Follow the focus chosen.")
    places = more_places(plan.fields, plan.coarse_look, plan.sweep, limits)
    if not places:
        raise PlanError("Every field was looked at: there are no more places.")
    return LookForFocus(job.all_fields(), plan.sweep, plan.exposures_us[0], places, plan.coarse_look)


def focus_of(plan: ScanPlan | None, limits: RigLimits | None) -> tuple[FieldFocus, ...]:
    """Return the focus of each field of a plan that follows a coarse look; empty for others, and for large plans."""
    if plan is None or limits is None or plan.coarse_look is None or len(plan.fields) > MOST_SHOWN:
        return ()
    from wafer_viewer.acquire.focus.windows import ranges_of

    ranges = ranges_of(plan.fields, plan.coarse_look, limits)
    u_um = np.maximum(ranges.u_low_um, ranges.u_high_um)
    ends = zip(plan.fields, ranges.low_um.tolist(), ranges.high_um.tolist(), u_um.tolist(), strict=True)
    return tuple(FieldFocus(field.number, low_um, high_um, u) for field, low_um, high_um, u in ends)


def look_before(job: Job, plan: ScanPlan) -> LookForFocus | None:
    """Return the coarse look that has to precede the scan of a plan, None if there is nothing to look for."""
    needs = plan.strategy == FOLLOW_FOCUS and plan.coarse_look is None
    return look_for(job, plan) if needs else None


def _place(job: Job) -> tuple[object, ...]:
    """Return the parts of a job on which a coarse look depends."""
    return job.grid, job.fields, job.z_start_um, job.sweep, job.exposures_us, job.alignment, job.sample


def _plan(
    job: Job | None, limits: RigLimits | None, look: CoarseLook | None = None
) -> tuple[ScanPlan | None, str | None]:
    """Return the plan of a job, and the reason if there is none."""
    if job is None:
        return None, None
    if limits is None:
        return None, RIG_STARTS
    try:
        return plan_of(job, limits, look), None
    except WaferViewerError as fault:
        return None, str(fault)


def _extent(job: Job, overview: Overview | None) -> tuple[float, float, float, float]:
    """Return x and y of the middle, width and height of the sample in um."""
    outline = overview.outline_um if overview is not None else ()
    sample = job.sample
    if (size_um := sample.size_um) is not None:
        x_um, y_um = job.grid.center_um if job.grid is not None and not outline else _middle(outline)
        return x_um, y_um, *size_um
    if not outline:
        raise PlanError("The sample has no size: give its width and height, then cover it.")
    xs, ys = [x for x, _ in outline], [y for _, y in outline]
    return *_middle(outline), max(xs) - min(xs), max(ys) - min(ys)


def _middle(outline: tuple[tuple[float, float], ...]) -> tuple[float, float]:
    if not outline:
        return 0.0, 0.0
    xs, ys = [x for x, _ in outline], [y for _, y in outline]
    return math.fsum((min(xs), max(xs))) / 2, math.fsum((min(ys), max(ys))) / 2
