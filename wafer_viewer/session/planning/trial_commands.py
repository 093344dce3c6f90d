"""Trial of the plan on stored wafers before its release, as background work, and the last trial's result."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any

from wafer_viewer.compute.compute_client import Compute
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.job.revision_trial import Trial
from wafer_viewer.model.spec import replace as replace_in
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.dataset_library import DEFAULT_RESULT
from wafer_viewer.session.core.notifications import Notifications
from wafer_viewer.session.planning.job_commands import settled_by
from wafer_viewer.session.planning.job_releases import as_released
from wafer_viewer.session.planning.plan_editor import Drafting

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
