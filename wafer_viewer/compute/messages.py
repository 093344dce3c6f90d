"""Messages between this process and the compute host, and tasks with progress and cancellation."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, TypeVarTuple

from wafer_viewer.model.progress import Progress, ShouldStop

if TYPE_CHECKING:
    from wafer_viewer.compute.task_runner import TaskRunner


@dataclass(frozen=True, slots=True)
class RunTask:
    """Run ``task(*args, progress=…, should_stop=…)`` on a worker. The reply is its return value."""

    work: str
    task: WatchedTask[*tuple[Any, ...], Any]
    args: tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class RunLedTask:
    """Run ``task(*args, crew=…, progress=…, should_stop=…)`` in the host, where it submits many tasks to the crew.

    The reply is its return value.
    """

    work: str
    task: LedTask[*tuple[Any, ...], Any]
    args: tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class Cancel:
    """Request the tasks of a work to stop. The reply comes at once."""

    work: str


@dataclass(frozen=True, slots=True)
class ComputeUp:
    """The workers accept tasks."""

    n_workers: int


@dataclass(frozen=True, slots=True)
class WarmUp:
    """Functions by which kernels are compiled and loaded.

    compile: compiles what the first tasks need, or waits for who does, before local workers start; first: loads, on a
    worker, what the first tasks need; complete: loads all. loaded: module whose import loads them in a process that
    workers can be forks of; None for workers that begin with nothing.
    """

    compile: Callable[[ShouldStop], None]
    first: Callable[[], None]
    complete: Callable[[], None]
    loaded: str | None = None


@dataclass(frozen=True, slots=True)
class ComputeWarm:
    """The kernels of the first tasks are loaded, so that fields can be reconstructed without delay."""


@dataclass(frozen=True, slots=True)
class ComputeAbsent:
    """No cluster is available, for the reason `why`."""

    why: str


@dataclass(frozen=True, slots=True)
class Progressed:
    """Progress of a work, 0 to 1."""

    work: str
    fraction: float


Args = TypeVarTuple("Args")
Answer = TypeVar("Answer", covariant=True)
PROGRESS_TOPIC = "wafer-viewer-progress"
ASK_EVERY_S = 0.25


class WatchedTask(Protocol[*Args, Answer]):
    """Function that a worker runs; it reports its progress, 0 to 1, and stops on request."""

    __name__: str

    def __call__(self, *args: *Args, progress: Progress, should_stop: ShouldStop) -> Answer:
        """Run the task; the return value goes back to the session."""
        ...


class LedTask(Protocol[*Args, Answer]):
    """Function that the compute host runs, which may submit many tasks to the crew."""

    __name__: str

    def __call__(self, *args: *Args, crew: TaskRunner, progress: Progress, should_stop: ShouldStop) -> Answer:
        """Run the task; the return value goes back to the session."""
        ...


def run_watched(work: str, task: WatchedTask[*Args, Answer], args: tuple[*Args]) -> Answer:
    """Run a task on a worker, with its progress reported to the host and cancellation by the host."""
    return task(*args, progress=_teller(work), should_stop=_listener(work))


def stop_sign(work: str) -> str:
    """Return the name of the event that stops the tasks of a work."""
    return f"stop-{work}"


def throttled(report: Progress) -> Progress:
    """Return a progress callback that is throttled to `ASK_EVERY_S`, and always reports the end."""
    reported_at = 0.0

    def report_sometimes(fraction: float) -> None:
        nonlocal reported_at
        if fraction >= 1 or time.monotonic() - reported_at >= ASK_EVERY_S:
            reported_at = time.monotonic()
            report(fraction)

    return report_sometimes


def _teller(work: str) -> Progress:
    from distributed import get_worker

    return throttled(lambda done: get_worker().log_event(PROGRESS_TOPIC, {"work": work, "fraction": float(done)}))


def _listener(work: str) -> ShouldStop:
    from distributed import Event

    checked_at, stop = 0.0, False

    def should_stop() -> bool:
        nonlocal checked_at, stop
        if not stop and time.monotonic() - checked_at >= ASK_EVERY_S:
            checked_at = time.monotonic()
            stop = bool(Event(stop_sign(work)).is_set())
        return stop

    return should_stop
