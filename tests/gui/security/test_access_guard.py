"""The guard of the page, asked over the wire as browsers and others would."""

from __future__ import annotations

import contextlib
import http.client
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import msgspec
import pytest
import viser
import viser._messages as viser_messages
import websockets.sync.client
from websockets.exceptions import ConnectionClosedError, InvalidStatus

from wafer_viewer.gui.security.access_guard import AccessGuard
from wafer_viewer.gui.security.server import open_server
from wafer_viewer.session.core.private_file import new_token
from wafer_viewer.session.files.file_jobs import read_report

Server = tuple[viser.ViserServer, AccessGuard]


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    opened, guard = open_server("127.0.0.1", 0)
    yield opened, guard
    opened.stop()


def get(server: Server, path: str = "/", **headers: str) -> http.client.HTTPResponse:
    with contextlib.closing(http.client.HTTPConnection("127.0.0.1", server[0].get_port(), timeout=5)) as wire:
        wire.request("GET", path, headers=headers)
        answer = wire.getresponse()
        answer.read()
        return answer


def token_path(server: Server) -> str:
    parts = urlsplit(server[1].address)
    return f"{parts.path}?{parts.query}"


def cookie(server: Server) -> str:
    given = get(server, token_path(server)).getheader("Set-Cookie")
    assert given is not None
    return given.split(";")[0]


def socket_status(server: Server, **headers: str) -> int:
    """101 when the socket opens, else the status it was refused with."""
    port = server[0].get_port()
    origin = headers.pop("Origin", None)
    try:
        with websockets.sync.client.connect(
            f"ws://127.0.0.1:{port}",
            origin=origin,  # pyright: ignore[reportArgumentType]
            additional_headers=headers,
            subprotocols=[f"viser-v{viser.__version__}"],  # pyright: ignore[reportArgumentType]
        ):
            return 101
    except InvalidStatus as refused:
        return refused.response.status_code


def test_the_printed_address_opens_the_page_and_leaves_a_cookie_scripts_cannot_read(server: Server) -> None:
    answer = get(server, token_path(server))
    assert answer.status == 200
    assert answer.getheader("Content-Type", "").startswith("text/html")
    given = answer.getheader("Set-Cookie", "")
    assert "HttpOnly" in given
    assert "SameSite=Strict" in given


def test_the_cookie_alone_opens_the_page_afterwards(server: Server) -> None:
    assert get(server, "/", Cookie=cookie(server)).status == 200


@pytest.mark.parametrize("path", ["/", "/?token=", "/?token=wrong", "/assets/x.js", "/?token=a&token=b"])
def test_without_the_token_nothing_is_served(server: Server, path: str) -> None:
    answer = get(server, path)
    assert answer.status == 401
    assert answer.getheader("Set-Cookie") is None


def test_a_token_or_cookie_of_odd_bytes_is_refused_like_any_other(server: Server) -> None:
    port = server[0].get_port()
    for path, header in ((b"/?token=\xff\xfe", b""), (b"/", b"Cookie: wafer_viewer_%d=\xff\r\n" % port)):
        with contextlib.closing(socket.create_connection(("127.0.0.1", port), 5)) as wire:
            wire.sendall(b"GET %s HTTP/1.1\r\nHost: 127.0.0.1:%d\r\n%s\r\n" % (path, port, header))
            assert wire.recv(64).startswith(b"HTTP/1.1 401")


def test_reports_are_served_to_who_may_open_the_page_and_no_other_file_is(server: Server, tmp_path: Path) -> None:
    (tmp_path / "W7-report-1.html").write_text("<h1>W7</h1>")
    (tmp_path / "W7.html").write_text("not a report")
    (tmp_path.parent / "up-report-1.html").write_text("of another folder")
    server[1].report = lambda name: read_report(name, (tmp_path / "gone", tmp_path))
    try:
        assert get(server, "/reports/W7-report-1.html").status == 401
        answer = get(server, "/reports/W7-report-1.html", Cookie=cookie(server))
        assert (answer.status, answer.getheader("Content-Length")) == (200, "11")
        policy = answer.getheader("Content-Security-Policy", "")
        assert policy.startswith("default-src 'none';")
        assert "script" not in policy
        assert answer.getheader("Content-Type") == "text/html; charset=utf-8"
        (tmp_path / "W7-report-2.pdf").write_bytes(b"%PDF-1.4")
        printed = get(server, "/reports/W7-report-2.pdf", Cookie=cookie(server))
        assert (printed.status, printed.getheader("Content-Type")) == (200, "application/pdf")
        for name in ("W7.html", "W7-report-2.html", "..%2Fup-report-1.html", "../up-report-1.html", ""):
            assert get(server, f"/reports/{name}", Cookie=cookie(server)).status == 404
    finally:
        server[1].report = lambda name: None


def test_the_documentation_is_served_to_who_may_open_the_page(server: Server, tmp_path: Path) -> None:
    (tmp_path / "index.html").write_text("<h1>Read me</h1>")
    (tmp_path / "theme.css").write_text("h1 {}")
    (tmp_path.parent / "secret.html").write_text("of another folder")
    files = {"index.html": tmp_path / "index.html", "_static/theme.css": tmp_path / "theme.css"}
    server[1].documentation = lambda: files
    try:
        assert get(server, "/documentation/index.html").status == 401
        answer = get(server, "/documentation/index.html", Cookie=cookie(server))
        assert (answer.status, answer.getheader("Content-Type")) == (200, "text/html")
        assert "connect-src 'none'" in answer.getheader("Content-Security-Policy", "")
        style = get(server, "/documentation/_static/theme.css?v=1", Cookie=cookie(server))
        assert (style.status, style.getheader("Content-Type")) == (200, "text/css")
        for name in ("", "theme.css", "..%2fsecret.html", "../secret.html"):
            assert get(server, f"/documentation/{name}", Cookie=cookie(server)).status == 404
    finally:
        server[1].documentation = dict


def test_a_cookie_of_another_viewer_is_none(server: Server) -> None:
    other = f"wafer_viewer_1={cookie(server).split('=')[1]}"
    assert get(server, "/", Cookie=other).status == 401


@pytest.mark.parametrize(
    "name", ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "localhost.evil:{port}"]
)
def test_a_foreign_host_is_refused_even_with_the_token(server: Server, name: str) -> None:
    host = name.format(port=server[0].get_port())
    assert get(server, token_path(server), Host=host).status == 403


def test_localhost_is_this_server_too(server: Server) -> None:
    assert get(server, token_path(server), Host=f"localhost:{server[0].get_port()}").status == 200


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "https://127.0.0.1:{port}", "http://127.0.0.1:1"])
def test_a_foreign_origin_is_refused_even_with_the_cookie(server: Server, origin: str) -> None:
    foreign = origin.format(port=server[0].get_port())
    assert get(server, "/", Cookie=cookie(server), Origin=foreign).status == 403
    assert socket_status(server, Cookie=cookie(server), Origin=foreign) == 403


def test_the_socket_opens_for_the_page_only(server: Server) -> None:
    own = f"http://127.0.0.1:{server[0].get_port()}"
    assert socket_status(server, Cookie=cookie(server), Origin=own) == 101
    assert socket_status(server, Cookie=cookie(server)) == 403
    assert socket_status(server, Origin=own) == 401


def test_two_hosts_in_one_request_are_a_bad_request(server: Server) -> None:
    port = server[0].get_port()
    with contextlib.closing(socket.create_connection(("127.0.0.1", port), 5)) as wire:
        wire.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nHost: evil.example\r\n\r\n".encode())
        assert wire.recv(64).startswith(b"HTTP/1.1 400")


def test_every_answer_keeps_the_page_to_itself(server: Server) -> None:
    for answer, source in ((get(server, token_path(server)), "self"), (get(server), "none")):
        policy = answer.getheader("Content-Security-Policy", "")
        assert "frame-ancestors 'none'" in policy
        assert f"default-src '{source}'" in policy
        assert answer.getheader("X-Content-Type-Options") == "nosniff"
        assert answer.getheader("Referrer-Policy") == "no-referrer"


def test_no_share_tunnel_can_be_opened(server: Server) -> None:
    before = threading.active_count()
    assert server[0].request_share_url() is None
    assert threading.active_count() == before


def test_a_restart_with_the_same_token_and_port_lets_the_open_page_in_again() -> None:
    token = new_token()
    opened, guard = open_server("127.0.0.1", 0, token)
    stored, port = cookie((opened, guard)), opened.get_port()
    opened.stop()
    again = open_server("127.0.0.1", port, token)
    try:
        assert again[1].address == guard.address
        own = f"http://127.0.0.1:{port}"
        assert socket_status(again, Cookie=stored, Origin=own) == 101
    finally:
        again[0].stop()


def test_a_server_opened_meanwhile_by_others_is_left_alone() -> None:
    import websockets.asyncio.server as plain

    before = plain.serve
    opened, _ = open_server("127.0.0.1", 0)
    try:
        assert plain.serve is before
    finally:
        opened.stop()


def connected(server: Server) -> websockets.sync.client.ClientConnection:
    """An open connection of a browser that may use the page."""
    port = server[0].get_port()
    return websockets.sync.client.connect(
        f"ws://127.0.0.1:{port}",
        origin=f"http://127.0.0.1:{port}",  # pyright: ignore[reportArgumentType]
        additional_headers={"Cookie": cookie(server)},
        subprotocols=[f"viser-v{viser.__version__}"],  # pyright: ignore[reportArgumentType]
        max_size=None,
    )


def receive_all(wire: websockets.sync.client.ClientConnection) -> None:
    """Receive until the connection is closed."""
    while True:
        wire.recv(timeout=5)


def upload(n_bytes: int) -> bytes:
    start = viser_messages.FileTransferStartUpload("button", "transfer", "scan.csv", "text/csv", 3, n_bytes)
    return msgspec.msgpack.encode(start.as_serializable_dict())


@pytest.mark.parametrize(
    "message",
    [
        "a text",
        b"",
        b"\xc1\xff",
        msgspec.msgpack.encode({"type": "NoSuchMessage"}),
        msgspec.msgpack.encode({"type": "GuiUpdateMessage"}),
        msgspec.msgpack.encode({"type": "ViewerCameraMessage", "fov": "wide"}),
        b"\x91" * 100_000,
        upload(1_200_000_000),
        upload(-1),
    ],
)
def test_a_message_that_no_page_sends_closes_its_connection_with_one_line(server: Server, message, caplog, capfd):
    with caplog.at_level("WARNING"), connected(server) as wire:
        wire.send(message)
        with pytest.raises(ConnectionClosedError) as closed:
            receive_all(wire)
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 1008
    assert [r.getMessage().startswith("A connection was closed: A browser") for r in caplog.records] == [True]
    assert "Traceback" not in caplog.text + "".join(capfd.readouterr())
    assert socket_status(server, Origin=f"http://127.0.0.1:{server[0].get_port()}", Cookie=cookie(server)) == 101


@pytest.mark.slow
def test_a_message_that_a_handler_cannot_take_is_one_line_and_the_connection_stays(server: Server, caplog, capfd):
    number = server[0].gui.add_number("Number", 1.5)
    typed = {"type": "GuiUpdateMessage", "uuid": number._impl.uuid, "updates": {"value": "no number"}}
    with caplog.at_level("WARNING"), connected(server) as wire:
        wire.send(msgspec.msgpack.encode(typed))
        with contextlib.suppress(TimeoutError):
            while "was not handled" not in caplog.text:
                wire.recv(timeout=0.5)
        assert wire.ping().wait(5)
    assert "A message of a browser was not handled: ValueError" in caplog.text
    assert "Traceback" not in caplog.text + "".join(capfd.readouterr())
