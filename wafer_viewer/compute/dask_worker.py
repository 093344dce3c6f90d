"""Worker side of a cluster: setup, compatibility with a dataset, and task execution.

dask loads this module into every scheduler, worker and nanny, and calls `dask_setup`.
"""

from __future__ import annotations

import functools
import hashlib
import logging
import signal
import socket
import zlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wafer_viewer._version import __version__
from wafer_viewer.model.errors import WaferViewerError

if TYPE_CHECKING:
    from distributed import Nanny, Scheduler, Worker

RECORD = "scan.json"
Outcome = tuple[Any, WaferViewerError | None]
_FIT_FOR: set[WorkerFingerprint] = set()
"""Fingerprints that this worker has verified; reading the record of many fields takes long."""


@dataclass(frozen=True, slots=True)
class WorkerFingerprint:
    """Fingerprint of a machine: program version, hash of its sources, and hash of a dataset's record, "" if missing."""

    version: str
    sources: str
    dataset: Path
    record: str

    @classmethod
    def of(cls, dataset: Path) -> WorkerFingerprint:
        """Return the fingerprint of this machine for a dataset."""
        record = ""
        with suppress(OSError):
            record = hashlib.sha256((dataset / RECORD).read_bytes()).hexdigest()
        return cls(__version__, source_mark(), dataset, record)


def why_unfit(wanted: WorkerFingerprint) -> str:
    """Return a sentence on why this machine does not match the fingerprint `wanted`; "" if it does."""
    host = socket.gethostname()
    if why := version_mismatch(wanted.version, wanted.sources):
        return why
    if not (seen := WorkerFingerprint.of(wanted.dataset)).record:
        return f"The worker on {host} does not see {wanted.dataset}: mount the shared folder there under the same path."
    if seen.record != wanted.record:
        return f"The worker on {host} sees another dataset at {wanted.dataset}: mount the same folder on both machines."
    return ""


def version_mismatch(version: str, sources: str) -> str:
    """Return a sentence on how this machine's program differs in version or sources; "" if it does not."""
    if (__version__, source_mark()) == (version, sources):
        return ""
    return (
        f"The worker on {socket.gethostname()} runs wafer-viewer {__version__} ({source_mark()}) and this machine "
        f"{version} ({sources}): install the same on both."
    )


@functools.cache
def source_mark() -> str:
    """Return a CRC-32 of the package's sources as eight hex digits."""
    package = Path(__file__).parent.parent
    files = sorted(package.rglob("*.py"))
    return f"{functools.reduce(lambda crc, file: zlib.crc32(file.read_bytes(), crc), files, 0):08x}"


def attempt(task: Callable[..., Any], item: tuple[Any, ...]) -> Outcome:
    """Run a task and return its value and None, or None and the WaferViewerError that it raised."""
    try:
        return task(*item), None
    except WaferViewerError as fault:
        return None, fault


def attempt_if_fit(wanted: WorkerFingerprint | None, task: Callable[..., Any], item: tuple[Any, ...]) -> Outcome:
    """Run `attempt` on a worker; an unfit worker pauses itself and reschedules the task."""
    if wanted is not None and wanted not in _FIT_FOR:
        if why := why_unfit(wanted):
            _step_aside(why)
        _FIT_FOR.add(wanted)
    return attempt(task, item)


def works_on(job: str, dask_worker: Worker) -> bool:
    """Return whether a worker is executing a task of a job."""
    return any(job in str(task.key) for task in dask_worker.state.executing)


def dask_setup(server: Scheduler | Worker | Nanny) -> None:
    """Set up a process of a cluster; dask calls this at its start."""
    from distributed import Nanny, Worker

    if isinstance(server, Nanny):
        _count_own_memory_only(server)
        return
    _end_http(server)
    if isinstance(server, Worker):
        # Ctrl-C in a terminal reaches all its processes: a worker leaves it to the one that started it.
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _end_http(server: Scheduler | Worker) -> None:
    """Close the port of the dashboard, which has no TLS; dask opens it whether there are pages or not."""
    server.services.pop("dashboard", None)
    server.http_server.stop()


def _count_own_memory_only(nanny: Nanny) -> None:
    """Make the memory limit count only the memory that a worker owns.

    Stacks and surfaces are memory-mapped: they are part of the resident memory, but the system can drop them any time.
    """
    from tornado.ioloop import PeriodicCallback

    manager = nanny.memory_manager
    if not manager.memory_limit or not manager.memory_terminate_fraction:
        return
    limit_bytes = manager.memory_limit * manager.memory_terminate_fraction

    def look() -> None:
        process = nanny.process and nanny.process.process
        if process and process.pid and own_bytes(process.pid) > limit_bytes:
            manager.memory_monitor(nanny)

    every_ms = 1000 * float(manager.memory_monitor_interval or 0.1)
    nanny.periodic_callbacks["memory_monitor"] = PeriodicCallback(look, every_ms)


def own_bytes(pid: int) -> int:
    """Return the memory of a process without mapped files; 0 if it has ended."""
    import psutil

    try:
        memory = psutil.Process(pid).memory_info()
    except psutil.Error:
        return 0
    return memory.rss - getattr(memory, "shared", 0)


def _step_aside(why: str) -> None:
    from distributed import Reschedule, get_worker
    from distributed.core import Status

    worker = get_worker()
    logging.getLogger("distributed.worker").error("%s It takes no more tasks.", why)
    worker.loop.add_callback(setattr, worker, "status", Status.paused)
    raise Reschedule
