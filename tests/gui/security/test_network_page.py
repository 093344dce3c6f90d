"""A page on another interface, asked over TLS: the certificate, the login, its limits. 127.0.0.2 is that interface."""

from __future__ import annotations

import base64
import contextlib
import hashlib
import http.client
import re
import socket
import ssl
from collections.abc import Iterator

import pytest
import viser
import websockets.sync.client
from websockets.exceptions import InvalidStatus

from wafer_viewer.gui.security.access_guard import AccessGuard
from wafer_viewer.gui.security.server import close_server, open_server
from wafer_viewer.model.errors import PlanError
from wafer_viewer.session.core.network_access import NetworkAccess
from wafer_viewer.session.core.page_certificate import page_certificate
from wafer_viewer.session.core.private_file import MOST_OF_ALL, MOST_OF_ONE, WINDOW_S, AttemptLimit, PasswordHash

HOST = "127.0.0.2"
GOOD = "correct horse battery"
Server = tuple[viser.ViserServer, AccessGuard]


@pytest.fixture(scope="module")
def network(quick_passwords: None, tmp_path_factory: pytest.TempPathFactory) -> NetworkAccess:
    certificate = page_certificate(tmp_path_factory.mktemp("data"), HOST, None, None)
    return NetworkAccess(certificate, PasswordHash.of(GOOD))


@pytest.fixture
def server(network: NetworkAccess) -> Iterator[Server]:
    opened = open_server(HOST, 0, None, network)
    yield opened
    close_server(opened[0])


def trusting() -> ssl.SSLContext:
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    return context


def get(server: Server, path: str = "/", **headers: str) -> tuple[http.client.HTTPResponse, str]:
    wire = http.client.HTTPSConnection(HOST, server[0].get_port(), timeout=20, context=trusting())
    with contextlib.closing(wire):
        wire.request("GET", path, headers=headers)
        answer = wire.getresponse()
        return answer, answer.read().decode()


def log_in(server: Server, password: str, scheme: str = "Basic") -> http.client.HTTPResponse:
    credentials = base64.b64encode(f":{password}".encode()).decode()
    return get(server, "/login", Authorization=f"{scheme} {credentials}")[0]


@pytest.mark.parametrize("host", [HOST, "0.0.0.0", "::", ""])
def test_another_interface_is_not_opened_without_tls_and_a_password(host: str) -> None:
    with pytest.raises(PlanError, match=r"is not served at .* without TLS and a password: start it with"):
        open_server(host, 0)


def test_the_right_password_gives_a_cookie_that_opens_the_page(server: Server) -> None:
    answer = log_in(server, GOOD)
    given = answer.getheader("Set-Cookie", "")
    assert answer.status == 200
    assert all(word in given for word in ("HttpOnly", "SameSite=Strict", "Secure"))
    page, text = get(server, "/", Cookie=given.split(";")[0])
    assert (page.status, "<!doctype html>" in text) == (200, True)
    policy = page.getheader("Content-Security-Policy", "")
    assert f"wss://{HOST}:{server[0].get_port()}" in policy
    assert "ws://127" not in policy


@pytest.mark.parametrize("password", ["", GOOD[:-1], GOOD + "x", GOOD.upper(), "x" * 5000])
def test_a_wrong_password_gives_nothing(server: Server, password: str, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("WARNING"):
        answer = log_in(server, password)
    assert answer.status == 401
    assert answer.getheader("Set-Cookie") is None
    assert [record.getMessage() for record in caplog.records] == ["A login from 127.0.0.1 was refused: wrong password."]


def test_credentials_of_another_kind_or_none_are_a_wrong_password(server: Server) -> None:
    assert log_in(server, GOOD, scheme="Bearer").status == 401
    assert get(server, "/login")[0].status == 401
    assert get(server, "/login", Authorization="Basic !!!")[0].status == 401
    assert get(server, f"/login?password={GOOD.replace(' ', '%20')}")[0].status == 401


def test_who_is_not_logged_in_gets_the_form_and_nothing_else(server: Server) -> None:
    for path in ("/", "/assets/x.js", "/?token=wrong", "/reports/W7-report-1.html"):
        answer, text = get(server, path)
        assert answer.status == 401
        assert 'type="password"' in text
        assert server[1].address.split("=")[1] not in text
        policy = answer.getheader("Content-Security-Policy", "")
        assert "unsafe" not in policy
        assert "default-src 'none'" in policy


def test_the_policy_of_the_form_names_its_one_script(server: Server) -> None:
    answer, text = get(server)
    (script,) = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}';" in answer.getheader("Content-Security-Policy", "")


def test_a_login_for_a_foreign_name_or_of_a_foreign_page_is_refused(server: Server) -> None:
    credentials = "Basic " + base64.b64encode(f":{GOOD}".encode()).decode()
    foreign = {"Host": "evil.example"}, {"Origin": "https://evil.example"}, {"Origin": f"http://{HOST}"}
    for headers in foreign:
        answer, _ = get(server, "/login", Authorization=credentials, **headers)
        assert (answer.status, answer.getheader("Set-Cookie")) == (403, None)


def test_guesses_from_one_address_are_limited_even_if_the_last_is_right(server: Server) -> None:
    assert [log_in(server, "wrong password").status for _ in range(MOST_OF_ONE)] == [401] * MOST_OF_ONE
    assert log_in(server, GOOD).status == 429


def test_the_limit_holds_in_a_sliding_window_and_for_all_addresses_together() -> None:
    now = [0.0]
    limit = AttemptLimit(lambda: now[0])
    assert [limit.admit("a") for _ in range(MOST_OF_ONE + 2)] == [True] * MOST_OF_ONE + [False] * 2
    assert limit.admit("b")
    now[0] = WINDOW_S
    assert limit.admit("a")
    limit.forget("a")
    assert [limit.admit("a") for _ in range(MOST_OF_ONE + 1)][-1] is False
    now[0] = 2 * WINDOW_S
    assert [limit.admit(f"10.0.0.{k}") for k in range(MOST_OF_ALL + 1)] == [True] * MOST_OF_ALL + [False]


def test_a_login_over_plain_http_gets_no_answer(server: Server) -> None:
    with socket.create_connection((HOST, server[0].get_port()), 5) as wire:
        wire.sendall(f"GET / HTTP/1.1\r\nHost: {HOST}\r\n\r\n".encode())
        with contextlib.suppress(ConnectionError):
            assert not wire.recv(64).startswith(b"HTTP")


def test_old_tls_is_refused(server: Server) -> None:
    old = trusting()
    with pytest.warns(DeprecationWarning, match="TLSv1_1"):
        old.minimum_version = old.maximum_version = ssl.TLSVersion.TLSv1_1
    with (
        socket.create_connection((HOST, server[0].get_port()), 5) as wire,
        pytest.raises((ssl.SSLError, ConnectionError)),
    ):
        old.wrap_socket(wire, server_hostname=HOST)


def test_the_socket_opens_over_tls_with_the_cookie_only(server: Server) -> None:
    port = server[0].get_port()
    given = log_in(server, GOOD).getheader("Set-Cookie", "").split(";")[0]

    def status(**headers: str) -> int:
        try:
            with websockets.sync.client.connect(
                f"wss://{HOST}:{port}",
                ssl=trusting(),
                origin=f"https://{HOST}:{port}",  # pyright: ignore[reportArgumentType]
                additional_headers=headers,
                subprotocols=[f"viser-v{viser.__version__}"],  # pyright: ignore[reportArgumentType]
            ):
                return 101
        except InvalidStatus as refused:
            return refused.response.status_code

    assert status() == 401
    assert status(Cookie=given) == 101


def test_the_printed_address_opens_the_page_too(server: Server) -> None:
    assert server[1].address.startswith(f"https://{HOST}:")
    assert get(server, "/?" + server[1].address.partition("?")[2])[0].status == 200


def test_a_page_of_all_interfaces_goes_by_the_name_of_this_machine(network: NetworkAccess) -> None:
    guard = AccessGuard("0.0.0.0", "secret", network)
    guard.bound_to(8080)
    assert guard.address == f"https://{socket.gethostname()}:8080/?token=secret"
    assert guard.origin == "https://127.0.0.1:8080"
    assert AccessGuard("::1", "secret").origin == "http://[::1]:0"


def test_the_certificate_is_the_announced_one(server: Server, network: NetworkAccess) -> None:
    with (
        socket.create_connection((HOST, server[0].get_port()), 5) as plain,
        trusting().wrap_socket(plain, server_hostname=HOST) as wire,
    ):
        seen = wire.getpeercert(binary_form=True)
    assert seen is not None
    assert hashlib.sha256(seen).digest().hex(":").upper() == network.certificate.fingerprint
