"""Rule for interfaces of this machine: loopback is served as it is, any other one only with TLS and a password."""

from __future__ import annotations

import getpass
import os
import socket
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from wafer_viewer.model.errors import PlanError
from wafer_viewer.session.core.private_file import PasswordHash, password_in, store_password, stored_password

if TYPE_CHECKING:
    from wafer_viewer.session.core.page_certificate import PageCertificate

LOOPBACK = ("127.0.0.1", "localhost", "::1")
"""Hosts that only this machine reaches. Other addresses of the loopback network count as those of any network."""
EVERY_ADDRESS = ("0.0.0.0", "::", "")
"""Hosts that stand for all interfaces."""
PASSWORD_VARIABLE = "WAFER_VIEWER_PASSWORD"


@dataclass(frozen=True, slots=True)
class NetworkAccess:
    """Requirements of a page that other machines reach."""

    certificate: PageCertificate
    password: PasswordHash


def is_loopback(host: str) -> bool:
    """Return whether a host name stands for this machine alone."""
    return host.lower() in LOOPBACK


@dataclass(frozen=True, slots=True)
class NetworkOptions:
    """Choices of the command line for the interface that is served."""

    host: str
    certificate: Path | None = None
    certificate_key: Path | None = None
    password_file: Path | None = None
    new_password: bool = False

    @property
    def given(self) -> list[str]:
        """Flags that were given and that mean nothing on loopback."""
        named = {
            "--certificate": self.certificate,
            "--certificate-key": self.certificate_key,
            "--password-file": self.password_file,
            "--new-password": self.new_password,
        }
        return [flag for flag, value in named.items() if value]


def require_protected(host: str, network: NetworkAccess | None) -> None:
    """Raise PlanError for a page that other machines would reach without TLS and a password."""
    if network is None and not is_loopback(host):
        raise PlanError(
            f"The page is not served at {host or 'all addresses'} without TLS and a password: start it with "
            f"wafer-viewer serve --host {host or '0.0.0.0'}, which asks for a password."
        )


def network_access(folder: Path, asked: NetworkOptions) -> NetworkAccess | None:
    """Return certificate and password of a page; None for a page on loopback, which needs neither.

    Parameters
    ----------
    folder
        The data folder, where a self-signed certificate and the hash of a typed password are stored.
    asked
        What the command line asks for. The password is that of the file, else of the environment variable
        ``WAFER_VIEWER_PASSWORD``, else the stored one, else one that is asked for in the terminal.

    Returns
    -------
    NetworkAccess or None
        What the server needs.

    Raises
    ------
    PlanError
        The flags contradict each other, or there is no password and no terminal to ask for one.
    DatasetError
        A file cannot be used, or is open to others.
    """
    given = os.environ.pop(PASSWORD_VARIABLE, None)  # processes that are started later do not inherit it
    if is_loopback(asked.host):
        if asked.given:
            raise PlanError(
                f"{asked.given[0]} is for a page that others reach: give --host ADDRESS too, or leave it out."
            )
        return None
    from wafer_viewer.session.core.page_certificate import page_certificate  # 50 ms that loopback does without

    password = _password(folder, asked, given)
    name = socket.gethostname() if asked.host in EVERY_ADDRESS else asked.host
    return NetworkAccess(page_certificate(folder, name, asked.certificate, asked.certificate_key), password)


def _password(folder: Path, asked: NetworkOptions, given: str | None) -> PasswordHash:
    if asked.new_password and (asked.password_file or given):
        raise PlanError("--new-password asks for the password that is stored: leave out the other one.")
    if asked.password_file is not None:
        return PasswordHash.of(password_in(asked.password_file))
    if given is not None:
        return PasswordHash.of(given)
    if not asked.new_password and (stored := stored_password(folder)) is not None:
        return stored
    return store_password(folder, _asked_for(asked.host))


def _asked_for(host: str) -> str:
    """Return a password typed twice in the terminal."""
    if not sys.stdin.isatty():
        raise PlanError(
            f"The page is not served at {host} without a password: start it once in a terminal, which asks for one, "
            f"or give --password-file FILE or the variable {PASSWORD_VARIABLE}."
        )
    password = getpass.getpass(f"Password for everyone who opens the page at {host}: ")
    if getpass.getpass("The same again: ") != password:
        raise PlanError("The two passwords differ: start again.")
    return password
