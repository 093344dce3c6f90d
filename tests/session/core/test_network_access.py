"""A page that other machines reach: password and certificate, where they come from, and what is refused."""

from __future__ import annotations

import datetime
import os
import ssl
import stat
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec

from wafer_viewer.model.errors import DatasetError, PlanError, WaferViewerError
from wafer_viewer.session.core import network_access as module
from wafer_viewer.session.core import page_certificate as certificates
from wafer_viewer.session.core import private_file as passwords
from wafer_viewer.session.core.network_access import NetworkOptions, is_loopback, network_access
from wafer_viewer.session.core.page_certificate import page_certificate
from wafer_viewer.session.core.private_file import PasswordHash, password_in, store_password, stored_password

GOOD = "correct horse battery"
ELSEWHERE = "127.0.0.2"
posix = pytest.mark.skipif(sys.platform == "win32", reason="owners and modes of POSIX")


@pytest.fixture(autouse=True)
def quick_hashes(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The cost of the hash is that of the program only where a test is about it."""
    if "costs" not in request.node.name:
        monkeypatch.setattr(passwords, "_LOG2_COST", 4)


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Someone at the terminal who types these lines where a password is asked for."""

    def types(*lines: str) -> None:
        typed = iter(lines)
        monkeypatch.setattr(sys, "stdin", type("Terminal", (), {"isatty": lambda _: True})())
        monkeypatch.setattr(module.getpass, "getpass", lambda _: next(typed))

    return types


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "::1", "LOCALHOST"])
def test_loopback_needs_neither_and_leaves_no_file(tmp_path: Path, host: str) -> None:
    assert is_loopback(host)
    assert network_access(tmp_path, NetworkOptions(host)) is None
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("host", [ELSEWHERE, "0.0.0.0", "::", "", "192.168.1.20", "lab.example", "127.1", "2130706433"])
def test_any_other_host_needs_a_password(tmp_path: Path, host: str) -> None:
    with pytest.raises(PlanError, match=r"without a password: start it once in a terminal.*--password-file FILE"):
        network_access(tmp_path, NetworkOptions(host))


def test_options_of_a_network_mean_nothing_on_loopback(tmp_path: Path) -> None:
    with pytest.raises(PlanError, match="--password-file is for a page that others reach: give --host"):
        network_access(tmp_path, NetworkOptions("localhost", password_file=tmp_path / "password"))


def test_a_password_typed_once_is_stored_as_a_hash_only(tmp_path: Path, terminal: Callable[..., None]) -> None:
    terminal(GOOD, GOOD)
    first = network_access(tmp_path, NetworkOptions(ELSEWHERE))
    again = network_access(tmp_path, NetworkOptions(ELSEWHERE))
    assert first is not None
    assert again is not None
    assert first.password == again.password
    assert again.password.matches(GOOD)
    assert not again.password.matches(GOOD + " ")
    stored = tmp_path / ".wafer-viewer" / "password"
    assert GOOD not in stored.read_text()
    if os.name == "posix":
        assert stat.S_IMODE(stored.stat().st_mode) == 0o600


def test_another_password_replaces_the_stored_one(tmp_path: Path, terminal: Callable[..., None]) -> None:
    store_password(tmp_path, GOOD)
    terminal("another long password", "another long password")
    renewed = network_access(tmp_path, NetworkOptions(ELSEWHERE, new_password=True))
    assert renewed is not None
    assert not renewed.password.matches(GOOD)
    assert stored_password(tmp_path) == renewed.password


def test_passwords_that_differ_or_are_short_are_not_stored(tmp_path: Path, terminal: Callable[..., None]) -> None:
    terminal(GOOD, GOOD.upper(), "short", "short")
    with pytest.raises(PlanError, match="The two passwords differ"):
        network_access(tmp_path, NetworkOptions(ELSEWHERE))
    with pytest.raises(PlanError, match="The password has 5 characters: it must have 12 to 256"):
        network_access(tmp_path, NetworkOptions(ELSEWHERE))
    assert stored_password(tmp_path) is None


def test_a_password_of_a_file_or_of_the_environment_is_not_stored(tmp_path: Path, monkeypatch) -> None:
    file = tmp_path / "secret"
    file.write_text(f"{GOOD}\nand a note\n")
    monkeypatch.setenv("WAFER_VIEWER_PASSWORD", "that of the environment")
    for options, right in (
        (NetworkOptions(ELSEWHERE, password_file=file), GOOD),
        (NetworkOptions(ELSEWHERE), "that of the environment"),
    ):
        monkeypatch.setenv("WAFER_VIEWER_PASSWORD", "that of the environment")
        access = network_access(tmp_path, options)
        assert access is not None
        assert access.password.matches(right)
        assert "WAFER_VIEWER_PASSWORD" not in os.environ
    assert stored_password(tmp_path) is None


@pytest.mark.parametrize("content", [None, b"\xff\xfe"])
def test_a_password_file_that_cannot_be_read_is_named(tmp_path: Path, content: bytes | None) -> None:
    if content is not None:
        (tmp_path / "secret").write_bytes(content)
    with pytest.raises(DatasetError, match=r"The password file .*secret cannot be read"):
        password_in(tmp_path / "secret")


@posix
@pytest.mark.parametrize("spoil", ["mode", "link", "text"])
def test_a_stored_hash_that_others_could_have_placed_is_refused(tmp_path: Path, spoil: str) -> None:
    store_password(tmp_path, GOOD)
    file = tmp_path / ".wafer-viewer" / "password"
    if spoil == "mode":
        file.chmod(0o644)
    elif spoil == "link":
        file.rename(tmp_path / "elsewhere")
        file.symlink_to(tmp_path / "elsewhere")
    else:
        file.write_text("scrypt-1-1-1 00 00\n")
    with pytest.raises(DatasetError, match=r"--new-password"):
        stored_password(tmp_path)


def test_the_same_letters_of_another_keyboard_are_the_same_password() -> None:
    assert PasswordHash.of("Pr\u00fcfger\u00e4t-Halle7").matches("Pru\u0308fgera\u0308t-Halle7")


@pytest.mark.campaign
def test_a_wrong_password_costs_as_much_as_the_right_one() -> None:
    hashed = PasswordHash.of(GOOD)

    def ms(password: str) -> float:
        began = time.process_time()
        hashed.matches(password)
        return 1000 * (time.process_time() - began)

    trials = {text: [ms(text) for _ in range(3)] for text in (GOOD, GOOD[:-1] + "x", "", "x" * 100_000)}
    least = {text: min(times) for text, times in trials.items()}
    assert min(least.values()) > 50  # an attempt costs an attacker something
    assert max(least.values()) < 1.5 * statistics.median(least.values())


def test_a_self_signed_certificate_stays_the_same_until_it_ends(tmp_path: Path, monkeypatch) -> None:
    first = page_certificate(tmp_path, ELSEWHERE, None, None)
    again = page_certificate(tmp_path, ELSEWHERE, None, None)
    assert first.is_own
    assert first.fingerprint == again.fingerprint
    assert len(first.fingerprint.split(":")) == 32
    assert first.context.minimum_version == ssl.TLSVersion.TLSv1_2
    monkeypatch.setattr(certificates, "RENEWED_DAYS", certificates.VALID_DAYS)
    assert page_certificate(tmp_path, ELSEWHERE, None, None).fingerprint != first.fingerprint


@posix
def test_a_self_signed_certificate_is_for_its_host_and_its_key_for_its_owner(tmp_path: Path) -> None:
    page_certificate(tmp_path, "lab.example", None, None)
    file = tmp_path / ".wafer-viewer" / "certificate.pem"
    leaf = x509.load_pem_x509_certificate(file.read_bytes())
    names = leaf.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert "lab.example" in names.get_values_for_type(x509.DNSName)
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    before = file.read_bytes()
    page_certificate(tmp_path, ELSEWHERE, None, None)
    assert file.read_bytes() != before
    file.chmod(0o644)
    with pytest.raises(DatasetError, match="can be read or written by others: delete the file"):
        page_certificate(tmp_path, ELSEWHERE, None, None)


def given_pair(folder: Path, ended: bool = False, passphrase: bytes | None = None) -> tuple[Path, Path]:
    """Certificate and key of an administrator, as two files."""
    page_certificate(folder, ELSEWHERE, None, None)
    pem = (folder / ".wafer-viewer" / "certificate.pem").read_bytes()
    key = serialization.load_pem_private_key(pem, None)
    leaf = x509.load_pem_x509_certificate(pem)
    if ended:
        now, day = datetime.datetime.now(datetime.UTC), datetime.timedelta(days=1)
        builder = x509.CertificateBuilder().subject_name(leaf.subject).issuer_name(leaf.subject)
        builder = builder.public_key(leaf.public_key()).serial_number(7)
        assert isinstance(key, ec.EllipticCurvePrivateKey)
        leaf = (
            builder.not_valid_before(now - 9 * day).not_valid_after(now - day).sign(key, certificates.hashes.SHA256())
        )
    secret = serialization.BestAvailableEncryption(passphrase) if passphrase else serialization.NoEncryption()
    pair = folder / "page.crt", folder / "page.key"
    pair[0].write_bytes(leaf.public_bytes(serialization.Encoding.PEM))
    encoded = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, secret
    pair[1].write_bytes(key.private_bytes(*encoded))
    pair[1].chmod(0o600)
    return pair


def test_a_given_certificate_is_used(tmp_path: Path) -> None:
    own = page_certificate(tmp_path, ELSEWHERE, None, None)
    given = page_certificate(tmp_path, ELSEWHERE, *given_pair(tmp_path))
    assert (given.fingerprint, given.is_own) == (own.fingerprint, False)


def test_a_certificate_that_cannot_be_used_is_named_with_the_mend(tmp_path: Path) -> None:
    certificate, key = given_pair(tmp_path)

    def refused(first: Path | None, second: Path | None) -> str:
        with pytest.raises(WaferViewerError) as fault:
            page_certificate(tmp_path, ELSEWHERE, first, second)
        return str(fault.value)

    assert "go together" in refused(certificate, None)
    assert "There is no file" in refused(certificate, tmp_path / "nowhere")
    assert "cannot be used with the key" in refused(key, key)
    (tmp_path / "empty").write_text("")
    assert "give both in PEM format" in refused(tmp_path / "empty", key)
    other, _ = given_pair(tmp_path, ended=True)
    assert "ended on" in refused(other, key)
    certificate, locked = given_pair(tmp_path, passphrase=b"hush")
    assert "is encrypted" in refused(certificate, locked)
    if os.name == "posix":
        certificate, key = given_pair(tmp_path)
        key.chmod(0o644)
        assert "chmod o=" in refused(certificate, key)
