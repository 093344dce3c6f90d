"""A slow connection between a browser and the viewer: passes bytes on no faster than it is told to.

The viewer checks by which name it is asked for; names are rewritten on the way, so both ports need as many digits.
"""

from __future__ import annotations

import socket
import threading
import time
from contextlib import suppress
from urllib.parse import urlsplit

_CHUNK, _BUFFER = 8192, 32_768


class SlowLine:
    """Listens on a port of its own; `address` is the viewer's by that way. `passed`: bytes that came through."""

    def __init__(self, address: str, bytes_per_s: float) -> None:
        there = urlsplit(address)
        self._there, self.bytes_per_s, self.passed = (there.hostname or "", there.port or 0), bytes_per_s, 0
        self._listener = _listener(len(str(there.port)))
        here = self._listener.getsockname()[1]
        self._names = f":{here}".encode(), f":{there.port}".encode()
        self.address = address.replace(f":{there.port}", f":{here}")
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        """Take no more connections."""
        self._listener.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                browser, _ = self._listener.accept()
                threading.Thread(target=self._carry, args=(browser,), daemon=True).start()

    def _carry(self, browser: socket.socket) -> None:
        """One connection, until both ends have closed it."""
        here, there = self._names
        with browser, socket.socket() as viewer:
            viewer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
            viewer.connect(self._there)
            asking = threading.Thread(target=self._pass_on, args=(browser, viewer, here, there, False), daemon=True)
            asking.start()
            self._pass_on(viewer, browser, there, here, True)
            asking.join()

    def _pass_on(self, source: socket.socket, sink: socket.socket, name: bytes, other: bytes, slow: bool) -> None:
        first = True
        with suppress(OSError):
            while data := source.recv(_CHUNK):
                sink.sendall(data.replace(name, other) if first else data)
                first = False
                if slow:
                    self.passed += len(data)
                    time.sleep(len(data) / self.bytes_per_s)
        for end in (source, sink):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)


def _listener(digits: int) -> socket.socket:
    """On a free port of so many digits."""
    while True:
        made = socket.create_server(("127.0.0.1", 0))
        if len(str(made.getsockname()[1])) == digits:
            return made
        made.close()
