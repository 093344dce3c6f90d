"""The task runner for a command: this process, a cluster that runs already, or workers of its own."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager

from wafer_viewer.compute.task_runner import DaskRunner, LocalRunner, TaskRunner, require_tls


@contextmanager
def crew_for(scheduler: str | None = None, workers: int = 1) -> Generator[TaskRunner]:
    """This process, where there is no scheduler and one worker is enough; otherwise a cluster, or one of our own.

    scheduler: tls://HOST:PORT of a cluster that runs already. Raises ComputeError where it cannot be had.
    """
    if scheduler is None and workers == 1:
        yield LocalRunner()
        return
    require_tls(scheduler)
    from wafer_viewer.compute.dask_cluster import client_of  # loads distributed

    with client_of(scheduler, workers) as client:
        yield DaskRunner(client)
