"""A browser without a picture: speaks with the page over its websocket, keeps its widgets, and presses buttons."""

from __future__ import annotations

import http.client
import re
import threading
import time
from contextlib import suppress
from typing import Any
from urllib.parse import urlsplit

import msgspec
import viser
import viser._messages as viser_messages
import websockets.sync.client
import zstandard
from websockets.exceptions import ConnectionClosed

_CAMERA = viser_messages.ViewerCameraMessage(
    wxyz=(1.0, 0.0, 0.0, 0.0),
    position=(0.0, 0.0, 1.0),
    fov=1.0,
    near=0.01,
    far=1000.0,
    image_height=1000,
    image_width=1600,
    look_at=(0.0, 0.0, 0.0),
    up_direction=(0.0, 0.0, 1.0),
)


class PlainBrowser:
    """One connection to the page at an address; messages are read on a thread, unless it never reads."""

    def __init__(self, address: str, *, reads: bool = True) -> None:
        parts = urlsplit(address)
        self._wire = websockets.sync.client.connect(
            f"ws://{parts.netloc}",
            origin=f"http://{parts.netloc}",  # pyright: ignore[reportArgumentType]
            additional_headers={"Cookie": _cookie(parts.netloc, f"{parts.path}?{parts.query}")},
            subprotocols=[f"viser-v{viser.__version__}"],  # pyright: ignore[reportArgumentType]
            max_size=None,
            ping_interval=None,  # a browser answers pings and sends none
        )
        self.widgets: dict[str, dict[str, Any]] = {}
        self.n_bytes, self._n_picks = 0, 0
        self._changed: dict[tuple[str, str], Any] = {}
        self._something = threading.Condition()
        self._reader = threading.Thread(target=self._read, daemon=True)
        if reads:
            self._reader.start()
        self.send(_CAMERA)

    def send(self, message: viser_messages.Message) -> None:
        self._wire.send(msgspec.msgpack.encode(message.as_serializable_dict()))

    def close(self) -> None:
        with suppress(ConnectionClosed, OSError):
            self._wire.close()

    def button(self, label: str) -> str | None:
        """Return the number of a button by its text, which may be a pattern; None if there is none."""
        with self._something:
            widgets = list(self.widgets.items())
        for uuid, widget in widgets:
            if widget["type"] == "GuiButtonMessage" and re.fullmatch(label, str(widget["props"].get("label"))):
                return uuid
        return None

    def is_ready(self, label: str) -> bool:
        """True if a button can be pressed."""
        uuid = self.button(label)
        return uuid is not None and not self.widgets[uuid]["props"].get("disabled")

    def press(self, label: str) -> None:
        if (uuid := self.button(label)) is None:
            raise LookupError(f"there is no button {label!r}")
        self.send(viser_messages.GuiUpdateMessage(uuid, {"value": True}))

    def pick(self, what: str, key: str = "") -> None:
        """Click what is drawn as HTML, by its word."""
        with self._something:
            field = next(u for u, w in self.widgets.items() if w["props"].get("label") == "picks")
        self._n_picks += 1
        text = msgspec.json.encode([[self._n_picks, what, key, 0]]).decode()
        self.send(viser_messages.GuiUpdateMessage(field, {"value": text}))

    def changes(self, label: str, most_s: float) -> dict[tuple[str, str], Any]:
        """Press a button, and return what it changes in some seconds: property of widget, and its value."""
        with self._something:
            self._changed = {}
        self.press(label)
        time.sleep(most_s)
        with self._something:
            return dict(self._changed)

    def answer_s(self, label: str, signs: dict[tuple[str, str], Any], most_s: float) -> float:
        """Press a button, and return the seconds until one of some properties has its value; infinite if none has."""
        with self._something:
            self._changed, begun = {}, time.perf_counter()
            self.press(label)
            came = self._something.wait_for(lambda: bool(signs.items() & self._visible().items()), most_s)
        return time.perf_counter() - begun if came else float("inf")

    def _visible(self) -> dict[tuple[str, str], Any]:
        """Return what became visible or hidden since the last press."""
        return {key: value for key, value in self._changed.items() if key[1] == "visible"}

    def _read(self) -> None:
        with suppress(ConnectionClosed, OSError, EOFError):
            while True:
                raw = self._wire.recv()
                assert isinstance(raw, bytes)
                messages = _messages(raw)
                with self._something:
                    for message in messages:
                        self._take(message)
                    self.n_bytes += len(raw)
                    self._something.notify_all()

    def _take(self, message: dict[str, Any]) -> None:
        kind = message["type"]
        if kind == "LocalStorageGetItemRequestMessage":
            answer = viser_messages.LocalStorageGetItemResponseMessage(None, None, message["request_uuid"])
            self.send(answer)
        elif kind == "GuiUpdateMessage":
            if message["uuid"] in self.widgets:
                self.widgets[message["uuid"]]["props"].update(message["updates"])
            for name, value in message["updates"].items():
                self._changed[message["uuid"], name] = value
        elif kind == "GuiRemoveMessage":
            self.widgets.pop(message["uuid"], None)
        elif kind.startswith("Gui") and "props" in message and "uuid" in message:
            self.widgets[message["uuid"]] = message


def _messages(raw: bytes) -> list[dict[str, Any]]:
    """Return the messages of a window of viser: sizes, then MessagePack compressed with zstd, then arrays."""
    size, packed = (int.from_bytes(raw[at : at + 8], "little") for at in (0, 8))
    text = zstandard.ZstdDecompressor().decompress(raw[16 : 16 + packed], max_output_size=size)
    return msgspec.msgpack.decode(text)["messages"]


def _cookie(place: str, path: str) -> str:
    connection = http.client.HTTPConnection(place)
    connection.request("GET", path)
    answer = connection.getresponse()
    answer.read()
    given = answer.getheader("Set-Cookie")
    connection.close()
    if given is None:
        raise ConnectionError("the page gives no cookie")
    return given.split(";")[0]
