"""Who does the work of a job that consists of many small tasks: this process, or the workers of a dask cluster.

A task is a plain function whose arguments name a dataset; it opens that itself, writes its own file and can be done
twice. So a worker that dies costs time only, and pixels never travel through the scheduler.
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
    why_other,
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
"""Tasks a worker: one that it does, the others so that it need not wait, and few enough for the scheduler."""
LOOK_EVERY_S = 0.1
COUNT_EVERY_S = 1.0
NO_WORKER_PATIENCE_S = 120.0
LAST_TASKS_PATIENCE_S = 30.0


@dataclass(frozen=True, slots=True)
class Done:
    """What item `index` came to: what the task returned, or the fault that it met."""

    index: int
    value: Any = None
    fault: WaferViewerError | None = None


class TaskRunner(Protocol):
    """Hands that take tasks."""

    @property
    def n_hands(self) -> int:
        """How many tasks are done at a time, now."""
        ...

    @property
    def threads_each(self) -> int | None:
        """The threads that a task may use itself; None for all cores."""
        ...

    def require_sight(self, dataset: Path) -> None:
        """Raises ComputeError naming the machine where a worker does not see a dataset, or runs another version."""
        ...

    def each(self, task: Task, items: Sequence[Item], *, should_stop: ShouldStop = ...) -> Generator[Done]:
        """Do ``task(*item)`` for every item; yields in order of completion.

        A task that raises a WaferViewerError, or ends its worker again and again, is Done with that fault and does not
        end the others. Raises ComputeError when the work is to stop or nobody is left to do it: what is not begun is
        given up, what is being done is waited for.
        """
        ...


class LocalRunner:
    """Hands in this process: one task at a time, which may use all cores, or a few threads with a task each."""

    def __init__(self, threads: int = 1) -> None:
        self.n_hands = threads
        self.threads_each = None if threads == 1 else 1

    def require_sight(self, dataset: Path) -> None:
        """This process sees what it sees."""

    def each(self, task: Task, items: Sequence[Item], *, should_stop: ShouldStop = lambda: False) -> Generator[Done]:
        """See `TaskRunner`. An error that is no WaferViewerError is raised."""
        if self.n_hands == 1:
            for index, item in enumerate(items):
                _require_going(should_stop, index, len(items))
                yield Done(index, *attempt(task, item))
            return
        with ThreadPoolExecutor(self.n_hands) as pool:
            flight = _Flight(lambda index: pool.submit(attempt, task, items[index]), lambda: self.n_hands)
            for index, future in flight.results(range(len(items)), should_stop, _cancel_each):
                yield Done(index, *future.result())


class DaskRunner:
    """The workers of a dask.distributed cluster. They may die, join and leave meanwhile.

    client: synchronous; several threads may share it.
    """

    threads_each = 1

    def __init__(self, client: Client) -> None:
        self._client = client
        self._n_hands, self._counted_at = 0, float("-inf")
        self._seen_at = time.monotonic()
        self._wanted: WorkerFingerprint | None = None

    @property
    def n_hands(self) -> int:
        """Threads of the workers that take tasks. Raises ComputeError when there were none for long."""
        now = time.monotonic()
        if now - self._counted_at >= COUNT_EVERY_S:
            self._n_hands, self._counted_at = self._count(), now
        if self._n_hands:
            self._seen_at = now
        elif now - self._seen_at > NO_WORKER_PATIENCE_S:
            raise ComputeError(
                f"The cluster has had no worker for {NO_WORKER_PATIENCE_S:.0f} s: start one and try again; "
                "what was done is kept."
            )
        return self._n_hands

    def require_sight(self, dataset: Path) -> None:
        """See `TaskRunner`. A worker that joins later and is unfit takes no tasks and says why on its own terminal."""
        wanted = WorkerFingerprint.of(dataset.absolute())
        self._require_well(why_unfit, wanted)
        self._wanted = wanted

    def require_same_program(self) -> None:
        """Raises ComputeError naming a machine whose worker runs another version."""
        self._require_well(why_other, __version__, source_mark())

    def each(self, task: Task, items: Sequence[Item], *, should_stop: ShouldStop = lambda: False) -> Generator[Done]:
        """See `TaskRunner`. A task that fails in a way nobody foresaw is Done with a fault as well."""
        job, suspects = uuid4().hex[:12], list[int]()
        self._seen_at = time.monotonic()
        with closing(self._outcomes(f"{job}-first", task, items, range(len(items)), should_stop)) as outcomes:
            for done in outcomes:
                if isinstance(done.fault, WorkerEnded):
                    suspects.append(done.index)
                else:
                    yield done
        # Whatever a worker had in hand when it ended is suspected alike: the innocent are told by going alone.
        for index in suspects:
            yield from self._outcomes(f"{job}-alone", task, items, (index,), should_stop)

    def _outcomes(
        self, job: str, task: Task, items: Sequence[Item], indices: Iterable[int], should_stop: ShouldStop
    ) -> Generator[Done]:
        def submit(index: int) -> Any:
            key = f"{task.__name__}-{job}-{index}"
            return self._client.submit(attempt_if_fit, self._wanted, task, items[index], key=key, pure=False)

        flight = _Flight(submit, lambda: IN_FLIGHT * self.n_hands)
        for index, future in flight.results(indices, should_stop, partial(self._give_up, job)):
            yield _outcome(f"{task.__name__} of item {index + 1} of {len(items)}", index, future)

    def _count(self) -> int:
        try:
            workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
        except (OSError, KeyError) as fault:  # a client that is being closed knows of no workers
            raise _gone() from fault
        return sum(worker["nthreads"] for worker in workers if worker["status"] == "running")

    def _give_up(self, job: str, futures: Iterable[Any]) -> None:
        """Take back what is not begun and wait for what is being done, so that nothing is written afterwards."""
        from distributed import CancelledError

        try:
            self._client.cancel(list(futures), force=True)
            until = time.monotonic() + LAST_TASKS_PATIENCE_S
            while True in self._told_by_all(works_on, job) and time.monotonic() < until:
                time.sleep(LOOK_EVERY_S)
        except (OSError, CancelledError, RuntimeError):  # the cluster is gone, and with it what it did
            return

    def _require_well(self, why_not: Callable[..., str], *args: Any) -> None:
        for why in self._told_by_all(why_not, *args):
            if isinstance(why, Exception):
                raise ComputeError(f"A worker cannot say whether it fits ({why}): install the same version there.")
            if why:
                raise ComputeError(why)

    def _told_by_all(self, ask: Task, *args: Any) -> list[Any]:
        """What every worker answers; its exception where it cannot."""
        answers: Any = self._client.run(ask, *args, on_error="return")
        return list(answers.values())


def n_local_workers() -> int:
    """One worker a processor, two at least, so that one that is busy or was killed does not stop the others."""
    return min(8, max(2, (os.cpu_count() or 2) - 1))


def require_tls(scheduler: str | None) -> None:
    """Raises ComputeError where the address of a scheduler is of another kind than tls://HOST:PORT."""
    if scheduler is not None and not scheduler.startswith("tls://"):
        raise ComputeError(
            f"The scheduler's address is {scheduler}: it must begin with tls://, because any program could run code "
            "through an open one."
        )


class WorkerEnded(ComputeError):
    """A task that ended its worker more often than is allowed."""


class _Flight:
    """A bounded number of tasks that are submitted and not yet back, refilled as they come."""

    def __init__(self, submit: Callable[[int], Any], limit: Callable[[], int]) -> None:
        self._submit, self._limit = submit, limit
        self._busy: dict[int, Any] = {}
        self._back: SimpleQueue[int] = SimpleQueue()

    def results(
        self, indices: Iterable[int], should_stop: ShouldStop, give_up: Callable[[Iterable[Any]], None]
    ) -> Iterator[tuple[int, Any]]:
        """Index and future in order of completion. Raises ComputeError when the work is to stop."""
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
    """What a future of the cluster came to. Raises ComputeError when the cluster is gone."""
    from distributed import CancelledError, KilledWorker

    fault = future.exception()
    if fault is None:
        return Done(index, *future.result())
    if isinstance(fault, CancelledError):
        raise _gone()
    if isinstance(fault, KilledWorker):
        times = fault.allowed_failures + 1
        return Done(index, fault=WorkerEnded(f"{what} ended its worker {times} times: it may need more memory."))
    return Done(index, fault=ComputeError(f"{what} failed: {type(fault).__name__}: {fault}."))


def _gone() -> ComputeError:
    return ComputeError("The work was given up, because the compute cluster ended; what was done is kept.")


def _cancel_each(futures: Iterable[Any]) -> None:
    for future in futures:
        future.cancel()


def _require_going(should_stop: ShouldStop, done: int, total: int) -> None:
    if should_stop():
        raise ComputeError(f"The work was stopped at {done} of {total}; what was done is kept.")
