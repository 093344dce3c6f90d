"""Signed logs of a data folder: no record is changed, removed, inserted or moved unnoticed.

A line is a record as JSON with a last member ``"link"``: the SHA-256 of all bytes before the line, and the signature of
that digest and the record with the key of the data folder. A head, beside the key, holds the number of lines and the
digest of the whole log, signed, so that records missing at the end are noticed, too. A line without a link, and lines
without a head, are of an altered log.

What a log cannot prove: a log that is removed, or replaced by an older state, together with its head is a valid log.
The manifests of datasets hold how many records each log had when they were signed, so that a shorter one is noticed
beside a dataset that was signed later. Who has the key can sign anything. Reports name the number of records and the
key; keep them elsewhere.

The key is made at the first signature, readable by its owner only, and stays on this machine: a copy of the folder
without it can verify, but not sign. A signature shows that somebody with the key signed; not who that was, nor that the
figures are true.
"""

from __future__ import annotations

import hashlib
import os
import re
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Generic, TypeVar

import msgspec

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.roles import AuditEntry
from wafer_viewer.model.spec import Spec, Within, decode
from wafer_viewer.store.io.atomic_files import atomic_write, make_folder
from wafer_viewer.store.io.checksums import (
    Checksum,
    append_bytes,
    complete_lines,
    line_state,
    load_json,
    save_json,
    sealed_line,
    strip_checksum,
)
from wafer_viewer.store.io.file_lock import locked

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey


# ---------------------------------------------------------------------------------------------------------- signing key


KEPT_IN = ".wafer-viewer"
"""Folder in a data folder of what belongs to the program on this machine: key, page token, heads of logs."""
KEY_FILE = "conformance-key.pem"
KNOWN_KEYS = "known-keys.txt"
"""File in a data folder with other public keys that are trusted, hex, one a line; what follows one is a comment."""
OWNER_ONLY = 0o600
_PUBLIC = re.compile(r"[0-9a-f]{64}")


def signing_key(folder: Path) -> Ed25519PrivateKey:
    """Return the key of a data folder, made at the first call and readable by its owner only.

    Raises DatasetError when it cannot be written or read.
    """
    path = folder / KEPT_IN / KEY_FILE
    if not path.exists():
        _make_key(path)
    return _read_key(path)


def known_public_key(folder: Path) -> str:
    """Return the public key of a data folder, hex; an empty text if it has none."""
    path = folder / KEPT_IN / KEY_FILE
    return public_key(_read_key(path)) if path.exists() else ""


def public_key(key: Ed25519PrivateKey) -> str:
    """Return the public key, hex."""
    return key.public_key().public_bytes_raw().hex()


def trusted_keys(folder: Path) -> frozenset[str]:
    """Return the public keys that records of a data folder may be signed with; empty if any may.

    A folder without a key of its own is a copy: there is nothing to compare with.
    """
    own = known_public_key(folder)
    if not own:
        return frozenset()
    path = folder / KNOWN_KEYS
    listed = path.read_text("utf-8", "replace").lower().split("\n") if path.exists() else []
    return frozenset((own, *(found[0] for line in listed if (found := _PUBLIC.match(line.strip())))))


def is_signed(content: bytes, key: str, value: str) -> bool:
    """Return whether a signature fits; key: public, hex; value: hex."""
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    try:
        Ed25519PublicKey.from_public_bytes(bytes.fromhex(key)).verify(bytes.fromhex(value), content)
    except (InvalidSignature, ValueError):
        return False
    return True


def _make_key(path: Path) -> None:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    content = Ed25519PrivateKey.generate().private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    make_folder(path.parent)
    with (
        atomic_write(path) as temporary,
        os.fdopen(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, OWNER_ONLY), "wb") as file,
    ):
        file.write(content)


def _read_key(path: Path) -> Ed25519PrivateKey:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    mend = "restore it from a copy, or remove it for a new one"
    try:
        key = load_pem_private_key(path.read_bytes(), None)
    except (OSError, ValueError, TypeError) as fault:
        raise DatasetError(f"{path} holds no key ({fault}): {mend}.") from fault
    if not isinstance(key, Ed25519PrivateKey):
        raise DatasetError(f"{path} holds another kind of key: {mend}.")
    return key


# ----------------------------------------------------------------------------------------------------------- signed log


S = TypeVar("S", bound=Spec)
HEAD, LOCK = ".head", ".lock"
RESTORE = "restore the log from a copy, or move it and its head away to begin a new one"
_LINK = re.compile(rb',"link":\{"after":"([0-9a-f]{64})","key":"([0-9a-f]{64})","signature":"([0-9a-f]{128})"\}\}$')


class LogHead(Spec, frozen=True, kw_only=True):
    """Number of lines of a log and the SHA-256 of its bytes when the last was written, signed."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    lines: Annotated[int, Within(0)]
    sha256: str
    key: str
    signature: str


@dataclass(frozen=True, slots=True)
class SignedLog(Generic[S]):
    """Records of a log, oldest first, and the public keys of their signatures, hex."""

    records: tuple[S, ...]
    keys: tuple[str, ...]


def append_record(path: Path, record: Spec) -> None:
    """Append a record to the log of a data folder, signed with the folder's key.

    Raises DatasetError when the log was altered, or cannot be written; the record then does not count.
    """
    with locked(path.parent / KEPT_IN / f"{path.name}{LOCK}"):
        _append(path, msgspec.json.encode(record))


def read_log(path: Path, kind: type[S]) -> SignedLog[S]:
    """Return the records of a log. Raises DatasetError when a line is damaged, or the log was altered."""
    head = _read_head(path)  # first: a record that is signed meanwhile is in the log before it is in the head
    content = complete_lines(path)
    keys = _verify(path, content, head)
    lines = content.splitlines()
    records = tuple(
        decode(_record_bytes(strip_checksum(line)), kind, f"{path}, line {n}", "json")
        for n, line in enumerate(lines, 1)
    )
    return SignedLog(records, tuple(dict.fromkeys(keys)))


def log_lengths(folder: Path) -> dict[str, int]:
    """Return how many records each log of a data folder has by its head, by name of the log.

    Heads that are damaged, or not signed with a key of the folder, are left out.
    """
    lengths: dict[str, int] = {}
    for file in sorted((folder / KEPT_IN).glob(f"*{HEAD}")):
        with suppress(DatasetError):
            head = load_json(file, LogHead)
            if head.lines and _is_valid(head) and head.key in trusted_keys(folder):
                lengths[file.name.removesuffix(HEAD)] = head.lines
    return lengths


def _append(path: Path, text: bytes) -> None:
    """Append a record, as JSON, and sign the new head."""
    before = complete_lines(path)
    key, after, head = signing_key(path.parent), hashlib.sha256(before), _read_head(path)
    if head is None or not _is_own(head, after.hexdigest(), public_key(key)):
        _verify(path, before, head)
    if head is None:  # a log with a signed line has a head, whenever the power is cut
        _save_head(path, key, before.count(b"\n"), after.hexdigest())
    own, value = public_key(key), key.sign(_signed_bytes(after.digest(), text)).hex()
    link = f',"link":{{"after":"{after.hexdigest()}","key":"{own}","signature":"{value}"}}}}'
    line = sealed_line(text.removesuffix(b"}") + link.encode()) + b"\n"
    append_bytes(path, line)
    after.update(line)
    _save_head(path, key, before.count(b"\n") + 1, after.hexdigest())


def _save_head(path: Path, key: Ed25519PrivateKey, n_lines: int, sha256: str) -> None:
    """Sign the number of lines of a log and the digest of its bytes."""
    signature = key.sign(_head_bytes(n_lines, sha256)).hex()
    save_json(_head_path(path), LogHead(lines=n_lines, sha256=sha256, key=public_key(key), signature=signature))


def _is_own(head: LogHead, sha256: str, own: str) -> bool:
    """Return whether a head was signed with the folder's own key for exactly these bytes, which were verified then."""
    return (head.key, head.sha256) == (own, sha256) and _is_valid(head)


def _is_valid(head: LogHead) -> bool:
    """Return whether the signature of a head fits."""
    return is_signed(_head_bytes(head.lines, head.sha256), head.key, head.signature)


def _record_bytes(line: bytes) -> bytes:
    """Return a record without its link."""
    link = _LINK.search(line)
    return line if link is None else line[: link.start()] + b"}"


def _verify(path: Path, content: bytes, head: LogHead | None) -> list[str]:
    """Verify checksums, links and head of a log, and return the keys of its signed lines.

    Raises DatasetError with the line that does not fit.
    """
    digest, keys = hashlib.sha256(), list[str]()
    digests = [digest.hexdigest()]
    for n, line in enumerate(content.splitlines(keepends=True), 1):
        if line_state(line.rstrip(b"\n")) is Checksum.DAMAGED:
            raise DatasetError(f"{path}, line {n} is damaged, its checksum differs: restore it from a copy.")
        text = strip_checksum(line.rstrip(b"\n"))
        if (link := _LINK.search(text)) is None:
            raise _altered(path, f"line {n} is not signed, and every record is signed when it is made")
        after, key, value = (part.decode() for part in link.groups())
        if after != digest.hexdigest():
            raise _altered(path, f"line {n} does not follow the lines before it, one of which was changed or moved")
        if not is_signed(_signed_bytes(digest.digest(), _record_bytes(text)), key, value):
            raise _altered(path, f"the signature of line {n} does not fit its contents")
        keys.append(key)
        digest.update(line)
        digests.append(digest.hexdigest())
    _verify_head(path, head, digests, keys)
    _require_trusted(path, keys)
    return keys


def _read_head(path: Path) -> LogHead | None:
    file = _head_path(path)
    return load_json(file, LogHead) if file.exists() else None


def _verify_head(path: Path, head: LogHead | None, digests: list[str], keys: list[str]) -> None:
    """Require that a log is what its head says, or continues it; digests: of the first 0, 1, … lines."""
    file = _head_path(path)
    if head is None:
        if keys:
            raise _altered(path, f"its head {file} is missing, so lines at its end may be, too")
        return
    if not _is_valid(head):
        raise _altered(path, f"the signature of its head {file} does not fit")
    if len(digests) <= head.lines:
        raise _altered(path, f"it has {len(digests) - 1} lines, and had {head.lines}: the last were removed")
    if digests[head.lines] != head.sha256:
        raise _altered(path, f"it is not the log that its head {file} was signed for")


def _require_trusted(path: Path, keys: list[str]) -> None:
    trusted = trusted_keys(path.parent)
    if trusted and (foreign := [key for key in dict.fromkeys(keys) if key not in trusted]):
        raise DatasetError(
            f"{path} has records signed with the key {foreign[0]}, which is not the key of this folder: if you trust "
            f"it, write it into {path.parent / KNOWN_KEYS}; else {RESTORE}."
        )


def _altered(path: Path, why: str) -> DatasetError:
    return DatasetError(f"{path} was altered: {why}: {RESTORE}.")


def _head_path(path: Path) -> Path:
    return path.parent / KEPT_IN / f"{path.name}{HEAD}"


def _signed_bytes(before: bytes, text: bytes) -> bytes:
    """Return what the signature of a line covers: the digest of all before, and the record."""
    return before + text


def _head_bytes(n_lines: int, sha256: str) -> bytes:
    return f"head of {n_lines} lines, {sha256}".encode()


# ------------------------------------------------------------------------------------------------------------ audit log


AUDIT_LOG = "audit.jsonl"


def record_action(folder: Path, entry: AuditEntry) -> None:
    """Append an entry. Raises DatasetError when the log was altered, or cannot be written."""
    append_record(folder / AUDIT_LOG, entry)


def recorded_actions(folder: Path, subject: str = "") -> tuple[AuditEntry, ...]:
    """Return the entries of a data folder, oldest first, optionally of one dataset, job or file.

    Raises DatasetError when a line is damaged, or the log was altered.
    """
    entries = read_log(folder / AUDIT_LOG, AuditEntry).records
    return tuple(entry for entry in entries if not subject or entry.subject == subject)
