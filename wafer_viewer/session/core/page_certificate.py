"""Certificate of a page that is served to a network: one that is given, or a self-signed one of the data folder.

A self-signed certificate encrypts as well as any other. Browsers warn of it until it is accepted, and its fingerprint
tells whether it is the right one.
"""

from __future__ import annotations

import datetime
import ipaddress
import os
import ssl
import stat
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from wafer_viewer.model.errors import DatasetError, PlanError
from wafer_viewer.session.core.private_file import read_private, replace_private
from wafer_viewer.session.session_restore import KEPT_IN

NAME = "certificate.pem"
VALID_DAYS, RENEWED_DAYS = 397, 14
"""Lifetime of a self-signed certificate, the longest that browsers accept, and its last days, when it is replaced."""
_MEND = "delete the file, and the next start makes another certificate."


@dataclass(frozen=True, slots=True)
class PageCertificate:
    """Certificate and key, ready for a server.

    fingerprint: SHA-256 of the certificate as browsers show it. is_own: made by this program, self-signed.
    """

    context: ssl.SSLContext
    fingerprint: str
    is_own: bool


def page_certificate(folder: Path, host: str, certificate: Path | None, key: Path | None) -> PageCertificate:
    """Return the certificate of a page.

    Parameters
    ----------
    folder
        The data folder, where a self-signed certificate is stored.
    host
        Address or name that browsers use.
    certificate, key
        PEM files; without both, a self-signed certificate is made, and made again when it ends soon or is for another
        host.

    Returns
    -------
    PageCertificate
        Certificate that is valid today.

    Raises
    ------
    PlanError
        One of the two files is missing.
    DatasetError
        A file cannot be read, does not fit the other, can be read by every user, or its certificate has expired.
    """
    if (certificate is None) != (key is None):
        raise PlanError("--certificate and --certificate-key go together: give both files, or neither.")
    if certificate is None or key is None:
        path = folder / KEPT_IN / NAME
        leaf = _own(path, host)
        return PageCertificate(_context(path, path), _fingerprint(leaf), is_own=True)
    context = _context(certificate, key)
    leaf = _leaf(certificate.read_bytes(), certificate)
    _require_valid(leaf, certificate)
    _require_secret(key)
    return PageCertificate(context, _fingerprint(leaf), is_own=False)


def _own(path: Path, host: str) -> x509.Certificate:
    """Return the self-signed certificate in a file, made before if there is none that fits."""
    names = _names(host)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if not (path.exists() or path.is_symlink()) or not _fits(_leaf(_read(path), path), names):
            replace_private(path, _self_signed(names).decode())
    except OSError as fault:
        raise DatasetError(
            f"{path} cannot be written ({fault.strerror}): give --certificate and --certificate-key."
        ) from fault
    return _leaf(_read(path), path)


def _read(path: Path) -> bytes:
    return read_private(path, _MEND).encode()


def _names(host: str) -> list[x509.GeneralName]:
    """Return the names that a self-signed certificate is for: the host, and loopback."""
    return [_name(name) for name in dict.fromkeys((host, "localhost", "127.0.0.1"))]


def _name(text: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(text))
    except ValueError:
        return x509.DNSName(text)


def _fits(leaf: x509.Certificate, names: list[x509.GeneralName]) -> bool:
    """Return whether a self-signed certificate is for these names and valid for some time."""
    try:
        of = leaf.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return False
    left = leaf.not_valid_after_utc - datetime.datetime.now(datetime.UTC)
    return set(names) <= set(of) and left > datetime.timedelta(days=RENEWED_DAYS)


def _self_signed(names: list[x509.GeneralName]) -> bytes:
    """Return a new key and its certificate as PEM."""
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "Wafer Viewer")])
    now, day = datetime.datetime.now(datetime.UTC), datetime.timedelta(days=1)  # clocks of machines differ
    certificate = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - day)
        .not_valid_after(now + (VALID_DAYS - 1) * day)
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .sign(key, hashes.SHA256())
    )
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()) + certificate.public_bytes(Encoding.PEM)


def _context(certificate: Path, key: Path) -> ssl.SSLContext:
    """Return the TLS settings of the server. Raises DatasetError for files that cannot be used."""

    def refuse_encrypted() -> str:
        raise DatasetError(f"The key {key} is encrypted: give one without a passphrase, readable by its owner only.")

    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    for file in (certificate, key):
        if not file.is_file():
            raise DatasetError(f"There is no file {file}: give a certificate and its key in PEM format.")
    try:
        context.load_cert_chain(certificate, key, password=refuse_encrypted)
    except OSError as fault:  # of the library as well as of the files
        why = getattr(fault, "reason", None) or fault.strerror or "no certificate"
        raise DatasetError(
            f"The certificate {certificate} cannot be used with the key {key} ({why}): give both in PEM format."
        ) from fault
    return context


def _leaf(pem: bytes, path: Path) -> x509.Certificate:
    """Return the first certificate of a text. Raises DatasetError if there is none."""
    try:
        return x509.load_pem_x509_certificates(pem)[0]
    except ValueError as fault:
        raise DatasetError(f"{path} holds no certificate: {_MEND}") from fault


def _require_valid(leaf: x509.Certificate, path: Path) -> None:
    if leaf.not_valid_after_utc < datetime.datetime.now(datetime.UTC):
        raise DatasetError(f"The certificate {path} ended on {leaf.not_valid_after_utc:%Y-%m-%d}: give a newer one.")


def _require_secret(key: Path) -> None:
    """Raise DatasetError for a key that every user of the machine can read; a group of servers may."""
    if hasattr(os, "geteuid") and stat.S_IMODE(key.stat().st_mode) & stat.S_IRWXO:
        raise DatasetError(f"Every user of this machine can read the key {key}: take that away with chmod o= {key}.")


def _fingerprint(leaf: x509.Certificate) -> str:
    return leaf.fingerprint(hashes.SHA256()).hex(":").upper()
