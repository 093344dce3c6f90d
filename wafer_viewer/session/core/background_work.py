"""Notifications for the operator, and background tasks with progress and a cancel button."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from itertools import count
from typing import Any, Generic, Literal

from wafer_viewer.compute.compute_client import Compute
from wafer_viewer.compute.messages import Answer, Args, LedTask, WatchedTask
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.commands import command
from wafer_viewer.session.state.snapshot import Fault, Work

Source = Literal["plan", "scan", "import", "open", "surface", "measure", "export", "rig", "other"]
Ended = Callable[[Future[Answer]], None]
KEPT = 50
"""Maximum number of faults in the list; the oldest are dropped."""

KNOWN_AFTER_S, KNOWN_AFTER = 2.0, 0.05
"""Elapsed seconds and completed fraction from which the remaining time of a work item is estimated."""


class Notifications:
    """Controller of the snapshot's faults and work items; use all but the commands on the session's thread only."""

    def __init__(self, command_queue: CommandQueue, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._command_queue, self._clock_s = command_queue, clock_s
        self._begun: dict[str, tuple[float, float]] = {}
        self._numbers = count(1)
        self._stops: dict[str, Callable[[], None]] = {}

    def fault(self, title: str, text: str, source: Source, *, where: str = "", needs_person: bool = True) -> None:
        """Add a fault to the list; an identical earlier one is replaced."""
        others = [f for f in self._command_queue.now.faults if (f.title, f.text, f.where) != (title, text, where)]
        fault = Fault(f"fault-{next(self._numbers)}", title, text, _clock(), where, needs_person, source)
        self._command_queue.change(faults=(*others, fault)[-KEPT:])

    def withdraw(self, title: str) -> None:
        """Remove the faults with a title, whose cause is gone."""
        self._command_queue.change(faults=tuple(f for f in self._command_queue.now.faults if f.title != title))

    @command
    def dismiss(self, fault_id: str) -> None:
        """Remove a fault from the list."""
        self._command_queue.change(faults=tuple(f for f in self._command_queue.now.faults if f.id != fault_id))

    def begin(self, title: str, stop: Callable[[], None] | None = None, waits_for: str = "") -> str:
        """Add a work item and return its id.

        `stop` is called when a person cancels it. `waits_for` is shown until it makes progress.
        """
        work = Work(f"work-{next(self._numbers)}", title, cancellable=stop is not None, waits_for=waits_for)
        if stop is not None:
            self._stops[work.id] = stop
        self._command_queue.change(works=(*self._command_queue.now.works, work))
        return work.id

    def progress(self, work_id: str, fraction: float) -> None:
        """Set the progress of a work item."""
        begun_at_s, begun = self._begun.setdefault(work_id, (self._clock_s(), fraction))
        left_s = seconds_left(self._clock_s() - begun_at_s, begun, fraction)
        self._amend(work_id, fraction=fraction, seconds_left=left_s)

    def end(self, work_id: str) -> None:
        """Remove a finished or failed work item."""
        self._stops.pop(work_id, None)
        self._begun.pop(work_id, None)
        self._command_queue.change(works=tuple(w for w in self._command_queue.now.works if w.id != work_id))

    @command
    def cancel(self, work_id: str) -> None:
        """Cancel a work item; one that is over is ignored."""
        if (stop := self._stops.pop(work_id, None)) is not None:
            self._amend(work_id, cancellable=False, stopping=True)
            stop()

    def _amend(self, work_id: str, **changes: Any) -> None:
        works = self._command_queue.now.works
        if any(w.id == work_id for w in works):
            self._command_queue.change(works=tuple(replace(w, **changes) if w.id == work_id else w for w in works))


def seconds_left(gone_s: float, begun: float, now: float) -> float | None:
    """Return the remaining seconds of work that advanced from `begun` to `now`; None while that is too uncertain."""
    if gone_s < KNOWN_AFTER_S or now - begun < KNOWN_AFTER:
        return None
    return gone_s * (1.0 - now) / (now - begun)


def _clock() -> str:
    return time.strftime("%H:%M:%S")


def _ignore(_: Future[Any]) -> None: ...


@dataclass(frozen=True, slots=True)
class RunningWork(Generic[Answer]):
    """Work item of the snapshot, and its outcome."""

    id: str
    done: Future[Answer]


class BackgroundWork:
    """Runner of titled tasks that a person can cancel. Use on the session's thread only.

    `ended` is called with the outcome when the work item is removed; `RunningWork.done` is done after that.
    """

    def __init__(self, command_queue: CommandQueue, notices: Notifications, compute: Compute) -> None:
        self._command_queue, self._notices, self._compute = command_queue, notices, compute

    def run(
        self,
        title: str,
        task: WatchedTask[*Args, Answer],
        *args: *Args,
        ended: Ended[Answer] = _ignore,
    ) -> RunningWork[Answer]:
        """Run a task on a worker."""
        return self._begin(title, lambda work: self._compute.run(work, task, *args), ended)

    def lead(
        self, title: str, task: LedTask[*Args, Answer], *args: *Args, ended: Ended[Answer] = _ignore
    ) -> RunningWork[Answer]:
        """Run a task that submits many tasks to the workers."""
        return self._begin(title, lambda work: self._compute.lead(work, task, *args), ended)

    def cancel(self, work_id: str) -> None:
        """Cancel a running task; one that is over is ignored."""
        self._notices.cancel.run(work_id)

    def _begin(self, title: str, submit: Callable[[str], Future[Answer]], ended: Ended[Answer]) -> RunningWork[Answer]:
        work = ""
        work = self._notices.begin(title, lambda: self._compute.cancel(work))
        done = submit(work)

        def over() -> None:
            self._notices.end(work)
            ended(done)

        return RunningWork(work, self._command_queue.afterwards(done, over))
