"""Lock of the operating system on an open file: the end of the process releases it."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.io.atomic_files import make_folder, os_errors_as_dataset_errors

_PAUSE_S = 0.02

if sys.platform == "win32":
    import msvcrt

    def hold(descriptor: int) -> bool:
        """Lock a file until it is closed; return False if another process has it."""
        os.lseek(descriptor, 1 << 20, os.SEEK_SET)  # past the text, which others may read
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True

else:
    import fcntl

    def hold(descriptor: int) -> bool:
        """Lock a file until it is closed; return False if another process has it."""
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return False
        return True


@contextmanager
def locked(path: Path, most_s: float = 10.0) -> Generator[None]:
    """Context manager that holds the lock file at `path`, made if missing.

    Raises DatasetError when another program holds it for `most_s`, or it cannot be made.
    """
    make_folder(path.parent)
    with os_errors_as_dataset_errors(path):
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    try:
        until = time.monotonic() + most_s
        while not hold(descriptor):
            if time.monotonic() > until:
                raise DatasetError(f"{path} is held by another program: wait until it is done, and try again.")
            time.sleep(_PAUSE_S)
        yield
    finally:
        os.close(descriptor)
