"""Messages from browsers, read once before viser handles them.

viser hands whatever arrives to its decoder and its handlers, which print a traceback for what no page of this program
sends. A connection that sends such a message is closed, with one line in the log; its size is limited by viser, 50 MB.
viser also holds every file that is being sent in memory, so their number and size are limited, and that of each part.
"""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

import viser
import viser._messages as viser_messages
from viser.infra import Message
from websockets.asyncio.server import ServerConnection

from wafer_viewer.model.errors import WaferViewerError, detail, parser_errors_as

MOST_UPLOAD_BYTES = 500_000_000
"""Largest file that a browser may send; it is twice in memory for a moment. Larger ones are opened by their path."""
MOST_UPLOADS = 4
"""Most files that may be on their way at once, from all browsers; together they are no larger than one may be."""
_POLICY_VIOLATION = 1008
_LONGEST_REASON = 120
Handler = Callable[[ServerConnection], Awaitable[None]]
UploadStart = viser_messages.FileTransferStartUpload
Refusal = Callable[[ServerConnection, UploadStart], bool]
"""Tells whether a file may not be sent by this connection; its page is told why."""
log = logging.getLogger(__name__)


def read_message(raw: bytes | str) -> Message:
    """Decode a message of a browser. Raises WaferViewerError for one that no page sends."""
    with parser_errors_as(lambda fault: WaferViewerError(f"A browser sent what is no message{detail(fault)}.")):
        if isinstance(raw, str):
            raise ValueError("a text")
        message = viser_messages.Message.deserialize(raw)
        if isinstance(message, UploadStart):
            _require_modest(message)
    return message


@dataclass(slots=True)
class _Transfer:
    """File on its way: what is still to come of it."""

    parts: int
    n_bytes: int
    whole_bytes: int


class Uploads:
    """Files on their way from all browsers of a server.

    refused: tells whether a connection may not send a file.
    """

    def __init__(self, refused: Refusal) -> None:
        self._refused = refused
        self._transfers: dict[tuple[ServerConnection, str], _Transfer] = {}
        self._lock = threading.Lock()

    def admits(self, connection: ServerConnection, message: Message) -> bool:
        """Return whether viser may handle a message; parts of a file that was not admitted are dropped.

        Raises WaferViewerError for files and parts that no page sends.
        """
        if isinstance(message, UploadStart):
            return not self._refused(connection, message) and self._start(connection, message)
        if isinstance(message, viser_messages.FileTransferPart):
            return self._continue((connection, message.transfer_uuid), len(message.content))
        return True

    def forget(self, connection: ServerConnection) -> None:
        """Forget the files of a connection that has ended; viser does the same."""
        with self._lock:
            self._transfers = {key: left for key, left in self._transfers.items() if key[0] is not connection}

    def _start(self, connection: ServerConnection, upload: UploadStart) -> bool:
        key = (connection, upload.transfer_uuid)
        with self._lock:
            coming = sum(transfer.whole_bytes for transfer in self._transfers.values())
            if key in self._transfers or len(self._transfers) >= MOST_UPLOADS:
                raise WaferViewerError(f"A browser wanted to send more than {MOST_UPLOADS} files at once.")
            if coming + upload.size_bytes > MOST_UPLOAD_BYTES:
                raise WaferViewerError(f"Browsers wanted to send more than {MOST_UPLOAD_BYTES / 1e6:.0f} MB at once.")
            if upload.part_count:
                self._transfers[key] = _Transfer(upload.part_count, upload.size_bytes, upload.size_bytes)
        return True

    def _continue(self, key: tuple[ServerConnection, str], n_bytes: int) -> bool:
        with self._lock:
            transfer = self._transfers.get(key)
            if transfer is None:
                return False
            transfer.parts -= 1
            transfer.n_bytes -= n_bytes
            if transfer.parts == 0:
                del self._transfers[key]
            if transfer.n_bytes < 0 or (transfer.parts == 0 and transfer.n_bytes):
                raise WaferViewerError("A browser sent a file of another size than it had named.")
        return True


def checked(handle: Handler, uploads: Uploads) -> Handler:
    """Wrap the handler of a connection: it is closed after a message that no page sends."""

    async def handle_checked(connection: ServerConnection) -> None:
        receive = connection.recv

        async def receive_checked(*args: Any, **kwargs: Any) -> Any:
            while True:
                raw = await receive(*args, **kwargs)
                if uploads.admits(connection, read_message(raw)):
                    return raw

        connection.recv = receive_checked  # type: ignore[method-assign]
        try:
            await handle(connection)
        except WaferViewerError as fault:
            log.warning("A connection was closed: %s", fault)
            await connection.close(_POLICY_VIOLATION, str(fault)[:_LONGEST_REASON])
        finally:
            uploads.forget(connection)

    return handle_checked


def report_handler_faults(server: viser.ViserServer) -> None:
    """Log a failure in a handler of messages as one line, for which asyncio would print a traceback."""

    def report(_: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        log.warning("A message of a browser was not handled: %r", context.get("exception") or context.get("message"))

    loop = server.get_event_loop()
    loop.call_soon_threadsafe(loop.set_exception_handler, report)


def _require_modest(upload: UploadStart) -> None:
    """Raise WaferViewerError for a file that is too large; viser would hold all of it in memory."""
    n_bytes = upload.size_bytes
    if not 0 <= n_bytes <= MOST_UPLOAD_BYTES or not 0 <= upload.part_count <= max(1, n_bytes):
        raise WaferViewerError(
            f"A browser wanted to send {n_bytes / 1e6:.0f} MB, more than {MOST_UPLOAD_BYTES / 1e6:.0f} MB: "
            "copy the file to the data folder and open it there."
        )
