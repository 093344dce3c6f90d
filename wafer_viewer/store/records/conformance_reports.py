"""Signed conformance reports: a JSON file with all figures, and beside it the page for people, whose digest it holds.

The signature (Ed25519, RFC 8032) is made with a key of the data folder. It shows that report and page were not altered
since somebody with that key signed them. It does not show who that was, nor that the figures are true.
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from wafer_viewer.model.acquisition.conformance import ConformanceReport, ReportSignature, SignedConformance
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.io.atomic_files import atomic_write, write_text
from wafer_viewer.store.io.checksums import load_json, save_json

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

KEY_FILE = "conformance-key.pem"
OWNER_ONLY = 0o600
PAGE, RECORD = ".html", ".json"


@dataclass(frozen=True, slots=True)
class VerifiedConformance:
    """Report whose signature fits, and the public key that it fits to, hex."""

    report: ConformanceReport
    key: str


def signing_key(folder: Path) -> Ed25519PrivateKey:
    """Return the key of a folder, made at the first call and readable by its owner only.

    Raises DatasetError when it cannot be written or read.
    """
    path = folder / KEY_FILE
    if not path.exists():
        _make_key(path)
    return _read_key(path)


def known_public_key(folder: Path) -> str:
    """Return the public key of a folder, hex; an empty text if it has none."""
    path = folder / KEY_FILE
    return public_key(_read_key(path)) if path.exists() else ""


def public_key(key: Ed25519PrivateKey) -> str:
    """Return the public key, hex."""
    return key.public_key().public_bytes_raw().hex()


def report_paths(path: Path) -> tuple[Path, Path]:
    """Return the files of a report: record and page. Raises DatasetError for another ending."""
    if path.suffix not in (PAGE, RECORD):
        raise DatasetError(f"{path} is no name of a report: give NAME{PAGE} or NAME{RECORD}; both are written.")
    return path.with_suffix(RECORD), path.with_suffix(PAGE)


def write_signed(report: ConformanceReport, page: str, path: Path, key: Ed25519PrivateKey) -> tuple[Path, Path]:
    """Write a report and its page, signed; return both files. Raises DatasetError when they cannot be written."""
    record, page_path = report_paths(path)
    held: dict[str, Any] = msgspec.to_builtins(report)
    digest = hashlib.sha256(page.encode()).hexdigest()
    value = key.sign(_signed_bytes(held, digest)).hex()
    signature = ReportSignature(key=public_key(key), value=value)
    write_text(page_path, page)
    save_json(record, SignedConformance(report=held, page_sha256=digest, signature=signature))
    return record, page_path


def verified_report(path: Path) -> VerifiedConformance:
    """Read a report and verify it and its page. Raises DatasetError when one is missing, damaged or altered.

    path: one of the two files. The page may be missing if the record is given.
    """
    record, page = report_paths(path)
    signed = load_json(record, SignedConformance)
    _require_signature(record, signed)
    if (path == page or page.exists()) and _digest(page) != signed.page_sha256:
        raise DatasetError(f"{page} was altered: it is not the page that {record.name} was signed with.")
    try:
        report = msgspec.convert(signed.report, ConformanceReport)
    except msgspec.ValidationError as fault:
        raise DatasetError(f"{record} is of another version of the program ({fault}): use that version.") from fault
    return VerifiedConformance(report, signed.signature.key)


def _make_key(path: Path) -> None:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    content = Ed25519PrivateKey.generate().private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    with atomic_write(path) as temporary:
        path.parent.mkdir(parents=True, exist_ok=True)
        with os.fdopen(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, OWNER_ONLY), "wb") as file:
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


def _require_signature(record: Path, signed: SignedConformance) -> None:
    """Raise DatasetError unless the signature fits."""
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    try:
        key = Ed25519PublicKey.from_public_bytes(bytes.fromhex(signed.signature.key))
        key.verify(bytes.fromhex(signed.signature.value), _signed_bytes(signed.report, signed.page_sha256))
    except (InvalidSignature, ValueError) as fault:
        raise DatasetError(
            f"{record} was altered: its signature does not fit its contents. Ask the lab for the original."
        ) from fault


def _signed_bytes(report: dict[str, Any], page_sha256: str) -> bytes:
    """Return what is signed, independent of the layout of the file and of the order of its members."""
    return json.dumps({"page_sha256": page_sha256, "report": report}, sort_keys=True, separators=(",", ":")).encode()


def _digest(page: Path) -> str:
    try:
        return hashlib.sha256(page.read_bytes()).hexdigest()
    except OSError as fault:
        raise DatasetError(f"{page} cannot be read: {fault.strerror}.") from fault
