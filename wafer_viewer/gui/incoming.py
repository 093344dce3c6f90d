"""Messages from browsers, read once before viser handles them.

viser hands whatever arrives to its decoder and its handlers, which print a traceback for what no page of this program
sends. A connection that sends such a message is closed, with one line in the log; its size is limited by viser, 50 MB.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from typing import Any

import viser
import viser._messages as viser_messages
from viser.infra import Message
from websockets.asyncio.server import ServerConnection

from wafer_viewer.model.errors import WaferViewerError, detail, parser_errors_as

MOST_UPLOAD_BYTES = 500_000_000
"""Largest file that a browser may send; it is twice in memory for a moment. Larger ones are opened by their path."""
_POLICY_VIOLATION = 1008
_LONGEST_REASON = 120
Handler = Callable[[ServerConnection], Awaitable[None]]
log = logging.getLogger(__name__)


def read_message(raw: bytes | str) -> Message:
    """Decode a message of a browser. Raises WaferViewerError for one that no page sends."""
    with parser_errors_as(lambda fault: WaferViewerError(f"A browser sent what is no message{detail(fault)}.")):
        if isinstance(raw, str):
            raise ValueError("a text")
        message = viser_messages.Message.deserialize(raw)
        if isinstance(message, viser_messages.FileTransferStartUpload):
            _require_modest(message)
    return message


def checked(handle: Handler) -> Handler:
    """Wrap the handler of a connection: it is closed after a message that no page sends."""

    async def handle_checked(connection: ServerConnection) -> None:
        receive = connection.recv

        async def receive_checked(*args: Any, **kwargs: Any) -> Any:
            raw = await receive(*args, **kwargs)
            read_message(raw)
            return raw

        connection.recv = receive_checked  # type: ignore[method-assign]
        try:
            await handle(connection)
        except WaferViewerError as fault:
            log.warning("A connection was closed: %s", fault)
            await connection.close(_POLICY_VIOLATION, str(fault)[:_LONGEST_REASON])

    return handle_checked


def report_handler_faults(server: viser.ViserServer) -> None:
    """Log a failure in a handler of messages as one line, for which asyncio would print a traceback."""

    def report(_: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        log.warning("A message of a browser was not handled: %r", context.get("exception") or context.get("message"))

    loop = server.get_event_loop()
    loop.call_soon_threadsafe(loop.set_exception_handler, report)


def _require_modest(upload: viser_messages.FileTransferStartUpload) -> None:
    """Raise WaferViewerError for a file that is too large; viser would hold all of it in memory."""
    n_bytes = upload.size_bytes
    if not 0 <= n_bytes <= MOST_UPLOAD_BYTES or not 0 <= upload.part_count <= max(1, n_bytes):
        raise WaferViewerError(
            f"A browser wanted to send {n_bytes / 1e6:.0f} MB, more than {MOST_UPLOAD_BYTES / 1e6:.0f} MB: "
            "copy the file to the data folder and open it there."
        )
