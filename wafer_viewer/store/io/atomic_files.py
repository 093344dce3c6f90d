"""Atomic and durable writes: data go to a temporary file that is then renamed, so that no partial file is visible.

A power cut may lose any write that was not waited for, and those after it may survive. So the contents are on the disk
before the name is, and the name before the writer returns.
"""

from __future__ import annotations

import errno
import glob
import os
import re
import secrets
import shutil
import socket
import sys
import time
import zlib
from collections.abc import Generator
from contextlib import contextmanager, suppress
from functools import cache
from itertools import count
from pathlib import Path

from wafer_viewer.model.errors import DatasetError, DiskFullError
from wafer_viewer.model.file_contents import DATASET_ENDING

_PART = re.compile(r"\..+\.(\d+)-([0-9a-f]{8})?[0-9a-f]{6}\.part(\.old)?")
"""Name of a file or folder that is being written, or was replaced, with the process and `_process_space`."""
_NOT_FOR_FOLDERS = (errno.EINVAL, errno.ENOTSUP, errno.EBADF)
"""Errors by which file systems say that they have nothing to wait for in a folder."""
"""Ending of datasets: whoever takes the lock of one removes all dead parts in it, where many are written."""
DEAD_AFTER_S = 900.0
"""Age of the last change from which a part of another machine is dead; a live one changes every few seconds."""
_FULL = (errno.ENOSPC, errno.EDQUOT)
_MENDS = {
    errno.ENOSPC: "the disk is full: free some space or choose another folder",
    errno.EDQUOT: "the quota is used up: free some space or choose another folder",
    errno.EACCES: "there is no permission to write there: choose another folder",
    errno.EPERM: "there is no permission to write there: choose another folder",
    errno.EROFS: "it is on a read-only disk: choose another folder",
    errno.ENOTDIR: "a part of the path is a file: choose another folder",
    errno.ENOENT: "its folder does not exist: make it or choose another",
    errno.EISDIR: "it is a folder: choose another name",
}


@contextmanager
def atomic_write(path: Path) -> Generator[Path]:
    """Context manager for an atomic write: yields a temporary path, renamed to `path`, or removed on failure.

    The path may be a file or a folder. What a killed process left of it is removed before. It is on the disk at the
    end; inside another part, when that is. Raises DatasetError when it cannot be written to.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{_process_space()}{secrets.token_hex(3)}.part")
    is_inside_part = any(_PART.fullmatch(parent.name) for parent in path.parents)
    if not any(parent.suffix == DATASET_ENDING for parent in path.parents):
        _remove_dead_parts_of(path)
    try:
        with os_errors_as_dataset_errors(path):
            yield temporary
            if not is_inside_part:
                _all_to_disk(temporary)
            _move(temporary, path, wait=not is_inside_part)
    except DatasetError as fault:  # report the name that the user knows
        raise type(fault)(str(fault).replace(temporary.name, path.name)) from fault
    finally:
        remove(temporary)


def require_free(path: Path) -> None:
    """Remove what killed processes left of a folder when they wrote it. Raises DatasetError if it exists."""
    _remove_dead_parts_of(path)
    if path.exists():
        raise DatasetError(f"{path} exists already: give the name of a new folder.")


def _remove_dead_parts_of(path: Path) -> None:
    """Remove what killed processes left of a file or folder when they wrote it."""
    with suppress(OSError):
        for part in path.parent.glob(f".{glob.escape(path.name)}.*.part*"):
            if _is_dead(part):
                remove(part)


def to_disk(path: Path) -> None:
    """Wait until the contents of a file, or the names in a folder, are on the disk. Raises OSError when they cannot."""
    is_folder = path.is_dir()
    if is_folder and os.name == "nt":
        return
    descriptor = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        flush(descriptor)
    except OSError as fault:
        if not (is_folder and fault.errno in _NOT_FOR_FOLDERS):
            raise
    finally:
        os.close(descriptor)


def flush(descriptor: int) -> None:
    """Wait until an open file is on the disk, and not in the memory of the disk."""
    if sys.platform == "darwin":
        import fcntl

        fcntl.fcntl(descriptor, fcntl.F_FULLFSYNC)
    else:
        os.fsync(descriptor)


def make_folder(path: Path) -> None:
    """Make a folder and those above it, on the disk when it returns. Raises DatasetError when it cannot be made."""
    with os_errors_as_dataset_errors(path):
        made = [place for place in (path, *path.parents) if not place.exists()]
        path.mkdir(parents=True, exist_ok=True)
        for place in reversed(made):
            to_disk(place.parent)


def _all_to_disk(path: Path) -> None:
    """Wait until a file, or a folder with all that is in it, is on the disk."""
    for place, _, files in os.walk(path, topdown=False):
        for name in files:
            to_disk(Path(place) / name)
        to_disk(Path(place))
    if not path.is_dir():
        to_disk(path)


@contextmanager
def os_errors_as_dataset_errors(path: Path) -> Generator[None]:
    """Convert an OSError on writing `path` to a DatasetError of one sentence; DiskFullError if there is no space."""
    try:
        yield
    except OSError as fault:
        mend = _MENDS.get(fault.errno or 0, f"{(fault.strerror or str(fault)).lower()}: choose another folder")
        error = DiskFullError if fault.errno in _FULL else DatasetError
        raise error(f"{path} cannot be written: {mend}.") from fault


def new_file(folder: Path, name: str, ending: str) -> Path:
    """Make an empty file with the first free number, as ``NAME-3.ENDING``; nobody else gets the same one.

    Raises DatasetError when the folder cannot be written to.
    """
    paths = (folder / f"{name}-{n}{ending}" for n in count(1))
    return next(path for path in paths if _claimed(path))


def _claimed(path: Path) -> bool:
    """Make an empty file; return False if there is a file of that name."""
    with os_errors_as_dataset_errors(path), suppress(FileExistsError):
        path.touch(exist_ok=False)
        return True
    return False


def write_text(path: Path, text: str) -> None:
    """Write a small text file atomically."""
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def remove(path: Path) -> None:
    """Remove a file or a folder with its contents as far as permitted; a missing path is no error."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


def remove_dead_parts(folder: Path, *, but: frozenset[str] = frozenset()) -> tuple[Path, ...]:
    """Remove what killed processes left half written below a folder, and return it; but: names of folders to skip.

    A part is dead if its process ran on this machine and is gone. That of another machine, which may be at work on it,
    is dead when nothing in it changed for a quarter of an hour.
    """
    found: list[Path] = []
    for place, folders, files in os.walk(folder):
        parts = [Path(place) / name for name in (*folders, *files) if _PART.fullmatch(name)]
        found += [part for part in parts if _is_dead(part)]
        folders[:] = [name for name in folders if name not in but and not _PART.fullmatch(name)]
    for part in found:
        remove(part)
    return tuple(found)


def _is_dead(part: Path) -> bool:
    match = _PART.fullmatch(part.name)
    if match is None:
        return False
    if sys.platform != "win32":
        if _runs(int(match[1])):
            return False
        if match[2] == _process_space():
            return True
    inside = (Path(place) / name for place, folders, files in os.walk(part) for name in (*folders, *files))
    with suppress(OSError):
        return time.time() - max(path.lstat().st_mtime for path in (part, *inside)) > DEAD_AFTER_S
    return False


@cache
def _process_space() -> str:
    """Return a tag that processes share whose numbers mean the same: of a running machine, or of a container."""
    try:
        space = Path("/proc/sys/kernel/random/boot_id").read_text() + str(Path("/proc/self/ns/pid").readlink())
    except OSError:
        space = socket.gethostname()
    return f"{zlib.crc32(space.encode()):08x}"


def _runs(pid: int) -> bool:
    """Return whether a process runs on this machine."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def files_below(folder: Path) -> list[Path]:
    """Return all files in a folder and in those below it, in no order; folders that are links are not entered."""
    found: list[Path] = []
    with suppress(FileNotFoundError, NotADirectoryError, PermissionError), os.scandir(folder) as entries:
        for entry in entries:
            path = Path(entry.path)
            if entry.is_dir(follow_symlinks=False):
                found += files_below(path)
            elif path.is_file() if entry.is_symlink() else entry.is_file(follow_symlinks=False):
                found.append(path)
    return found


def require_space(folder: Path, needed_bytes: int, purpose: str) -> None:
    """Raise DatasetError when the disk of `folder` has less free space than needed."""
    free = shutil.disk_usage(_existing(folder)).free
    if needed_bytes > free:
        raise DatasetError(
            f"{purpose} needs {size(needed_bytes)} and {_existing(folder)} has {size(free)} free: "
            "free some space or choose another folder."
        )


def size(n_bytes: float) -> str:
    """Format a size in bytes, as in ``3.4 GB``."""
    for unit in ("B", "kB", "MB"):
        if n_bytes < 1000:
            return f"{n_bytes:.0f} {unit}" if unit == "B" else f"{n_bytes:.1f} {unit}"
        n_bytes /= 1000
    return f"{n_bytes:.1f} GB"


def natural_sort_key(name: str) -> list[str | int]:
    """Return a sort key for natural order: ``a2`` before ``a10``."""
    return [int(part) if i % 2 else part for i, part in enumerate(re.split(r"(\d+)", name.casefold()))]


def _existing(folder: Path) -> Path:
    absolute = folder.absolute()
    return next(p for p in (absolute, *absolute.parents) if p.exists())


def _move(source: Path, target: Path, *, wait: bool) -> None:
    """Rename, also over a non-empty folder, which is moved away first and removed afterwards.

    A folder whose new name does not reach the disk is moved back: whoever was told so can write it again. Where no name
    can be changed any more, it is removed unless it replaced another.
    """
    aside = target.with_name(f"{source.name}.old") if target.is_dir() else None
    if aside is not None:
        target.rename(aside)
    source.replace(target)
    try:
        if wait:
            to_disk(target.parent)
    except OSError:
        if target.is_dir():
            _move_back(target, source, aside)
        raise
    if aside is not None:
        remove(aside)


def _move_back(target: Path, source: Path, aside: Path | None) -> None:
    """Undo the renaming of a folder as far as the disk permits."""
    try:
        target.rename(source)
    except OSError:
        remove(aside or target)
        return
    if aside is not None:
        aside.rename(target)
