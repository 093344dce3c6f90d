"""Secrets of a data folder: small files that only their owner can have read or placed."""

from __future__ import annotations

import os
import secrets
import stat
import time
from pathlib import Path

from wafer_viewer.model.errors import DatasetError

_MOST_BYTES = 64_000
_LOOKS, _BETWEEN_LOOKS_S = 50, 0.02
_OWNER_ONLY = 0o600
_OTHERS = 0o077
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)


def create_private(path: Path, text: str) -> None:
    """Write a file unless there is one; of two programs that start at once, the first one's file is used."""
    draft = _draft(path, text)
    try:
        os.link(draft, path)
    except FileExistsError:
        pass
    finally:
        draft.unlink()


def replace_private(path: Path, text: str) -> None:
    """Write a file in place of any other."""
    draft = _draft(path, text)
    try:
        draft.replace(path)
    except OSError:
        draft.unlink()
        raise


def read_private(path: Path, mend: str) -> str:
    """Return the text of a file that is the user's own, without the space around it.

    Parameters
    ----------
    path
        The file.
    mend
        End of the sentence for another file: the consequence, and what to do.

    Returns
    -------
    str
        Its text; what is not ASCII is replaced.

    Raises
    ------
    DatasetError
        Others may have read or placed the file.
    """
    try:
        opened = os.open(path, os.O_RDONLY | os.O_NONBLOCK | _NO_LINK)
    except OSError as fault:
        why = "is a symbolic link" if path.is_symlink() else f"cannot be read ({fault.strerror})"
        raise DatasetError(f"{path} {why}: {mend}") from fault
    with os.fdopen(opened, "rb") as file:
        _await_one_name(file.fileno())
        if (why := _ownership_problem(os.fstat(file.fileno()))) is not None:
            raise DatasetError(f"{path} {why}: {mend}")
        return file.read(_MOST_BYTES).decode("ascii", "replace").strip()


def _draft(path: Path, text: str) -> Path:
    """Write a complete file under a temporary name next to `path`."""
    draft = path.with_name(f"{path.name}-{secrets.token_hex(8)}")
    with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _NO_LINK, _OWNER_ONLY), "w") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    return draft


def _await_one_name(file: int) -> None:
    """Wait until a program that makes the file at this moment has removed its draft, the same file's second name."""
    for _ in range(_LOOKS):
        if os.fstat(file).st_nlink <= 1:
            return
        time.sleep(_BETWEEN_LOOKS_S)


def _ownership_problem(status: os.stat_result) -> str | None:
    """Return why others may have read or placed a file, or None; systems without such permissions pass."""
    if not stat.S_ISREG(status.st_mode):
        return "is not a file"
    if not hasattr(os, "geteuid"):
        return None
    if status.st_uid != os.geteuid():
        return "belongs to another user"
    if stat.S_IMODE(status.st_mode) & _OTHERS:
        return "can be read or written by others"
    return "has a second name" if status.st_nlink > 1 else None
