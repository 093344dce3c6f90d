"""Client of the compute host: starts the host on demand and sends it tasks."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from multiprocessing.connection import Connection
from typing import Any

from wafer_viewer.compute.child_process import ChildConnection, ChildProcess, run_in_background
from wafer_viewer.compute.messages import Answer, Args, Cancel, LedTask, RunLedTask, RunTask, WarmUp, WatchedTask
from wafer_viewer.compute.task_runner import require_tls
from wafer_viewer.compute.worker_environment import FORKS, start_fork_server

NICENESS = 5


class Compute:
    """Client that runs tasks in worker processes; imports nothing heavy. Use it from one thread.

    scheduler: the address of a cluster that runs already, tls://HOST:PORT. Raises ComputeError for another kind.
    warm_up: what is compiled, and what workers load, before their first tasks.
    """

    def __init__(
        self,
        scheduler: str | None,
        warm_up: WarmUp,
        on_event: Callable[[Any], None],
        on_exit: Callable[[int | None], None],
    ) -> None:
        require_tls(scheduler)
        self._host_args = scheduler, warm_up
        self._on_event, self._on_exit = on_event, on_exit
        self._link: ChildProcess | None = None

    def start(self) -> ChildProcess:
        """Return the connection to a running host; start one if needed."""
        if self._link is None or not self._link.alive:
            self._link = ChildProcess("wafer-viewer compute", _host, self._host_args, self._on_event, self._on_exit)
        return self._link

    def run(self, work: str, task: WatchedTask[*Args, Answer], *args: *Args) -> Future[Answer]:
        """Run ``task(*args, progress=…, should_stop=…)`` on a worker; its errors are raised by the future."""
        return self.start().ask(RunTask(work, task, args))

    def lead(self, work: str, task: LedTask[*Args, Answer], *args: *Args) -> Future[Answer]:
        """Run ``task(*args, crew=…, progress=…, should_stop=…)`` in the host; it may submit many tasks to the crew."""
        return self.start().ask(RunLedTask(work, task, args))

    def cancel(self, work: str) -> None:
        """Request the tasks of a work to stop."""
        self.start().ask(Cancel(work))

    def close(self) -> None:
        """End the host and its workers."""
        if self._link is not None:
            self._link.close()


def _host(pipe: Connection, scheduler: str | None, warm_up: WarmUp) -> None:
    run_in_background(NICENESS)
    end = ChildConnection(pipe)
    if scheduler is None:
        warm_up.compile(end.is_closed)
    if end.is_closed():
        return
    loaded = warm_up.loaded if FORKS and scheduler is None else None
    if loaded is not None:
        start_fork_server(loaded)  # it loads while this process imports dask
    from wafer_viewer.compute.compute_host import run_compute

    run_compute(end, scheduler, warm_up, forked=loaded is not None)
