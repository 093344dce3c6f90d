"""Files that a browser sends, pressed onto the server by a client that keeps to no rule."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator

import msgspec
import pytest
import viser
import viser._messages as viser_messages
import websockets.sync.client
from websockets.exceptions import ConnectionClosed

from tests.gui.security.test_access_guard import Server, connected, receive_all
from wafer_viewer.gui.incoming import MOST_UPLOAD_BYTES, MOST_UPLOADS
from wafer_viewer.gui.security.server import close_server, open_server

Client = websockets.sync.client.ClientConnection


class Pages:
    """Upload buttons of the pages, and what arrived through them."""

    def __init__(self, server: viser.ViserServer) -> None:
        self.files: list[tuple[str, bytes]] = []
        self.clients: list[viser.ClientHandle] = []
        self.buttons: list[str] = []
        server.on_client_connect(self._build)

    def _build(self, client: viser.ClientHandle) -> None:
        button = client.gui.add_upload_button("Send")
        button.on_upload(lambda event: self.files.append((event.target.value.name, event.target.value.content)))
        self.clients.append(client)
        self.buttons.append(button._impl.uuid)

    @property
    def held(self) -> int:
        """Files on their way that viser holds in memory."""
        return sum(len(client.gui._current_file_upload_states) for client in self.clients)


@pytest.fixture
def server() -> Iterator[Server]:
    opened = open_server("127.0.0.1", 0)
    yield opened
    close_server(opened[0])


@pytest.fixture
def pages(server: Server) -> Pages:
    return Pages(server[0])


@contextlib.contextmanager
def browser(server: Server, pages: Pages) -> Iterator[tuple[Client, str]]:
    """A connection that has a page, and the key of its upload button."""
    n_before = len(pages.buttons)
    with connected(server) as wire:
        zero, up = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
        camera = viser_messages.ViewerCameraMessage((1.0, *zero), zero, 1.0, 0.1, 10.0, 300, 400, up, up)
        wire.send(msgspec.msgpack.encode(camera.as_serializable_dict()))
        assert eventually(lambda: len(pages.buttons) > n_before)
        yield wire, pages.buttons[-1]


def start(wire: Client, uuid: str, transfer: str, n_bytes: int, parts: int = 1, name: str = "scan.csv") -> None:
    message = viser_messages.FileTransferStartUpload(uuid, transfer, name, "text/csv", parts, n_bytes)
    wire.send(msgspec.msgpack.encode(message.as_serializable_dict()))


def part(wire: Client, uuid: str, transfer: str, content: bytes, index: int = 0) -> None:
    raw = {"type": "FileTransferPart", "source_component_uuid": uuid, "transfer_uuid": transfer}
    wire.send(msgspec.msgpack.encode(raw | {"part_index": index, "content": content}))


def eventually(done: Callable[[], bool]) -> bool:
    until = time.monotonic() + 10.0
    while not done() and time.monotonic() < until:
        time.sleep(0.01)
    return done()


def closed_with(wire: Client) -> str:
    """The reason for which the connection is closed."""
    with pytest.raises(ConnectionClosed) as closed:
        receive_all(wire)
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 1008
    return closed.value.rcvd.reason


def answered(wire: Client) -> bool:
    """Whether the server has handled all that was sent before."""
    return wire.ping().wait(10)


def send(wire: Client, uuid: str, transfer: str) -> None:
    start(wire, uuid, transfer, 3)
    part(wire, uuid, transfer, b"abc")


def test_a_file_arrives_in_parts(server: Server, pages: Pages) -> None:
    with browser(server, pages) as (wire, uuid):
        start(wire, uuid, "a", 6, parts=2)
        part(wire, uuid, "a", b"abc", 0)
        part(wire, uuid, "a", b"def", 1)
        assert eventually(lambda: pages.files == [("scan.csv", b"abcdef")])


def test_a_file_of_one_who_may_not_send_is_dropped_part_by_part(server: Server, pages: Pages) -> None:
    asked: list[str] = []

    def refuse(connection: object, upload: viser_messages.FileTransferStartUpload) -> bool:
        asked.append(upload.filename)
        return True

    server[1].refuse_upload = refuse
    with browser(server, pages) as (wire, uuid):
        send(wire, uuid, "a")
        start(wire, uuid, "b", 0, parts=0, name="empty.csv")
        assert eventually(lambda: len(asked) == 2)
        assert answered(wire)
        assert (asked, pages.held, pages.files) == (["scan.csv", "empty.csv"], 0, [])
        server[1].refuse_upload = lambda connection, upload: False
        send(wire, uuid, "c")
        assert eventually(lambda: pages.files == [("scan.csv", b"abc")])


def test_parts_of_no_file_are_dropped(server: Server, pages: Pages) -> None:
    with browser(server, pages) as (wire, uuid):
        part(wire, uuid, "never started", b"x" * 1000)
        assert answered(wire)
        assert pages.held == 0


@pytest.mark.parametrize("contents", [[b"abcdef"], [b"a", b"b"], [b"abc", b"abcd"]])
def test_a_file_of_another_size_than_announced_closes_the_connection(server: Server, pages: Pages, contents) -> None:
    with browser(server, pages) as (wire, uuid):
        start(wire, uuid, "a", 5, parts=2 if len(contents) == 2 else 5)
        for index, content in enumerate(contents):
            part(wire, uuid, "a", content, index)
        assert "another size than it had named" in closed_with(wire)
    assert eventually(lambda: pages.held == 0)
    assert pages.files == []


def test_only_so_many_files_are_on_their_way_at_once(server: Server, pages: Pages) -> None:
    with browser(server, pages) as (wire, uuid):
        for k in range(MOST_UPLOADS + 1):
            start(wire, uuid, f"{k}", 10)
        assert f"more than {MOST_UPLOADS} files at once" in closed_with(wire)
    assert eventually(lambda: pages.held == 0)
    with browser(server, pages) as (wire, uuid):  # those of the connection that has gone do not count
        send(wire, uuid, "again")
        assert eventually(lambda: pages.files == [("scan.csv", b"abc")])


def test_files_of_all_browsers_together_are_no_larger_than_one_may_be(server: Server, pages: Pages) -> None:
    with browser(server, pages) as (first, uuid), browser(server, pages) as (second, other):
        start(first, uuid, "a", MOST_UPLOAD_BYTES - 10, parts=100)
        assert eventually(lambda: pages.held == 1)
        start(second, other, "b", 11)
        assert "more than 500 MB at once" in closed_with(second)
        assert answered(first)


def test_a_file_that_begins_twice_closes_the_connection(server: Server, pages: Pages) -> None:
    with browser(server, pages) as (wire, uuid):
        for _ in range(2):
            start(wire, uuid, "a", 10)
        assert closed_with(wire)


def test_a_browser_that_goes_in_the_middle_leaves_nothing(server: Server, pages: Pages) -> None:
    with browser(server, pages) as (wire, uuid):
        start(wire, uuid, "a", MOST_UPLOAD_BYTES, parts=100)
        part(wire, uuid, "a", b"x" * 1000)
        assert eventually(lambda: pages.held == 1)
    assert eventually(lambda: pages.held == 0)
    with browser(server, pages) as (wire, uuid):
        send(wire, uuid, "b")
        assert eventually(lambda: pages.files == [("scan.csv", b"abc")])
