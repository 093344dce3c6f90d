"""Task runners for jobs of many small tasks: in this process, or on the workers of a dask cluster.

A task is a plain function whose arguments name a dataset; it opens the dataset, writes its own file and is idempotent.
A worker that dies therefore costs only time, and pixels never pass through the scheduler.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Protocol
from uuid import uuid4

from wafer_viewer._version import __version__
from wafer_viewer.compute.dask_worker import (
    WorkerFingerprint,
    attempt,
    attempt_if_fit,
    source_mark,
    version_mismatch,
    why_unfit,
    works_on,
)
from wafer_viewer.model.errors import ComputeError, WaferViewerError
from wafer_viewer.model.progress import ShouldStop

if TYPE_CHECKING:
    from distributed import Client

Task = Callable[..., Any]
Item = tuple[Any, ...]
IN_FLIGHT = 3
"""Submitted tasks per worker: one running, the others queued to avoid idling, few enough for the scheduler."""
LOOK_EVERY_S = 0.1
COUNT_EVERY_S = 1.0
NO_WORKER_PATIENCE_S = 120.0
LAST_TASKS_PATIENCE_S = 30.0


@dataclass(frozen=True, slots=True)
class Done:
    """Outcome of item `index`: the value that the task returned, or its fault."""

    index: int
    value: Any = None
    fault: WaferViewerError | None = None


class TaskRunner(Protocol):
    """Runner of many small tasks."""

    @property
    def n_slots(self) -> int:
        """Number of tasks that can run concurrently at present."""
        ...

    @property
    def threads_each(self) -> int | None:
        """Number of threads that a task may use; None for all cores."""
        ...

    def require_sight(self, dataset: Path) -> None:
        """Raise ComputeError naming the machine if a worker cannot read a dataset or runs another version."""
        ...

    def each(self, task: Task, items: Sequence[Item], *, should_stop: ShouldStop = ...) -> Generator[Done]:
        """Run ``task(*item)`` for every item; yield outcomes in order of completion.

        A task that raises a WaferViewerError, or repeatedly ends its worker, is Done with that fault and does not end
        the others. Raises ComputeError when the work is to stop or no worker is left: tasks that have not started are
        cancelled, running ones are awaited.
        """
        ...


class LocalRunner:
    """Runner in this process: one task at a time on all cores, or several threads with one task each."""

    def __init__(self, threads: int = 1) -> None:
        self.n_slots = threads
        self.threads_each = None if threads == 1 else 1

    def require_sight(self, dataset: Path) -> None:
        """Accept every dataset; no other machine is involved."""

    def each(self, task: Task, items: Sequence[Item], *, should_stop: ShouldStop = lambda: False) -> Generator[Done]:
        """See `TaskRunner`. An error that is no WaferViewerError is raised."""
        if self.n_slots == 1:
            for index, item in enumerate(items):
                _require_going(should_stop, index, len(items))
                yield Done(index, *attempt(task, item))
            return
        with ThreadPoolExecutor(self.n_slots) as pool:
            flight = _Flight(lambda index: pool.submit(attempt, task, items[index]), lambda: self.n_slots)
            for index, future in flight.results(range(len(items)), should_stop, _cancel_each):
                yield Done(index, *future.result())


class DaskRunner:
    """Runner on the workers of a dask.distributed cluster, which may die, join and leave meanwhile.

    client: synchronous; several threads may share it.
    """

    threads_each = 1

    def __init__(self, client: Client) -> None:
        self._client = client
        self._n_slots, self._counted_at = 0, float("-inf")
        self._seen_at = time.monotonic()
        self._wanted: WorkerFingerprint | None = None

    @property
    def n_slots(self) -> int:
        """Number of threads of running workers. Raises ComputeError after `NO_WORKER_PATIENCE_S` without any."""
        now = time.monotonic()
        if now - self._counted_at >= COUNT_EVERY_S:
            self._n_slots, self._counted_at = self._count(), now
        if self._n_slots:
            self._seen_at = now
        elif now - self._seen_at > NO_WORKER_PATIENCE_S:
            raise ComputeError(
                f"The cluster has had no worker for {NO_WORKER_PATIENCE_S:.0f} s: start one and try again; "
                "what was done is kept."
            )
        return self._n_slots

    def require_sight(self, dataset: Path) -> None:
        """See `TaskRunner`. An unfit worker that joins later takes no tasks and logs the reason on its own terminal."""
        wanted = WorkerFingerprint.of(dataset.absolute())
        self._require_well(why_unfit, wanted)
        self._wanted = wanted

    def require_same_program(self) -> None:
        """Raise ComputeError naming a machine whose worker runs another version."""
        self._require_well(version_mismatch, __version__, source_mark())

    def each(self, task: Task, items: Sequence[Item], *, should_stop: ShouldStop = lambda: False) -> Generator[Done]:
        """See `TaskRunner`. A task that fails with an unexpected error is Done with a fault as well."""
        job, suspects = uuid4().hex[:12], list[int]()
        self._seen_at = time.monotonic()
        with closing(self._outcomes(f"{job}-first", task, items, range(len(items)), should_stop)) as outcomes:
            for done in outcomes:
                if isinstance(done.fault, WorkerEnded):
                    suspects.append(done.index)
                else:
                    yield done
        # All tasks of a lost worker are suspects: each runs alone to find the one that crashes it.
        for index in suspects:
            yield from self._outcomes(f"{job}-alone", task, items, (index,), should_stop)

    def _outcomes(
        self, job: str, task: Task, items: Sequence[Item], indices: Iterable[int], should_stop: ShouldStop
    ) -> Generator[Done]:
        def submit(index: int) -> Any:
            key = f"{task.__name__}-{job}-{index}"
            return self._client.submit(attempt_if_fit, self._wanted, task, items[index], key=key, pure=False)

        flight = _Flight(submit, lambda: IN_FLIGHT * self.n_slots)
        for index, future in flight.results(indices, should_stop, partial(self._give_up, job)):
            yield _outcome(f"{task.__name__} of item {index + 1} of {len(items)}", index, future)

    def _count(self) -> int:
        try:
            workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
        except (OSError, KeyError) as fault:  # a closing client lists no workers
            raise _cluster_ended() from fault
        return sum(worker["nthreads"] for worker in workers if worker["status"] == "running")

    def _give_up(self, job: str, futures: Iterable[Any]) -> None:
        """Cancel pending tasks and wait for running ones, so that nothing is written afterwards."""
        from distributed import CancelledError

        try:
            self._client.cancel(list(futures), force=True)
            until = time.monotonic() + LAST_TASKS_PATIENCE_S
            while True in self._ask_all_workers(works_on, job) and time.monotonic() < until:
                time.sleep(LOOK_EVERY_S)
        except (OSError, CancelledError, RuntimeError):  # the cluster ended, and its tasks with it
            return

    def _require_well(self, why_not: Callable[..., str], *args: Any) -> None:
        for why in self._ask_all_workers(why_not, *args):
            if isinstance(why, OSError):  # it ended meanwhile, and takes no tasks
                continue
            if isinstance(why, Exception):
                raise ComputeError(f"A worker cannot say whether it fits ({why}): install the same version there.")
            if why:
                raise ComputeError(why)

    def _ask_all_workers(self, ask: Task, *args: Any) -> list[Any]:
        """Return the answers of all workers; the exception in place of an answer that failed."""
        answers: Any = self._client.run(ask, *args, on_error="return")
        return list(answers.values())


def n_local_workers() -> int:
    """Return the number of local workers: one less than the processors, between 2 and 8.

    With two at least, a busy or killed worker does not stop the work.
    """
    return min(8, max(2, (os.cpu_count() or 2) - 1))


def require_tls(scheduler: str | None) -> None:
    """Raise ComputeError if a scheduler's address does not begin with tls://."""
    if scheduler is not None and not scheduler.startswith("tls://"):
        raise ComputeError(
            f"The scheduler's address is {scheduler}: it must begin with tls://, because any program could run code "
            "through an open one."
        )


class WorkerEnded(ComputeError):
    """A task ended its worker more often than is allowed."""


class _Flight:
    """Bounded set of submitted tasks, refilled as they complete."""

    def __init__(self, submit: Callable[[int], Any], limit: Callable[[], int]) -> None:
        self._submit, self._limit = submit, limit
        self._busy: dict[int, Any] = {}
        self._back: SimpleQueue[int] = SimpleQueue()

    def results(
        self, indices: Iterable[int], should_stop: ShouldStop, give_up: Callable[[Iterable[Any]], None]
    ) -> Iterator[tuple[int, Any]]:
        """Yield index and future in order of completion. Raises ComputeError when the work is to stop."""
        indices = list(indices)
        waiting, n_back = iter(indices), 0
        try:
            while n_back < len(indices):
                _require_going(should_stop, n_back, len(indices))
                self._fill(waiting)
                try:
                    index = self._back.get(timeout=LOOK_EVERY_S)
                except Empty:
                    continue
                n_back += 1
                yield index, self._busy.pop(index)
        finally:
            if self._busy:
                give_up(self._busy.values())

    def _fill(self, waiting: Iterator[int]) -> None:
        for index in islice(waiting, max(0, self._limit() - len(self._busy))):
            self._busy[index] = future = self._submit(index)
            future.add_done_callback(lambda _, index=index: self._back.put(index))


def _outcome(what: str, index: int, future: Any) -> Done:
    """Return the outcome of a future of the cluster. Raises ComputeError if the cluster is gone."""
    from distributed import CancelledError, KilledWorker

    fault = future.exception()
    if fault is None:
        return Done(index, *future.result())
    if isinstance(fault, CancelledError):
        raise _cluster_ended()
    if isinstance(fault, KilledWorker):
        times = fault.allowed_failures + 1
        return Done(index, fault=WorkerEnded(f"{what} ended its worker {times} times: it may need more memory."))
    return Done(index, fault=ComputeError(f"{what} failed: {type(fault).__name__}: {fault}."))


def _cluster_ended() -> ComputeError:
    return ComputeError("The work stopped because the compute cluster ended; what was done is kept.")


def _cancel_each(futures: Iterable[Any]) -> None:
    for future in futures:
        future.cancel()


def _require_going(should_stop: ShouldStop, done: int, total: int) -> None:
    if should_stop():
        raise ComputeError(f"The work was stopped at {done} of {total}; what was done is kept.")
