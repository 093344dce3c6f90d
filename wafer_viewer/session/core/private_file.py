"""Secrets of a data folder that only their owner can read: the token of the page, and its password as a hash.

The token is in a separate file, ``.wafer-viewer/token``, readable by its owner only. Two programs on one folder share
the token; their cookies differ by port. A stored token is used only if nobody else can have read or placed the file.

The hash, in ``.wafer-viewer/password`` of the data folder, is that of scrypt (RFC 7914): an attempt costs 128 MB and
some tenths of a second, so that a stolen file gives away no good password.
"""

from __future__ import annotations

import hashlib
import hmac
import logging
import os
import re
import secrets
import stat
import threading
import time
import unicodedata
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from wafer_viewer.model.errors import DatasetError, PlanError
from wafer_viewer.session.session_restore import KEPT_IN

# --------------------------------------------------------------------------------------------------------- private file


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


# ----------------------------------------------------------------------------------------------------------- page token


TOKEN_NAME = "token"
_BYTES = 24
_IS_TOKEN = re.compile(r"[A-Za-z0-9_-]{32,128}")
_TOKEN_MEND = (
    "the page would be open to others. Start once with --new-token, or delete the file; addresses printed earlier no "
    "longer open the page."
)
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
    path = folder / KEPT_IN / TOKEN_NAME
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if renew:
            replace_private(path, f"{new_token()}\n")
        elif not os.path.lexists(path):
            create_private(path, f"{new_token()}\n")
    except OSError as fault:
        if renew:
            raise DatasetError(f"{path} cannot be replaced ({fault.strerror}): the token stays as it was.") from fault
        if not os.path.lexists(path):
            log.warning("The token holds for this run only, %s cannot be written: %s", path, fault.strerror)
            return new_token()
    text = read_private(path, _TOKEN_MEND)
    if not _IS_TOKEN.fullmatch(text):
        raise DatasetError(f"{path} holds no token: {_TOKEN_MEND}")
    return text


# -------------------------------------------------------------------------------------------------------- page password


PASSWORD_NAME = "password"
LEAST_CHARACTERS, MOST_CHARACTERS = 12, 256
_LOG2_COST, _BLOCK_SIZE, _PARALLEL = 17, 8, 1
"""Cost of scrypt that OWASP's Password Storage Cheat Sheet names first."""
_MEMORY_BYTES = 2 * 128 * _BLOCK_SIZE * 2**_LOG2_COST
_SALT_BYTES, _DIGEST_BYTES = 16, 32
_METHOD = f"scrypt-{_LOG2_COST}-{_BLOCK_SIZE}-{_PARALLEL}"
_STORED = re.compile(rf"{_METHOD} ([0-9a-f]{{{2 * _SALT_BYTES}}}) ([0-9a-f]{{{2 * _DIGEST_BYTES}}})")
_PASSWORD_MEND = "start once with --new-password, which asks for another one."


@dataclass(frozen=True, slots=True)
class PasswordHash:
    """Salted hash of a password."""

    salt: bytes
    digest: bytes

    @classmethod
    def of(cls, password: str) -> PasswordHash:
        """Return a hash with a new salt. Raises PlanError for a password that is too short or too long."""
        if not LEAST_CHARACTERS <= len(password) <= MOST_CHARACTERS:
            raise PlanError(
                f"The password has {len(password)} characters: it must have {LEAST_CHARACTERS} to {MOST_CHARACTERS}."
            )
        salt = secrets.token_bytes(_SALT_BYTES)
        return cls(salt, _digest(password, salt))

    @classmethod
    def read(cls, text: str) -> PasswordHash | None:
        """Return the hash of a stored text; None if it is none."""
        found = _STORED.fullmatch(text)
        return None if found is None else cls(*(bytes.fromhex(part) for part in found.groups()))

    @property
    def text(self) -> str:
        """The hash as it is stored."""
        return f"{_METHOD} {self.salt.hex()} {self.digest.hex()}"

    def matches(self, password: str) -> bool:
        """Return whether a password is the right one; the time does not depend on how much of it is right."""
        return hmac.compare_digest(_digest(password[: MOST_CHARACTERS + 1], self.salt), self.digest)


def stored_password(folder: Path) -> PasswordHash | None:
    """Return the hash stored with a data folder; None if there is none.

    Raises DatasetError if others may have read or placed the file, or if it holds no hash.
    """
    path = folder / KEPT_IN / PASSWORD_NAME
    if not (path.exists() or path.is_symlink()):
        return None
    found = PasswordHash.read(read_private(path, _PASSWORD_MEND))
    if found is None:
        raise DatasetError(f"{path} holds no hash of a password: {_PASSWORD_MEND}")
    return found


def store_password(folder: Path, password: str) -> PasswordHash:
    """Store the hash of a password with a data folder, in place of any other, and return it.

    Raises PlanError for a bad password, DatasetError if the folder cannot be written to.
    """
    hashed, path = PasswordHash.of(password), folder / KEPT_IN / PASSWORD_NAME
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_private(path, f"{hashed.text}\n")
    except OSError as fault:
        raise DatasetError(f"{path} cannot be written ({fault.strerror}): give --password-file FILE.") from fault
    return hashed


def password_in(file: Path) -> str:
    """Return the first line of a text file. Raises DatasetError if it cannot be read."""
    try:
        with file.open(encoding="utf-8") as text:
            return text.readline(4 * MOST_CHARACTERS).rstrip("\r\n")
    except (OSError, UnicodeDecodeError) as fault:
        why = fault.strerror if isinstance(fault, OSError) else "it is no text"
        raise DatasetError(f"The password file {file} cannot be read ({why}): give one with a line of text.") from fault


def _digest(password: str, salt: bytes) -> bytes:
    """Return the hash; the same letters typed on different keyboards are the same password."""
    return hashlib.scrypt(
        unicodedata.normalize("NFC", password).encode("utf-8", "surrogatepass"),
        salt=salt,
        n=2**_LOG2_COST,
        r=_BLOCK_SIZE,
        p=_PARALLEL,
        maxmem=_MEMORY_BYTES,
        dklen=_DIGEST_BYTES,
    )


WINDOW_S = 60.0
MOST_OF_ONE, MOST_OF_ALL = 5, 30
"""Most attempts in the window, from one place and in all: with 12 characters nobody guesses the password."""


class AttemptLimit:
    """Limit of attempts in a sliding window, for each place, such as an address, and in all."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._attempts: deque[tuple[float, str]] = deque()
        self._lock = threading.Lock()

    def admit(self, place: str) -> bool:
        """Return whether a place may try now, and count the attempt if so; refused ones do not count."""
        with self._lock:
            now = self._clock()
            while self._attempts and now - self._attempts[0][0] >= WINDOW_S:
                self._attempts.popleft()
            of_one = sum(1 for _, other in self._attempts if other == place)
            if of_one >= MOST_OF_ONE or len(self._attempts) >= MOST_OF_ALL:
                return False
            self._attempts.append((now, place))
            return True

    def forget(self, place: str) -> None:
        """Forget the attempts of a place that knew the password."""
        with self._lock:
            self._attempts = deque(attempt for attempt in self._attempts if attempt[1] != place)
