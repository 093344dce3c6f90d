"""dask.distributed cluster for heavy computation: a local one, or one that is running already.

A local cluster uses TLS with certificates made at its start, so that no other program of this machine can run code in
it. With a running cluster both ends present the certificates that `wafer-viewer cluster` made.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import dask.config
from distributed import Client, LocalCluster, Security

from wafer_viewer.compute.task_runner import DaskRunner
from wafer_viewer.compute.worker_environment import WORKER_ENVIRONMENT, block_sigint, worker_environment
from wafer_viewer.model.errors import ComputeError

WORKER_MEMORY = "3GiB"
PATIENCE_S = 20.0
SETTINGS: dict[str, Any] = {
    # Workers return small results only: there is nothing to spill, and a paused worker would never resume.
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": 0.95,
    "distributed.nanny.pre-spawn-environ": WORKER_ENVIRONMENT,
    "distributed.nanny.preload": ["wafer_viewer.compute.dask_worker"],
    "distributed.worker.preload": ["wafer_viewer.compute.dask_worker"],
    "distributed.scheduler.preload": ["wafer_viewer.compute.dask_worker"],
    "distributed.comm.timeouts.connect": PATIENCE_S,
    "distributed.scheduler.allowed-failures": 3,
    # dask closes a worker that was lost, 15 s later, also when it is back: it looks for it in a list that is empty now.
    "distributed.deploy.lost-worker-timeout": "1 day",
    "distributed.admin.tick.limit": "1 hour",
    # The statistics of dask are not used, and collecting them costs the workers some percent of their time.
    "distributed.admin.tick.interval": "500ms",
    "distributed.worker.profile.enabled": False,
    "distributed.scheduler.active-memory-manager.start": False,
    # The dashboard of dask is off: it would be open to every program on this machine. dask_worker closes its port too.
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}
_TLS = "distributed.comm.tls"


@contextmanager
def client_of(scheduler: str | None, workers: int, forked: bool = False) -> Generator[Client]:
    """Connect to the cluster at an address, or to a new local one with some workers, which ends with the client.

    forked: local workers are forks of the process that `start_fork_server` started, instead of beginning with nothing.

    Raises ComputeError if certificates are missing or rejected, or if no worker answers.
    """
    method = {"distributed.worker.multiprocessing-method": "forkserver" if forked else "spawn"}
    with dask.config.set(SETTINGS | method), _quiet(), _joined(scheduler) if scheduler else _own(workers) as client:
        yield client


@contextmanager
def _own(workers: int) -> Generator[Client]:
    with worker_environment():
        with _where("this machine"), block_sigint():
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                host="127.0.0.1",
                protocol="tls://",
                security=Security.temporary(),
                memory_limit=WORKER_MEMORY,
                dashboard_address="127.0.0.1:0",
                worker_dashboard_address=None,
                silence_logs=logging.CRITICAL,
            )
        with cluster, Client(cluster) as client:
            yield client


@contextmanager
def _joined(scheduler: str) -> Generator[Client]:
    """Connect to a running cluster; its certificates come from dask's configuration."""
    with _where(scheduler):
        client = Client(scheduler, security=_security(), timeout=PATIENCE_S)
    with client:
        with _where(scheduler):
            client.wait_for_workers(1, timeout=PATIENCE_S)
        DaskRunner(client).require_same_program()
        yield client


def _security() -> Security:
    """Return the TLS settings of dask's configuration; certificate names are relative to its folder.

    Raises ValueError if certificates are not configured or missing.
    """
    files = {kind: dask.config.get(f"{_TLS}.{kind}") for kind in ("ca-file", "client.cert", "client.key")}
    if not (files["ca-file"] and files["client.cert"]):
        raise ValueError(
            "dask's configuration names no certificates: set DASK_CONFIG to a folder that `wafer-viewer cluster` made"
        )
    folder = Path(os.environ.get("DASK_CONFIG", "."))
    folder = folder if folder.is_dir() else folder.parent
    found = {kind: str(folder / name) for kind, name in files.items() if name}
    if missing := [file for file in found.values() if not Path(file).is_file()]:
        raise ValueError(f"there is no certificate {missing[0]}")
    return Security(
        require_encryption=True,
        tls_ca_file=found["ca-file"],
        tls_client_cert=found["client.cert"],
        tls_client_key=found.get("client.key"),
    )


@contextmanager
def _where(place: str) -> Generator[None]:
    """Convert dask's errors about an unavailable cluster to a ComputeError with one sentence."""
    try:
        yield
    except (OSError, TimeoutError, ValueError, RuntimeError) as fault:  # RuntimeError: a worker ended while it started
        reason = " ".join(str(fault).split()).rstrip(".")
        raise ComputeError(f"There is no cluster at {place}: {reason}. Try again; what was done is kept.") from fault


@contextmanager
def _quiet() -> Generator[None]:
    """Silence the loggers of distributed; errors are reported by this package."""
    logs = [logging.getLogger(name) for name in logging.root.manager.loggerDict if name.split(".")[0] == "distributed"]
    before = [log.level for log in logs]
    for log in logs:
        log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for log, level in zip(logs, before, strict=True):
            log.setLevel(level)
