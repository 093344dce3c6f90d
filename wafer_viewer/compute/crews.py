"""Choice of a task runner: this process, a local cluster, or one that is running."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager

from wafer_viewer.compute.task_runner import DaskRunner, LocalRunner, TaskRunner, require_tls


@contextmanager
def crew_for(scheduler: str | None = None, workers: int = 1) -> Generator[TaskRunner]:
    """Yield a runner in this process for one worker without a scheduler, else one on a running or local cluster.

    scheduler: tls://HOST:PORT of a running cluster. Raises ComputeError if it is not available.
    """
    if scheduler is None and workers == 1:
        yield LocalRunner()
        return
    require_tls(scheduler)
    from wafer_viewer.compute.dask_cluster import client_of

    with client_of(scheduler, workers) as client:
        yield DaskRunner(client)
