"""Search for the exposure of the plan on the rig, and the bracket that it may propose."""

from __future__ import annotations

import re
from collections.abc import Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import TYPE_CHECKING

from wafer_viewer.model.acquisition.plan import Field, ScanPlan
from wafer_viewer.model.acquisition.procedure import FoundExposure
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.job import Job
from wafer_viewer.model.spec import decode, encode, replace
from wafer_viewer.session.acquisition.rig_client import RigClient
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.commands import command
from wafer_viewer.session.planning.plan_editor import PlanEditor

if TYPE_CHECKING:
    from wafer_viewer.acquire.auto_exposure import FindExposure

FIXED = "The job is released, which fixes its exposures: copy it to a new plan first."


def exposure_search(job: Job, plan: ScanPlan, numbers: Sequence[int] = ()) -> FindExposure:
    """Return the search over the fields with these numbers, or over a few spread over the plan.

    Raises PlanError for a released job, and for a number that no field has.
    """
    from wafer_viewer.acquire.auto_exposure import FindExposure, spread_fields

    if job.released:
        raise PlanError(FIXED)
    fields = tuple(_field(plan, number) for number in numbers) or spread_fields(plan.fields)
    return FindExposure(fields, plan.sweep, min(plan.exposures_us))


def write_exposures(path: Path, exposures_us: tuple[float, ...]) -> None:
    """Change the exposures in the file of a plan; its comments and layout are kept."""
    from wafer_viewer.session.planning.job_releases import read_job
    from wafer_viewer.store.io.atomic_files import write_text

    wanted, text = replace(read_job(path), exposures_us=exposures_us), path.read_text(encoding="utf-8")
    line = f"exposures_us = [{', '.join(f'{us:g}' if us % 1 else f'{us:.1f}' for us in exposures_us)}]"
    changed, n = re.subn(r"(?m)^exposures_us\s*=\s*\[[^\]]*\]", line, text, count=1)
    changed = changed if n else re.sub(r"(?m)^(?=\[)", f"{line}\n\n", text, count=1)
    try:
        is_kept = decode(changed, Job, path.name) == wanted
    except PlanError:
        is_kept = False
    write_text(path, changed if is_kept else encode(wanted))


class ExposureController:
    """Controller of the search for the exposure; its result is in the snapshot."""

    def __init__(self, command_queue: CommandQueue, plan_editor: PlanEditor, rig: RigClient) -> None:
        self._command_queue, self._plan_editor, self._rig = command_queue, plan_editor, rig

    @command
    def find(self, fields: tuple[int, ...] = ()) -> Future[FoundExposure]:
        """Find the exposure over the z range of the plan and set it, in one step that can be undone.

        fields: numbers of the fields to look at; by default a few spread over the plan. The exposure suits the
        brightest of them. The future is done when the plan has it, or fails with MotionStopped. Raises PlanError as
        long as the sample is not confirmed, without a plan, and for a released job.
        """
        self._plan_editor.require_confirmed()
        search = exposure_search(*self._plan_editor.ready(), fields)
        self._command_queue.change(exposure=None)
        return self._command_queue.then(self._rig.run_procedure(search), self._found)

    @command
    def take_bracket(self) -> None:
        """Set the exposures of the plan to the proposed bracket. Raises PlanError when there is none."""
        found = self._command_queue.now.exposure
        if found is None or not found.bracket:
            raise PlanError("No bracket is proposed: find the exposure first; where one suffices there is none.")
        self._set(found.bracket_us)

    def _found(self, found: FoundExposure) -> FoundExposure:
        self._command_queue.change(exposure=found)
        self._set(found.single_us)
        return found

    def _set(self, exposures_us: tuple[float, ...]) -> None:
        job, _ = self._plan_editor.ready()
        if job.exposures_us != exposures_us:
            self._plan_editor.edit.run(replace(job, exposures_us=exposures_us))


def _field(plan: ScanPlan, number: int) -> Field:
    field = next((f for f in plan.fields if f.number == number), None)
    if field is None:
        raise PlanError(f"The plan has {len(plan.fields)} fields and no field {number}: choose one of them.")
    return field
