"""Commands of released jobs and of their trial."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any

from wafer_viewer.compute.compute_client import Compute
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.job import Trial
from wafer_viewer.model.spec import replace as replace_in
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.session.core.background_work import Notifications
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.dataset_library import DEFAULT_RESULT
from wafer_viewer.session.planning.job_releases import as_released, list_released
from wafer_viewer.session.planning.plan_editor import Drafting
from wafer_viewer.session.state.snapshot import Snapshot


class JobKeeper:
    """Controller of the snapshot's released jobs. Use on the session's thread only."""

    def __init__(self, desk: CommandQueue, drafting: Drafting, folder: Path) -> None:
        self._desk, self._drafting, self._folder = desk, drafting, folder

    def refresh(self) -> None:
        """List the folder of released jobs again."""
        self._desk.change(operating=replace(self._desk.now.operating, jobs=list_released(self._folder)))

    def release(self) -> Path:
        """Release the plan with the recipe of the displayed surface."""
        path = self._drafting.release(*settled_by(self._desk.now))
        self.refresh()
        return path


def settled_by(now: Snapshot) -> tuple[Recipe | None, tuple[float, float] | None]:
    """Return the resolved recipe of the displayed surface, and the stage errors in the plane and along z.

    Each is None if it is unknown.
    """
    surface = now.surface
    stitched = surface.stitching if surface is not None else None
    errors_um = (stitched.stage_error_um, stitched.z_error_um) if stitched is not None else None
    return surface.settled if surface is not None else None, errors_um


class JobVerbs:
    """Job commands for the page and the prompt, ``session.jobs``; every command returns a future."""

    def __init__(self, do: Callable[..., Future[Any]], keeper: JobKeeper, drafting: Drafting) -> None:
        self._do, self._keeper, self._drafting = do, keeper, drafting

    def refresh(self) -> Future[None]:
        """List the released jobs again."""
        return self._do(self._keeper.refresh)

    def release(self) -> Future[Path]:
        """Release the plan under its product and revision; ``auto`` gets the values resolved for the open surface."""
        return self._do(self._keeper.release)

    def take_up(self, path: Path) -> Future[None]:
        """Load a released job for the next wafer."""
        return self._do(self._drafting.load, Path(path))

    def copy(self) -> Future[None]:
        """Copy the released job to an editable plan."""
        return self._do(self._drafting.copy)

    def confirm(self) -> Future[None]:
        """Confirm that the sample on the stage is the named one."""
        return self._do(self._drafting.confirm)

    def mark(self, n: int, x_um: float, y_um: float) -> Future[None]:
        """Set the stage position of the n-th alignment corner, from 0."""
        return self._do(self._drafting.mark, n, x_um, y_um)

    def unmark(self) -> Future[None]:
        """Clear the marked corners."""
        return self._do(self._drafting.unmark)

    def next_wafer(self) -> Future[None]:
        """Start the same job for the next wafer."""
        return self._do(self._drafting.next_wafer)


NEXT = "next"
"""Revision name of a plan that has none yet."""


class TrialKeeper:
    """Controller of the snapshot's trial. Use on the session's thread only."""

    def __init__(self, desk: CommandQueue, notices: Notifications, drafting: Drafting, compute: Compute) -> None:
        self._desk, self._notices, self._drafting, self._compute = desk, notices, drafting, compute

    def begin(self, paths: tuple[Path, ...], result: str) -> Future[Trial]:
        """Judge stored datasets by the plan. Raises PlanError if it could not be released yet."""
        from wafer_viewer.session.planning.revision_trial import datasets_of, try_job

        if self._desk.now.operating.trying:
            raise PlanError("The plan is being tried already: wait for it, or cancel it in the job list.")
        job, plan = self._drafting.ready()
        job = as_released(replace_in(job, revision=job.revision.strip() or NEXT), plan, *settled_by(self._desk.now))
        datasets = datasets_of(paths)
        title = f"Trial of {job.product} {job.revision}".strip()
        work = self._notices.begin(title, lambda: self._compute.cancel(work))
        self._show(trial=None, trial_of=self._desk.now.draft.job, trying=True)
        done = self._compute.lead(work, try_job, job, datasets, result)
        done.add_done_callback(lambda done: self._desk.note(self._over, work, done))
        return done

    def _over(self, work: str, done: Future[Trial]) -> None:
        self._notices.end(work)
        failed = done.cancelled() or done.exception() is not None
        self._show(trial=None if failed else done.result(), trying=False)

    def _show(self, **changes: Any) -> None:
        self._desk.change(operating=replace(self._desk.now.operating, **changes))


class TrialVerbs:
    """Trial commands of the page, ``session.trials``."""

    def __init__(self, do: Callable[..., Future[Any]], keeper: TrialKeeper) -> None:
        self._do, self._keeper = do, keeper

    def begin(self, paths: tuple[Path, ...], result: str = DEFAULT_RESULT) -> Future[Trial]:
        """Judge stored datasets, and folders of them, by the plan as it would be released.

        The work can be cancelled.
        """
        return self._do(self._keeper.begin, tuple(Path(path) for path in paths), result)
