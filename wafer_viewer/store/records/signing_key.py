"""Signing key of a data folder (Ed25519, RFC 8032), and the public keys that its records may be signed with.

The key is made at the first signature, readable by its owner only, and stays on this machine: a copy of the folder
without it can verify, but not sign. A signature shows that somebody with the key signed; not who that was, nor that the
figures are true.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.io.atomic_files import atomic_write, make_folder

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

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
