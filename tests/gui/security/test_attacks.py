"""Attacks on the page over the wire, by a client that has the token and by one that has not."""

from __future__ import annotations

import contextlib
import hmac
import http.client
import logging
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
import viser._messages as viser_messages
import websockets.sync.client
from websockets.exceptions import ConnectionClosed

from tests.gui.security.test_access_guard import Server, connected, cookie, get, receive_all, token_path
from wafer_viewer.gui.app import keep_log
from wafer_viewer.gui.security import access_guard
from wafer_viewer.gui.security.access_guard import AccessGuard
from wafer_viewer.gui.security.server import close_server, open_server
from wafer_viewer.gui.widgets.callbacks import log

HALF_OPEN = 200
MOST_FRAME_BYTES = 50 * 1024 * 1024
"""Of viser."""


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    opened = open_server("127.0.0.1", 0)
    yield opened
    close_server(opened[0])


def raw(server: Server, request: bytes, timeout_s: float = 5.0) -> bytes:
    """The first bytes of the answer to these bytes; empty if the connection is closed without one."""
    with contextlib.closing(socket.create_connection(("127.0.0.1", server[0].get_port()), timeout_s)) as wire:
        with contextlib.suppress(ConnectionError):
            wire.sendall(request)
        with contextlib.suppress(ConnectionError):
            return wire.recv(4096)
    return b""


@pytest.mark.parametrize(
    "path",
    [
        "/../../../../etc/passwd",
        "/..%2f..%2f..%2f..%2fetc%2fpasswd",
        "/%2e%2e/%2e%2e/%2e%2e/etc/passwd",
        "/..\\..\\..\\etc\\passwd",
        "/..%5c..%5cetc%5cpasswd",
        "/assets/../../_messages.py",
        "//etc/passwd",
        "/%00/etc/passwd",
        "/index.html%00.js",
        "/%252e%252e/%252e%252e/etc/passwd",
        "/reports/..%2f..%2f..%2fetc%2fpasswd",
        "/reports/../index.html",
        "/reports/%00",
        "/documentation/..%2f..%2f..%2fconf.py",
        "/documentation/../conf.py",
        "/documentation//etc/passwd",
    ],
)
def test_no_path_leads_out_of_the_page(server: Server, path: str) -> None:
    port = server[0].get_port()
    head = f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nCookie: {cookie(server)}\r\n\r\n"
    answer = raw(server, head.encode())
    assert answer.split(b" ")[1] in (b"404", b"500")
    assert b"root:" not in answer
    assert b"import" not in answer


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "TRACE", "CONNECT", "HEAD", "\x16\x03\x01"])
def test_no_other_method_is_answered_with_the_page(server: Server, method: str) -> None:
    port = server[0].get_port()
    head = f"{method} / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nCookie: {cookie(server)}\r\nContent-Length: 3\r\n\r\nabc"
    answer = raw(server, head.encode("latin-1"))
    assert b" 200 " not in answer
    assert b"<html" not in answer


@pytest.mark.parametrize(
    "request_text",
    [
        b"GET / HTTP/1.0\r\nHost: 127.0.0.1\r\n\r\n",
        b"GET / HTTP/1.1\r\n\r\n",
        b"GET /\r\n\r\n",
        b"\r\n\r\n",
        b"\x00" * 100 + b"\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\n\r\n5\r\nhello\r\n0\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost : 127.0.0.1\r\n\r\n",
        b"GET / HTTP/1.1\nHost: a\n\nGET / HTTP/1.1\nHost: b\n\n",
    ],
)
def test_a_malformed_request_gets_no_page(server: Server, request_text: bytes) -> None:
    answer = raw(server, request_text)
    assert b" 200 " not in answer
    assert b"<html" not in answer
    assert get(server, token_path(server)).status == 200


@pytest.mark.parametrize("flood", [b"A" * 100_000, b"X: y\r\n" * 10_000, b"X: " + b"y" * 100_000])
def test_a_head_without_end_is_cut_off(server: Server, flood: bytes) -> None:
    answer = raw(server, b"GET / HTTP/1.1\r\n" + flood)
    assert answer == b"" or answer.split(b" ")[1] in (b"400", b"431", b"414")
    assert get(server, token_path(server)).status == 200


@pytest.mark.campaign
def test_half_open_requests_do_not_hold_up_the_page_and_are_closed(server: Server) -> None:
    port = server[0].get_port()
    with contextlib.ExitStack() as until_end:
        wires = [
            until_end.enter_context(contextlib.closing(socket.create_connection(("127.0.0.1", port), 30)))
            for _ in range(HALF_OPEN)
        ]
        for wire in wires:
            wire.sendall(b"GET / HTTP/1.1\r\nHost: ")
        began = time.perf_counter()
        assert get(server, token_path(server)).status == 200
        assert time.perf_counter() - began < 2.0
        for wire in wires:
            with contextlib.suppress(ConnectionError):
                wire.settimeout(30)
                while wire.recv(4096):
                    pass


def test_a_frame_larger_than_any_message_is_not_read(server: Server) -> None:
    with connected(server) as wire:
        with contextlib.suppress(ConnectionClosed):
            wire.send(bytes(MOST_FRAME_BYTES + 1))
        with pytest.raises(ConnectionClosed) as closed:
            receive_all(wire)
    assert closed.value.rcvd is None or closed.value.rcvd.code == 1009
    assert get(server, token_path(server)).status == 200


def test_a_request_to_share_the_page_through_a_tunnel_opens_none(server: Server, monkeypatch) -> None:
    opened: list[object] = []
    monkeypatch.setattr("viser._tunnel.ViserTunnel.__init__", lambda *args, **kwargs: opened.append(args))
    with connected(server) as wire:
        wire.send(msgspec.msgpack.encode(viser_messages.ShareUrlRequest().as_serializable_dict()))
        assert wire.ping().wait(10)
        time.sleep(0.2)
    assert opened == []


def test_a_client_of_another_version_is_turned_away(server: Server) -> None:
    port = server[0].get_port()
    with (
        websockets.sync.client.connect(
            f"ws://127.0.0.1:{port}",
            origin=f"http://127.0.0.1:{port}",  # pyright: ignore[reportArgumentType]
            additional_headers={"Cookie": cookie(server)},
            subprotocols=["viser-v0.0.1"],  # pyright: ignore[reportArgumentType]
        ) as wire,
        pytest.raises(ConnectionClosed) as closed,
    ):
        receive_all(wire)
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 1002


def test_a_token_is_compared_in_a_time_that_does_not_depend_on_it(server: Server, monkeypatch) -> None:
    compared: list[tuple[bytes, bytes]] = []
    in_constant_time = hmac.compare_digest

    def compare(given: bytes, own: bytes) -> bool:
        compared.append((given, own))
        return in_constant_time(given, own)

    monkeypatch.setattr(access_guard.hmac, "compare_digest", compare)
    right = server[1].address.partition("=")[2]
    wrong = right[:-1] + ("y" if right.endswith("x") else "x")
    assert get(server, f"/?token={wrong}").status == 401
    assert get(server, "/", Cookie=f"wafer_viewer_{server[0].get_port()}={wrong}").status == 401
    assert compared == [(wrong.encode(), right.encode())] * 2


def test_neither_log_nor_terminal_nor_an_answer_shows_the_token(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("WAFER_VIEWER_LOG", str(tmp_path / "viewer.log"))
    monkeypatch.setattr(log, "handlers", [])
    keep_log()
    with caplog.at_level(logging.DEBUG, logger="wafer_viewer"):
        opened = open_server("127.0.0.1", 0)
        token = opened[1].address.partition("=")[2]
        try:
            bad = f"/?token={token}&token={token}"
            answers = [get(opened, path) for path in (token_path(opened), bad, f"/nowhere?token={token}")]
            with connected(opened) as wire:
                wire.send(b"\xc1" + token.encode())
                with pytest.raises(ConnectionClosed):
                    receive_all(wire)
        finally:
            close_server(opened[0])
    assert [answer.status for answer in answers] == [200, 401, 404]
    for handler in log.handlers:
        handler.close()
    shown = "".join((*capfd.readouterr(), caplog.text, (tmp_path / "viewer.log").read_text()))
    assert token not in shown
    assert "A connection was closed" in shown


def test_the_token_is_in_no_page_and_leaves_with_no_link(server: Server) -> None:
    with contextlib.closing(http.client.HTTPConnection("127.0.0.1", server[0].get_port(), timeout=5)) as wire:
        wire.request("GET", token_path(server))
        answer = wire.getresponse()
        body = answer.read()
    assert server[1].address.partition("=")[2].encode() not in body
    assert answer.getheader("Referrer-Policy") == "no-referrer"


@pytest.mark.parametrize("header", ["X-Forwarded-Host", "X-Forwarded-For", "X-Original-URL", "Forwarded"])
def test_no_header_of_a_proxy_is_believed(server: Server, header: str) -> None:
    assert get(server, "/", **{header: "127.0.0.1"}).status == 401
    assert get(server, token_path(server), Host="evil.example", **{header: "127.0.0.1"}).status == 403


def test_two_viewers_of_one_machine_do_not_take_each_others_cookies(server: Server) -> None:
    other = open_server("127.0.0.1", 0)
    try:
        assert get(other, "/", Cookie=cookie(server)).status == 401
        assert get(server, "/", Cookie=f"{cookie(other)}; {cookie(server)}").status == 200
    finally:
        close_server(other[0])


def test_the_names_of_a_server_are_those_of_its_machine_only() -> None:
    guard = AccessGuard("lab.example", "secret")
    guard.bound_to(8080)
    connection = type("Connection", (), {"local_address": ("192.168.1.20", 8080)})()
    names = guard._names(connection)  # pyright: ignore[reportArgumentType]
    assert names == {f"{n}:8080" for n in ("127.0.0.1", "localhost", "[::1]", "lab.example", "192.168.1.20")}
