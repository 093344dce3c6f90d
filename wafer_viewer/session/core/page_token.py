"""Token of the page's address, stored with the data folder so that an open page reconnects after a restart.

The token is in a separate file, ``.wafer-viewer/token``, readable by its owner only. Two programs on one folder share
the token; their cookies differ by port. A stored token is used only if nobody else can have read or placed the file.
"""

from __future__ import annotations

import logging
import os
import re
import secrets
import stat
import time
from pathlib import Path

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.session.session_restore import KEPT_IN

NAME = "token"
_BYTES = 24
_MOST_BYTES = 256
_LOOKS, _BETWEEN_LOOKS_S = 50, 0.02
_OWNER_ONLY = 0o600
_OTHERS = 0o077
_IS_TOKEN = re.compile(r"[A-Za-z0-9_-]{32,128}")
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)
log = logging.getLogger(__name__)


def new_token() -> str:
    """Return a token that nobody can guess, for URLs and cookies."""
    return secrets.token_urlsafe(_BYTES)


def page_token(folder: Path, *, renew: bool = False) -> str:
    """Return the token of a data folder, made at the first start.

    Parameters
    ----------
    folder
        The data folder.
    renew
        Replace the token, so that addresses printed earlier no longer open the page.

    Returns
    -------
    str
        The token; one for this run alone where the folder cannot be written to.

    Raises
    ------
    DatasetError
        Others may have read or placed the file, or it holds no token.
    """
    path = folder / KEPT_IN / NAME
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if renew:
            _replace(path)
        elif not os.path.lexists(path):
            _make(path)
    except OSError as fault:
        if renew:
            raise DatasetError(f"{path} cannot be replaced ({fault.strerror}): the token stays as it was.") from fault
        if not os.path.lexists(path):
            log.warning("The token holds for this run only, %s cannot be written: %s", path, fault.strerror)
            return new_token()
    return _read(path)


def _make(path: Path) -> None:
    """Write a token unless there is one; of two programs that start at once, the first one's token is used."""
    draft = _draft(path)
    try:
        os.link(draft, path)
    except FileExistsError:
        pass
    finally:
        draft.unlink()


def _replace(path: Path) -> None:
    draft = _draft(path)
    try:
        draft.replace(path)
    except OSError:
        draft.unlink()
        raise


def _draft(path: Path) -> Path:
    """Write a complete new token to a temporary file next to `path`."""
    draft = path.with_name(f"{NAME}-{secrets.token_hex(8)}")
    with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _NO_LINK, _OWNER_ONLY), "w") as file:
        file.write(f"{new_token()}\n")
        file.flush()
        os.fsync(file.fileno())
    return draft


def _read(path: Path) -> str:
    """Return the token of a file that is the user's own. Raises DatasetError for any other."""
    try:
        opened = os.open(path, os.O_RDONLY | os.O_NONBLOCK | _NO_LINK)
    except OSError as fault:
        why = "is a symbolic link" if path.is_symlink() else f"cannot be read ({fault.strerror})"
        raise _refused(path, why) from fault
    with os.fdopen(opened, "rb") as file:
        _await_one_name(file.fileno())
        if (why := _ownership_problem(os.fstat(file.fileno()))) is not None:
            raise _refused(path, why)
        text = file.read(_MOST_BYTES).decode("ascii", "replace").strip()
    if not _IS_TOKEN.fullmatch(text):
        raise _refused(path, "holds no token")
    return text


def _await_one_name(file: int) -> None:
    """Wait until a program that makes the token at this moment has removed its draft, the same file's second name."""
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


def _refused(path: Path, why: str) -> DatasetError:
    return DatasetError(
        f"{path} {why}: the page would be open to others. Start once with --new-token, or delete the file; "
        "addresses printed earlier no longer open the page."
    )
