"""Exclusive write lock of a dataset: one process at a time, named in the file ``lock``.

The operating system's file lock is authoritative, so a killed process holds nothing. The text in the file names the
holder; an empty file means that the dataset is free. A holder on another machine is trusted, because it cannot be
checked.
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
from wafer_viewer.store.io.file_lock import hold

_TRIES, _PAUSE_S = 5, 0.02
"""Number of attempts, and pause in s: `holder_of` locks the file briefly itself, so one refusal is no proof."""

_NOT_OURS = frozenset({"frames"})
"""Folders in which nothing is written aside."""


class Holder(msgspec.Struct, frozen=True):
    """Process that holds the lock of a dataset."""

    pid: int
    host: str
    since: str

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}, since {self.since}"


class Lock:
    """Acquired lock of a dataset; call `release` to free it."""

    def __init__(self, folder: Path, descriptor: int) -> None:
        self._folder, self._descriptor = folder, descriptor

    @classmethod
    def take(cls, folder: Path) -> Lock:
        """Acquire the lock, and remove what killed processes left half written.

        Raises DatasetError naming the holder when another process has it.
        """
        with os_errors_as_dataset_errors(folder / "lock"):
            descriptor = os.open(folder / "lock", os.O_RDWR | os.O_CREAT, 0o644)
        held = not _hold_patiently(descriptor)
        holder = _read(descriptor)
        if held or _elsewhere(holder):
            os.close(descriptor)
            raise DatasetError(_refusal(folder, holder, held))
        try:
            with os_errors_as_dataset_errors(folder / "lock"):
                _write(descriptor, msgspec.json.encode(Holder(os.getpid(), socket.gethostname(), _now())))
        except DatasetError:
            os.close(descriptor)
            raise
        remove_dead_parts(folder, but=_NOT_OURS)
        return cls(folder, descriptor)

    @property
    def held(self) -> bool:
        """True until the lock is released."""
        return self._descriptor >= 0

    def release(self) -> None:
        """Remove what killed workers left half written, and release the lock; idempotent.

        A disk that does not even take the empty text leaves a name of no meaning.
        """
        if self._descriptor >= 0:
            remove_dead_parts(self._folder, but=_NOT_OURS)
            with suppress(OSError):
                _write(self._descriptor, b"")
            os.close(self._descriptor)
            self._descriptor = -1


def holder_of(folder: Path) -> Holder | None:
    """Return the process that holds the lock, or None when the dataset is free."""
    try:
        descriptor = os.open(folder / "lock", os.O_RDWR)
    except OSError:
        return None
    try:
        holder = _read(descriptor)
        return holder if _elsewhere(holder) or not hold(descriptor) else None
    finally:
        os.close(descriptor)


def _refusal(folder: Path, holder: Holder | None, held: bool) -> str:
    who = holder or "another process"
    if held:
        return f"{folder.name} is being written by {who}: wait until it is done, or open it to read only."
    return f"{folder.name} is held by {who}: when that process is gone, delete the file {folder / 'lock'}."


def _hold_patiently(descriptor: int) -> bool:
    for _ in range(_TRIES - 1):
        if hold(descriptor):
            return True
        time.sleep(_PAUSE_S)
    return hold(descriptor)


def _elsewhere(holder: Holder | None) -> bool:
    return holder is not None and holder.host != socket.gethostname()


def _read(descriptor: int) -> Holder | None:
    os.lseek(descriptor, 0, os.SEEK_SET)
    try:
        return msgspec.json.decode(os.read(descriptor, 4096), type=Holder)
    except msgspec.DecodeError:
        return None


def _write(descriptor: int, text: bytes) -> None:
    os.ftruncate(descriptor, 0)
    os.lseek(descriptor, 0, os.SEEK_SET)
    os.write(descriptor, text)


def _now() -> str:
    return datetime.datetime.now().astimezone().isoformat(timespec="seconds")
