"""Environment of the workers of a local cluster, and the process that they are forks of. Imports nothing heavy."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Generator
from contextlib import contextmanager
from multiprocessing import forkserver

FORKS = sys.platform == "linux"
"""Whether a process that has loaded libraries can be forked; those of macOS do not allow it."""
WORKER_ENVIRONMENT = {
    "OMP_NUM_THREADS": 1,
    "MKL_NUM_THREADS": 1,
    "OPENBLAS_NUM_THREADS": 1,
    # By default dask returns freed arrays to the system at once; allocating them again costs more than most tasks.
    "MALLOC_TRIM_THRESHOLD_": 256 * 2**20,
    "MALLOC_MMAP_THRESHOLD_": 32 * 2**20,
    "PYTHONHASHSEED": 6640,  # dask's own: sets have one order on all workers
}


def start_fork_server(loaded: str) -> None:
    """Start a process that imports a module; the forks of this process are forks of that one from now on.

    Only for a process that exists for its workers: whatever else it forks has their environment.
    """
    with worker_environment(), block_sigint():
        os.environ.update({name: str(value) for name, value in WORKER_ENVIRONMENT.items()})
        forkserver.set_forkserver_preload([loaded])
        forkserver.ensure_running()


@contextmanager
def worker_environment() -> Generator[None]:
    """Let dask start workers with `WORKER_ENVIRONMENT`, and restore this process's own environment afterwards.

    dask prefers what this process's environment says, which may come from another cluster in it: dask writes the
    variables of workers to the environment of the process that starts them, and leaves them there.
    """
    before = {name: os.environ.pop(name, None) for name in WORKER_ENVIRONMENT}
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value


@contextmanager
def block_sigint() -> Generator[None]:
    """Block SIGINT in processes started meanwhile, so that Ctrl-C in a terminal reaches only this process, afterwards.

    Threads started meanwhile pass the blocked signal on to every process that they start later.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
