"""Exclusive write lock of a dataset: one process at a time, named in the file ``lock``.

The lock of the file is authoritative, so a killed process holds nothing, whatever its machine is called now. The text
in the file names the holder; an empty file means that the dataset is free. A holder on another machine is trusted,
because it cannot be checked.
"""

from __future__ import annotations

import datetime
import os
import socket
import time
from contextlib import suppress
from pathlib import Path

import msgspec

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.io.atomic_files import os_errors_as_dataset_errors, remove_dead_parts
from wafer_viewer.store.io.file_lock import FileLock, Process, announced, is_locked, this_process, try_lock

_TRIES, _PAUSE_S = 5, 0.02
"""Number of attempts, and pause in s: `holder_of` locks the file briefly itself, so one refusal is no proof."""

_NOT_OURS = frozenset({"frames"})
"""Folders in which nothing is written aside."""


class Holder(Process, frozen=True, kw_only=True):
    """Process that holds the lock of a dataset."""

    since: str

    @classmethod
    def now(cls) -> Holder:
        """Return this process as the holder from now on."""
        since = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
        return cls(**msgspec.structs.asdict(this_process()), since=since)

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}, since {self.since}"

    @property
    def is_elsewhere(self) -> bool:
        """True if it was on another machine, or on this one before it was started again under another name."""
        return not self.boots_with_us and self.host != socket.gethostname()


class Lock:
    """Acquired lock of a dataset; call `release` to free it."""

    def __init__(self, folder: Path, lock: FileLock) -> None:
        self._folder = folder
        self._lock: FileLock | None = lock

    @classmethod
    def take(cls, folder: Path) -> Lock:
        """Acquire the lock, and remove what killed processes left half written.

        Raises DatasetError naming the holder when another process has it.
        """
        path = folder / "lock"
        lock = _lock_patiently(path)
        holder = _read(path)
        if lock is None or _keeps(holder, lock):
            if lock is not None:
                lock.release()
            raise DatasetError(_refusal(folder, holder, lock is None))
        try:
            with os_errors_as_dataset_errors(path):
                _write(lock, msgspec.json.encode(Holder.now()))
        except DatasetError:
            lock.release()
            raise
        remove_dead_parts(folder, but=_NOT_OURS)
        return cls(folder, lock)

    @property
    def held(self) -> bool:
        """True until the lock is released."""
        return self._lock is not None

    def release(self) -> None:
        """Remove what killed workers left half written, and release the lock; idempotent.

        A disk that does not even take the empty text leaves a name of no meaning.
        """
        if self._lock is not None:
            remove_dead_parts(self._folder, but=_NOT_OURS)
            with suppress(OSError):
                _write(self._lock, b"")
            self._lock.release()
            self._lock = None


def holder_of(folder: Path) -> Holder | None:
    """Return the process that holds the lock, or None when the dataset is free."""
    path = folder / "lock"
    holder = _read(path)
    elsewhere = holder is not None and holder.is_elsewhere
    return holder if elsewhere or is_locked(path) else None


def _keeps(holder: Holder | None, lock: FileLock) -> bool:
    """Return whether the process that is named in a file keeps it though its lock could be had.

    On another machine it cannot be asked. Without locks of the operating system here, it may have one all the same.
    """
    if holder is None:
        return False
    at_work = holder.boots_with_us and not holder.is_gone and holder.pid != os.getpid()
    return holder.is_elsewhere or (lock.announcement is not None and at_work)


def _refusal(folder: Path, holder: Holder | None, is_locked: bool) -> str:
    unknown = [file for file, process in announced(folder / "lock").items() if not process or not process.boots_with_us]
    who = holder or "another process"
    if is_locked and not unknown:
        return f"{folder.name} is being written by {who}: wait until it is done, or open it to read only."
    files = " and ".join(str(file) for file in (*unknown, folder / "lock"))
    return f"{folder.name} is held by {who}: when that process is gone, delete the file {files}."


def _lock_patiently(path: Path) -> FileLock | None:
    for _ in range(_TRIES - 1):
        if (lock := try_lock(path, 0o644)) is not None:
            return lock
        time.sleep(_PAUSE_S)
    return try_lock(path, 0o644)


def _read(path: Path) -> Holder | None:
    try:
        with path.open("rb") as file:
            return msgspec.json.decode(file.read(4096), type=Holder)
    except (OSError, msgspec.MsgspecError):
        return None


def _write(lock: FileLock, text: bytes) -> None:
    os.ftruncate(lock.descriptor, 0)
    os.lseek(lock.descriptor, 0, os.SEEK_SET)
    os.write(lock.descriptor, text)
