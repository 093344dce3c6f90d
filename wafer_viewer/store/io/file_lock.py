"""Lock of a file that one process at a time holds: that of the operating system, or an announcement where it has none.

The operating system releases its lock when the process ends. Some disks refuse it (network and user-space file
systems): there each process announces itself in a file of its own beside the locked one, and then looks whether anyone
else has. Of two at a time at least one sees the other and steps back. Announcements of processes that are gone are
removed; since nobody else has a file of that name, this never removes that of a live one.
"""

from __future__ import annotations

import errno
import os
import secrets
import socket
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import msgspec

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.io.atomic_files import make_folder, os_errors_as_dataset_errors, write_text

# ----------------------------------------------------------------------------------------------------- process identity


class Process(msgspec.Struct, frozen=True, kw_only=True):
    """A process: its number, its machine, and when it started there.

    boot: id of the run of the machine; space: of the process numbers, which a container has of its own; start: clock
    ticks from boot to start. Empty where the operating system does not tell.
    """

    pid: int
    host: str
    boot: str = ""
    space: str = ""
    start: str = ""

    @property
    def boots_with_us(self) -> bool:
        """True if it belongs to this run of this machine, whatever the machine was called then."""
        return bool(self.boot) and self.boot == this_process().boot

    @property
    def is_gone(self) -> bool:
        """True if it is known to have ended: its numbers mean the same here, and no such process runs."""
        here = this_process()
        comparable = self.boots_with_us and bool(self.space) and self.space == here.space and bool(self.start)
        return comparable and _start_of(self.pid) != self.start


def this_process() -> Process:
    """Return the identity of this process."""
    return _identity(os.getpid(), socket.gethostname())


@cache
def _identity(pid: int, host: str) -> Process:
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        space = str(Path("/proc/self/ns/pid").readlink())
    except OSError:
        return Process(pid=pid, host=host)
    return Process(pid=pid, host=host, boot=boot, space=space, start=_start_of(pid))


def _start_of(pid: int) -> str:
    """Return when a process started, in clock ticks from boot; empty if none of that number runs."""
    try:
        after_name = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return ""
    state, start = after_name[0], after_name[19]
    return "" if state in "ZX" else start


# ------------------------------------------------------------------------------------------------------------ file lock


ANNOUNCEMENT = r"\.held-\d+-[0-9a-f]{8}"
"""End of the name of an announcement, after that of the locked file, as a regular expression."""
_PAUSE_S = 0.02
_HELD = (errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES, errno.EDEADLK)
"""Errors by which the operating system says that another process has the lock."""
_UNSUPPORTED = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOTSUP, errno.ENOSYS, errno.EINVAL)
"""Errors by which a disk says that it has no locks."""

if sys.platform == "win32":
    import msvcrt

    def _lock(descriptor: int) -> None:
        os.lseek(descriptor, 1 << 20, os.SEEK_SET)  # past the text, which others may read
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _lock(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


@dataclass(frozen=True, slots=True)
class FileLock:
    """Held lock of a file; descriptor: of the open file; announcement: None where the operating system holds it."""

    descriptor: int
    announcement: Path | None = None

    def release(self) -> None:
        """Release the lock."""
        os.close(self.descriptor)
        if self.announcement is not None:
            with suppress(OSError):
                self.announcement.unlink()


def try_lock(path: Path, mode: int = 0o600) -> FileLock | None:
    """Lock the file at `path`, made with `mode` if missing; None if another process has it.

    Raises DatasetError when it cannot be made or locked.
    """
    with os_errors_as_dataset_errors(path):
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, mode)
    try:
        with os_errors_as_dataset_errors(path):
            lock = _try(path, descriptor)
    except BaseException:
        os.close(descriptor)
        raise
    if lock is None:
        os.close(descriptor)
    return lock


def is_locked(path: Path) -> bool:
    """Return whether a process has the lock of a file; False if there is no such file, or it cannot be opened."""
    try:
        descriptor = os.open(path, os.O_RDWR)
    except OSError:
        return False
    try:
        return not _hold(descriptor) or bool(announced(path))
    except LocksUnsupportedError:
        return bool(announced(path))
    except OSError:  # nobody knows
        return True
    finally:
        os.close(descriptor)


def announced(path: Path, but: Path | None = None) -> dict[Path, Process | None]:
    """Return the announcements beside a file of processes that may run, with the process; but: an own one to skip.

    Those of processes that are known to be gone are removed. None: one that cannot be read.
    """
    found: dict[Path, Process | None] = {}
    for file in sorted(path.parent.glob(f"{path.name}.held-*")):
        process = _read(file)
        if process is not None and process.is_gone:
            file.unlink(missing_ok=True)
        elif file != but and file.exists():
            found[file] = process
    return found


@contextmanager
def locked(path: Path, most_s: float = 10.0) -> Generator[None]:
    """Context manager that holds the lock file at `path`, made if missing.

    Raises DatasetError when another program holds it for `most_s`, or it cannot be made.
    """
    make_folder(path.parent)
    until = time.monotonic() + most_s
    while (lock := try_lock(path)) is None:
        if time.monotonic() > until:
            raise DatasetError(_refusal(path))
        time.sleep(_PAUSE_S * (0.5 + secrets.randbelow(100) / 100))
    try:
        yield
    finally:
        lock.release()


class LocksUnsupportedError(Exception):
    """A disk that has no locks of the operating system."""


def _try(path: Path, descriptor: int) -> FileLock | None:
    try:
        free = _hold(descriptor)
    except LocksUnsupportedError:
        return _announce(path, descriptor)
    return FileLock(descriptor) if free and not announced(path) else None


def _announce(path: Path, descriptor: int) -> FileLock | None:
    """Announce this process; None, and no announcement, if another one has done so."""
    if announced(path):
        return None
    own = path.with_name(f"{path.name}.held-{os.getpid()}-{secrets.token_hex(4)}")
    with os_errors_as_dataset_errors(path):
        write_text(own, msgspec.json.encode(this_process()).decode())
    if announced(path, but=own):
        own.unlink(missing_ok=True)
        return None
    return FileLock(descriptor, own)


def _hold(descriptor: int) -> bool:
    """Lock a file until it is closed; return False if another process has it.

    Raises LocksUnsupportedError where the disk has no locks, OSError for any other fault.
    """
    try:
        _lock(descriptor)
    except OSError as fault:
        if fault.errno in _HELD:
            return False
        if fault.errno in _UNSUPPORTED:
            raise LocksUnsupportedError from fault
        raise
    return True


def _read(file: Path) -> Process | None:
    try:
        return msgspec.json.decode(file.read_bytes(), type=Process)
    except (OSError, msgspec.MsgspecError):
        return None


def _refusal(path: Path) -> str:
    for file, process in announced(path).items():
        if process is None or not process.boots_with_us:
            who = f"process {process.pid} on {process.host}" if process is not None else "another program"
            return f"{path} is held by {who}: wait until it is done; if that process is gone, delete {file}."
    return f"{path} is held by another program: wait until it is done, and try again."
