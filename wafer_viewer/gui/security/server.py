"""Web server of the page: guarded from its first request on, and tested before it is announced."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import http
import http.client
import io
import secrets
import ssl
import threading
from collections.abc import Generator
from typing import Any
from urllib.parse import urlsplit

import viser
import websockets.asyncio.server as websocket_server
from viser.infra import _infra
from viser.infra._async_message_buffer import AsyncMessageBuffer
from websockets.asyncio.server import ServerConnection

from wafer_viewer.gui.incoming import Handler, Uploads, checked, report_handler_faults
from wafer_viewer.gui.security.access_guard import AccessGuard, PlainAnswer
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.session.core.network_access import NetworkAccess, require_protected
from wafer_viewer.session.core.private_file import new_token

_HANDSHAKE_S = 10.0
"""Time limit of TLS, the same that websockets sets for the request after it."""
_patching = threading.Lock()


def open_server(
    host: str,
    port: int,
    token: str | None = None,
    network: NetworkAccess | None = None,
    script: str = "",
    shell: str = "",
) -> tuple[viser.ViserServer, AccessGuard]:
    """Open a viser server that is guarded from its first request on and cannot be shared through a tunnel.

    network: TLS and password, required for every host but loopback; script: what the page runs; shell: HTML of the page
    until it runs.

    Raises WaferViewerError if they are missing, or if the server answers a request without the token.
    """
    require_protected(host, network)
    guard = AccessGuard(host, token or new_token(), network, script, shell)
    wake_senders_on_their_loop()
    with _guarding(guard, network and network.certificate.context), _without_words():
        server = viser.ViserServer(host=host, port=port, verbose=False)
    guard.bound_to(server.get_port())
    try:
        require_refusals(guard.origin)
    except WaferViewerError:
        close_server(server)
        raise
    report_handler_faults(server)
    server.request_share_url = _no_tunnel
    return server, guard


def close_server(server: viser.ViserServer) -> None:
    """Stop a server."""
    with _without_words():
        server.stop()


def connection_of(server: viser.ViserServer, client_id: int) -> ServerConnection | None:
    """Return the connection of a browser; None if it has gone. Pinned to viser 1.1, which keeps it to itself."""
    return server._websock_server._live_connections.get(client_id)  # pyright: ignore[reportArgumentType]


def _without_words() -> contextlib.AbstractContextManager[object]:
    """Silence viser, which prints an address without the token at its start, and its own words at its end."""
    return contextlib.redirect_stdout(io.StringIO())


@contextlib.contextmanager
def _guarding(guard: AccessGuard, tls: ssl.SSLContext | None) -> Generator[None]:
    """Patch the guard into the websocket server that viser opens meanwhile; viser has no parameter for it."""
    plain = websocket_server.serve
    uploads = Uploads(lambda connection, upload: guard.refuse_upload(connection, upload))

    def serve(handle: Handler, *args: Any, process_request: PlainAnswer | None = None, **kwargs: Any) -> Any:
        if tls is not None:
            kwargs |= {"ssl": tls, "ssl_handshake_timeout": _HANDSHAKE_S}
        return plain(checked(handle, uploads), *args, process_request=guard.around(process_request), **kwargs)

    with _patching:
        websocket_server.serve = serve
        try:
            yield
        finally:
            websocket_server.serve = plain


def _no_tunnel(verbose: bool = True) -> None:
    """Refuse share requests, which a page could send although viser's share button is hidden."""


class LoopEvent(asyncio.Event):
    """Event that only its own event loop can set; elsewhere `set` does nothing."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__()
        self._own = loop

    def set(self) -> None:
        """Set the event, if called on its event loop."""
        if asyncio._get_running_loop() is self._own:
            super().set()


class LoopWokenBuffer(AsyncMessageBuffer):
    """Buffer of messages whose sender is woken on the event loop.

    viser's push sets an asyncio event twice, first on the pushing thread, then on the loop. The first is not thread-
    safe: it walks the list of waiters while the loop changes it, and raises *deque mutated during iteration* in the
    code that pushed, which leaves a page half built. The second alone wakes the sender.
    """

    def __init__(self, event_loop: asyncio.AbstractEventLoop, persistent_messages: bool) -> None:
        super().__init__(event_loop, persistent_messages)
        self.message_event = LoopEvent(event_loop)


def wake_senders_on_their_loop() -> None:
    """Let viser make such buffers, for the server and for every browser; it has no parameter for it."""
    _infra.AsyncMessageBuffer = LoopWokenBuffer  # type: ignore[misc]


PATIENCE_S = 10.0
"""Time limit of an answer; the server of this process answers within milliseconds."""
_REFUSED = http.HTTPStatus.UNAUTHORIZED
_TRUSTING = ssl._create_unverified_context()
"""The certificate is for others: nothing secret is sent, and whoever answers without a refusal is found out."""


def require_refusals(origin: str) -> None:
    """Raise WaferViewerError unless a page and a websocket are refused without the token.

    The guard is patched into a function that viser calls. With another version of viser or websockets the patch could
    have no effect, and the page would be open to every program of this machine.

    origin: address of the server without the token, ``http://HOST:PORT`` or ``https://HOST:PORT``.
    """
    for asked, headers in {"the page": {}, "a websocket": _handshake(origin)}.items():
        try:
            status = _status(origin, headers)
        except (OSError, http.client.HTTPException) as fault:
            raise WaferViewerError(
                f"The page did not start: its server at {origin} does not answer itself ({fault}). Choose another "
                "port with --port N, or look for a firewall on this machine."
            ) from fault
        if status != _REFUSED:
            raise WaferViewerError(
                f"The page did not start, because it would be open to everyone: the server answered a request for "
                f"{asked} without the token with {status} instead of {_REFUSED.value}. Reinstall the program together "
                f"with its dependencies (viser here is {viser.__version__})."
            )


def _status(origin: str, headers: dict[str, str]) -> int:
    """Return the status of the answer to a request with the page's own Host."""
    parts = urlsplit(origin)
    at = parts.hostname or "", parts.port
    plain = http.client.HTTPConnection(*at, timeout=PATIENCE_S)
    wire = http.client.HTTPSConnection(*at, timeout=PATIENCE_S, context=_TRUSTING) if parts.scheme == "https" else plain
    with contextlib.closing(wire):
        wire.request("GET", "/", headers=headers)
        return wire.getresponse().status


def _handshake(origin: str) -> dict[str, str]:
    """Return the headers with which the page itself opens its websocket, without the cookie."""
    return {
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Origin": origin,
        "Sec-WebSocket-Key": base64.b64encode(secrets.token_bytes(16)).decode(),
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Protocol": f"viser-v{viser.__version__}",
    }
