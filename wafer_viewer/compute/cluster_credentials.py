"""Cluster credentials: a folder with TLS certificates and dask's configuration.

Every machine has a copy. File names in it are relative, so the folder can be anywhere.
"""

from __future__ import annotations

import datetime
import os
from pathlib import Path
from typing import Any

import yaml
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from wafer_viewer.compute.dask_cluster import SETTINGS
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.io.atomic_files import os_errors_as_dataset_errors

AUTHORITY, CERTIFICATE, KEY, CONFIGURATION = "authority.pem", "certificate.pem", "key.pem", "dask.yaml"
VALID_DAYS = 3650
PRIVATE_FOLDER, PRIVATE_FILE = 0o700, 0o600
_USAGES = (
    "digital_signature",
    "content_commitment",
    "key_encipherment",
    "data_encipherment",
    "key_agreement",
    "key_cert_sign",
    "crl_sign",
    "encipher_only",
    "decipher_only",
)


def write_cluster_files(folder: Path) -> None:
    """Write an authority, a certificate and key for all machines, and ``dask.yaml``, readable by this user only.

    The authority's private key is not saved, so that no further certificate can be signed. Raises DatasetError if one
    of the files exists already.
    """
    authority_key, key = (ec.generate_private_key(ec.SECP256R1()) for _ in range(2))
    authority = _certificate("wafer-viewer authority", authority_key.public_key(), None, authority_key)
    certificate = _certificate("wafer-viewer", key.public_key(), authority, authority_key)
    with os_errors_as_dataset_errors(folder):
        folder.mkdir(parents=True, exist_ok=True, mode=PRIVATE_FOLDER)
    contents = {
        AUTHORITY: authority.public_bytes(Encoding.PEM),
        CERTIFICATE: certificate.public_bytes(Encoding.PEM),
        KEY: key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()),
        CONFIGURATION: yaml.safe_dump(configuration()).encode(),
    }
    for name in contents:
        if (folder / name).exists():
            raise DatasetError(f"{folder / name} exists already: use that cluster's files, or choose another folder.")
    for name, content in contents.items():
        _write_private(folder / name, content)


def configuration() -> dict[str, Any]:
    """Return dask's configuration of a scheduler, a worker or a client, as nested tables."""
    own = {"cert": CERTIFICATE, "key": KEY}
    tls = {"ca-file": AUTHORITY, "scheduler": own.copy(), "worker": own.copy(), "client": own.copy()}
    flat = SETTINGS | {
        "distributed.comm.default-scheme": "tls",
        "distributed.comm.require-encryption": True,
        "distributed.comm.tls": tls,
    }
    nested: dict[str, Any] = {}
    for name, value in flat.items():
        *tables, last = name.split(".")
        table = nested
        for part in tables:
            table = table.setdefault(part, {})
        table[last] = value
    return nested


def _certificate(
    name: str,
    of: ec.EllipticCurvePublicKey,
    authority: x509.Certificate | None,
    authority_key: ec.EllipticCurvePrivateKey,
) -> x509.Certificate:
    """Return a certificate signed by an authority; without one, the self-signed certificate of the authority."""
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    now, day = datetime.datetime.now(datetime.UTC), datetime.timedelta(days=1)  # clocks of machines differ
    usage = "key_cert_sign" if authority is None else "digital_signature"
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject if authority is None else authority.subject)
        .public_key(of)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - day)
        .not_valid_after(now + VALID_DAYS * day)
        .add_extension(x509.BasicConstraints(ca=authority is None, path_length=None), critical=True)
        .add_extension(x509.KeyUsage(**{u: u == usage for u in _USAGES}), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(of), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(authority_key.public_key()), critical=False)
    )
    if authority is not None:
        both_ends = (ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH)
        builder = builder.add_extension(x509.ExtendedKeyUsage(both_ends), critical=False)
    return builder.sign(authority_key, hashes.SHA256())


def _write_private(path: Path, content: bytes) -> None:
    with (
        os_errors_as_dataset_errors(path),
        os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, PRIVATE_FILE), "wb") as file,
    ):
        file.write(content)
