"""Commands of released jobs and of their trial."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any

from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.job import Trial
from wafer_viewer.model.spec import replace as replace_in
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.session.core.background_work import BackgroundWork
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.commands import command, forwarded
from wafer_viewer.session.core.dataset_library import DEFAULT_RESULT
from wafer_viewer.session.planning.job_releases import as_released, list_released
from wafer_viewer.session.planning.plan_editor import PlanEditor
from wafer_viewer.session.state.snapshot import Snapshot

NEXT = "next"
"""Revision name of a plan that has none yet."""


def _plan(jobs: JobController) -> PlanEditor:
    return jobs._plan_editor


class JobController:
    """Controller of released jobs, ``session.jobs``; every command returns a future."""

    take_up = forwarded(PlanEditor.load, _plan)
    copy = forwarded(PlanEditor.copy, _plan)
    confirm = forwarded(PlanEditor.confirm, _plan)
    mark = forwarded(PlanEditor.mark, _plan)
    unmark = forwarded(PlanEditor.unmark, _plan)
    next_wafer = forwarded(PlanEditor.next_wafer, _plan)

    def __init__(self, command_queue: CommandQueue, plan_editor: PlanEditor, folder: Path) -> None:
        self._command_queue, self._plan_editor, self._folder = command_queue, plan_editor, folder

    @command
    def refresh(self) -> None:
        """List the released jobs again."""
        self._command_queue.change(
            operating=replace(self._command_queue.now.operating, jobs=list_released(self._folder))
        )

    @command.audited("Job released")
    def release(self, why: str = "") -> Path:
        """Release the plan under its product and revision; ``auto`` gets the values resolved for the open surface.

        why: reason, which is needed where people are listed. Raises PlanError with the missing parts.
        """
        self._command_queue.now.control.require_reason(why)
        path = self._plan_editor.release(*settled_by(self._command_queue.now))
        self.refresh.run()
        return path


def settled_by(now: Snapshot) -> tuple[Recipe | None, tuple[float, float] | None]:
    """Return the resolved recipe of the displayed surface, and the stage errors in the plane and along z.

    Each is None if it is unknown.
    """
    surface = now.surface
    stitched = surface.stitching if surface is not None else None
    errors_um = (stitched.stage_error_um, stitched.z_error_um) if stitched is not None else None
    return surface.settled if surface is not None else None, errors_um


class TrialController:
    """Controller of the trial, ``session.trials``."""

    def __init__(self, command_queue: CommandQueue, background: BackgroundWork, plan_editor: PlanEditor) -> None:
        self._command_queue, self._background, self._plan_editor = command_queue, background, plan_editor

    @command
    def begin(self, paths: tuple[Path, ...], result: str = DEFAULT_RESULT) -> Future[Trial]:
        """Judge stored datasets, and folders of them, by the plan as it would be released.

        The work can be cancelled. Raises PlanError if the plan could not be released yet.
        """
        from wafer_viewer.session.planning.revision_trial import datasets_of, try_job

        if self._command_queue.now.operating.trying:
            raise PlanError("The plan is being tried already: wait for it, or cancel it in the job list.")
        job, plan = self._plan_editor.ready()
        job = as_released(
            replace_in(job, revision=job.revision.strip() or NEXT), plan, *settled_by(self._command_queue.now)
        )
        datasets = datasets_of([Path(path) for path in paths])
        title = f"Trial of {job.product} {job.revision}".strip()
        self._show(trial=None, trial_of=self._command_queue.now.draft.job, trying=True)
        return self._background.lead(title, try_job, job, datasets, result, ended=self._ended).done

    def _ended(self, done: Future[Trial]) -> None:
        failed = done.cancelled() or done.exception() is not None
        self._show(trial=None if failed else done.result(), trying=False)

    def _show(self, **changes: Any) -> None:
        self._command_queue.change(operating=replace(self._command_queue.now.operating, **changes))
