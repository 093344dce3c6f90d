"""Reconstruction queue: schedules scanned fields on workers and then the stitching."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from wafer_viewer.compute.child_process import ChildDied
from wafer_viewer.compute.compute_client import Compute
from wafer_viewer.compute.messages import ComputeAbsent, ComputeUp, ComputeWarm, Progressed
from wafer_viewer.model.errors import ComputeError, DatasetError
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.session.core.background_work import Notifications
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.dataset_library import Library
from wafer_viewer.session.state.snapshot import FieldState, SurfaceInfo
from wafer_viewer.session.surface.kernel_build import WARM_UP
from wafer_viewer.session.surface.stitching_job import bring_up_to_date, describe_mosaic
from wafer_viewer.session.surface.worker_tasks import reconstruct_field, reconstruct_live


def no_heights(number: int) -> str:
    """Return the title of the fault of a field that could not be reconstructed."""
    return f"Field {number} has no heights"


@dataclass(slots=True)
class ReconstructionRun:
    """Reconstruction of the open dataset; fields can be added while a scan runs.

    complete: fields that have all their frames; live: those reconstructed during their scan, of which made_live have
    their heights. restitch: the mosaic lacks available heights; grown: fields were added before all were available, so
    their poses still have to be solved jointly; grows_again_at: earliest clock time of the next update.
    """

    path: Path
    result: str
    recipe: Recipe
    work: str
    waiting: deque[int] = field(default_factory=deque[int])
    busy: set[int] = field(default_factory=set[int])
    total: int = 0
    complete: set[int] = field(default_factory=set[int])
    live: set[int] = field(default_factory=set[int])
    made_live: set[int] = field(default_factory=set[int])
    restitch: bool = False
    grown: bool = False
    stitching: bool = False
    grows_again_at: float = 0.0
    settled: bool = False
    completion: Future[None] | None = None

    @property
    def settling(self) -> bool:
        """True while a field still has to resolve `auto` for all; fields are processed one by one, in their order."""
        return self.recipe.heights_have_auto and not self.settled

    @property
    def idle(self) -> bool:
        """True if no field is queued or on a worker."""
        return not self.waiting and not self.busy

    @property
    def growing_work(self) -> str:
        """Name of the work item for updates of the growing mosaic."""
        return f"{self.work}-growing"

    def live_work(self, number: int) -> str:
        """Return the name of the work item of a field's live reconstruction."""
        return f"{self.work}-live-{number}"


GROWING_PAUSES = 3.0
"""Pause between updates of a growing mosaic, relative to the duration of an update; field heights have priority."""
RESTARTS = 3
"""Maximum number of restarts of the compute host per session."""


class Reconstruction:
    """Reconstruction queue of the session.

    Use on the session's thread only. While a scan runs one worker stays free for the rig. `completed` is called after
    each run that ends by itself.
    """

    def __init__(
        self,
        command_queue: CommandQueue,
        notices: Notifications,
        library: Library,
        scheduler: str | None,
        completed: Callable[[], None],
    ) -> None:
        self._command_queue, self._notices, self._library = command_queue, notices, library
        self._completed = completed
        self.compute = Compute(scheduler, WARM_UP, self._heard, self._gone)
        self._n_workers, self._warm, self._restarts = 1, False, 0
        self._failure_reported = False
        self._run: ReconstructionRun | None = None
        self._on = {
            ComputeUp: self._up,
            ComputeWarm: self._warmed,
            ComputeAbsent: self._absent,
            Progressed: lambda event: self._notices.progress(event.work, event.fraction),
        }

    def begin(
        self,
        recipe: Recipe,
        result: str,
        fields: Iterable[int],
        completion: Future[None] | None = None,
        *,
        restitch: bool = False,
    ) -> None:
        """Reconstruct fields of the open dataset into a result, then stitch; an earlier run is abandoned.

        restitch: stitch even if no field has new heights.
        """
        self.abandon()
        store = self._library.dataset.result(result)
        store.save_recipe(recipe)
        work = self._notices.begin("Heights of the fields", self._cancelled, waits_for="a field with all its frames")
        self._run = ReconstructionRun(
            self._library.dataset.path, result, recipe, work, completion=completion, restitch=restitch
        )
        self._settle(self._run)
        self.add(fields)

    def add(self, fields: Iterable[int]) -> None:
        """Add scanned fields."""
        if (run := self._run) is None:
            return
        fields = list(fields)
        run.complete.update(fields)
        for number in run.made_live.intersection(fields):
            self._library.set_state(number, FieldState.MEASURED)
        new = [n for n in fields if n not in run.waiting and n not in run.busy | run.made_live]
        run.waiting.extend(new)
        run.total += len(new)
        self.go_on()

    def coming(self, number: int) -> None:
        """Start to reconstruct a field while it is being scanned, if a worker is free."""
        run = self._run
        if run is None or not self._warm or run.settling or run.waiting or number in run.live | run.complete:
            return
        if len(run.busy) >= self._room or not self._library.dataset.scan.plan.field_by_field:
            return
        run.live.add(number)
        run.busy.add(number)
        run.total += 1
        done = self.compute.run(run.live_work(number), reconstruct_live, run.path, number, run.result)
        done.add_done_callback(partial(self._later, self._live_done, run, number))

    def no_more_frames(self) -> None:
        """Stop waiting for frames after the end of a scan."""
        if (run := self._run) is not None:
            for number in run.live & run.busy - run.complete:
                self.compute.cancel(run.live_work(number))

    def go_on(self) -> None:
        """Assign fields to free workers; when none is left and no scan runs, stitch."""
        run = self._run
        if run is None or not self._warm:
            return
        while run.waiting and len(run.busy) < (1 if run.settling else self._room):
            self._start(run, run.waiting.popleft())
        if run.stitching:
            return
        if run.idle and not self._command_queue.now.scanning:
            self._finish(run)
        elif run.restitch and time.monotonic() >= run.grows_again_at:
            self._stitch(run, run.growing_work, final=False)

    def abandon(self) -> None:
        """Drop the queued fields; results of running tasks are no longer shown."""
        if (run := self._run) is not None:
            self._end(run, ComputeError("The reconstruction was given up for another one."))

    def describe(self) -> None:
        """Compute the summary of an existing mosaic that has none."""
        run = (self._library.dataset.path, self._library.result_name)
        done = self.compute.run("describe", describe_mosaic, *run)
        done.add_done_callback(lambda info: self._command_queue.note(self._described, run, info))

    @property
    def _room(self) -> int:
        return max(1, self._n_workers - 1) if self._command_queue.now.scanning else self._n_workers

    def _start(self, run: ReconstructionRun, number: int) -> None:
        run.busy.add(number)
        self._library.set_state(number, FieldState.RECONSTRUCTING)
        done = self.compute.run(
            f"{run.work}-field-{number}", reconstruct_field, run.path, number, run.result, run.recipe
        )
        done.add_done_callback(partial(self._later, self._field_done, run, number))

    def _settle(self, run: ReconstructionRun) -> None:
        """Note whether `auto` is resolved; a damaged file of that is reported by the field that reads it."""
        if run.settling:
            with suppress(DatasetError):
                run.settled = self._library.dataset.result(run.result).settled() is not None

    def _live_done(self, run: ReconstructionRun, number: int, done: Future[bool]) -> None:
        """Take over a live reconstruction; without heights, the field is queued normally once it has all its frames."""
        if done.exception() is None and done.result():
            run.made_live.add(number)
            self._field_done(run, number, done)
            return
        run.busy.discard(number)
        run.total -= 1
        if run is self._run:
            self.add(run.complete & {number})

    def _field_done(self, run: ReconstructionRun, number: int, done: Future[Any]) -> None:
        run.busy.discard(number)
        if run is not self._run:
            return
        self._settle(run)
        fault = done.exception()
        if isinstance(fault, ChildDied):
            run.waiting.appendleft(number)  # the same field resolves `auto` for the others as without the interruption
        elif fault is not None:
            self._library.set_state(number, FieldState.FAILED)
            self._notices.fault(no_heights(number), str(fault), "surface", where=f"field {number}")
        else:
            self._notices.withdraw(no_heights(number))
            self._library.set_state(number, FieldState.MEASURED)
            run.restitch = True
        self._notices.progress(run.work, (run.total - len(run.waiting) - len(run.busy)) / max(1, run.total))
        self.go_on()

    def _finish(self, run: ReconstructionRun) -> None:
        """Stitch all available fields at the end of a run."""
        if not (run.restitch or run.grown):
            self._end(run, None)
            self._completed()
            return
        self._notices.end(run.work)
        run.work = self._notices.begin("Stitching the fields", self._cancelled)
        self._stitch(run, run.work, final=True)

    def _stitch(self, run: ReconstructionRun, work: str, *, final: bool) -> None:
        run.restitch, run.stitching = False, True
        done = self.compute.lead(work, bring_up_to_date, run.path, run.result, run.recipe, final)
        done.add_done_callback(partial(self._later, self._stitched, run, final, time.monotonic()))

    def _stitched(self, run: ReconstructionRun, final: bool, begun_at: float, done: Future[SurfaceInfo]) -> None:
        """Take over a mosaic; one of a growing surface is completed later, and its errors are reported then."""
        run.stitching = False
        if run is not self._run:
            return
        fault = done.exception()
        if fault is None:
            self._library.show_surface(done.result())
        if final and not isinstance(fault, ChildDied):
            if fault is not None:
                self._notices.fault("The fields were not stitched", str(fault), "surface")
            self._end(run, fault)
            self._completed()
            return
        run.grown = True
        run.restitch |= fault is not None
        run.grows_again_at = time.monotonic() + GROWING_PAUSES * (time.monotonic() - begun_at)
        self.go_on()

    def _described(self, run: tuple[Path, str], done: Future[SurfaceInfo]) -> None:
        shown = self._command_queue.now.dataset
        if shown is None or (shown.path, self._library.result_name) != run:
            return
        if (fault := done.exception()) is not None:
            self._notices.fault("The stitched surface cannot be read", str(fault), "open")
        else:
            self._library.show_surface(done.result())

    def _cancelled(self) -> None:
        """Cancel the reconstruction on request of a person."""
        run = self._run
        if run is None:
            return
        self._library.reread_states()
        self._end(run, ComputeError("The reconstruction was stopped; the fields that were done are kept."))

    def _end(self, run: ReconstructionRun, fault: BaseException | None) -> None:
        self._notices.end(run.work)
        self._run = None
        if run.stitching:
            self.compute.cancel(run.work)
            self.compute.cancel(run.growing_work)
        if run.completion is not None:
            run.completion.set_result(None) if fault is None else run.completion.set_exception(fault)

    def _heard(self, event: Any) -> None:
        self._command_queue.note(self._on[type(event)], event)

    def _later(self, then: Callable[..., None], *args: Any) -> None:
        self._command_queue.note(then, *args)

    def _up(self, event: ComputeUp) -> None:
        self._n_workers = event.n_workers

    def _warmed(self, _: ComputeWarm) -> None:
        self._warm = True
        self._command_queue.change(compute_ready=True)
        self.go_on()

    def _absent(self, event: ComputeAbsent) -> None:
        self._failure_reported = True
        self._notices.fault("Nothing can be reconstructed", event.why, "surface")

    def _gone(self, exit_code: int | None) -> None:
        self._command_queue.note(self._died, exit_code)

    def _died(self, exit_code: int | None) -> None:
        """Restart the compute host after an unexpected end, a limited number of times."""
        if self._failure_reported:
            return
        self._warm = False
        self._command_queue.change(compute_ready=False)
        self._restarts += 1
        mended = self._restarts <= RESTARTS
        text = f"The process that hosts the workers ended (exit code {exit_code})."
        mend = "A new one takes over. Nothing to do." if mended else "Restart the viewer."
        self._notices.fault("Compute was interrupted", f"{text} {mend}", "surface", needs_person=not mended)
        if mended:
            self.compute.start()
