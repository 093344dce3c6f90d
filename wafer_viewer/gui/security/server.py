"""Web server of the page: guarded from its first request on, and tested before it is announced."""

from __future__ import annotations

import contextlib
import io
import ssl
import threading
from collections.abc import Generator
from typing import Any

import viser
import websockets.asyncio.server as websocket_server
from websockets.asyncio.server import ServerConnection

from wafer_viewer.gui.incoming import Handler, Uploads, checked, report_handler_faults
from wafer_viewer.gui.message_wakeup import wake_senders_on_their_loop
from wafer_viewer.gui.security.access_guard import AccessGuard, PlainAnswer
from wafer_viewer.gui.security.self_test import require_refusals
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.session.core.network_access import NetworkAccess, require_protected
from wafer_viewer.session.core.page_token import new_token

_HANDSHAKE_S = 10.0
"""Time limit of TLS, the same that websockets sets for the request after it."""
_patching = threading.Lock()


def open_server(
    host: str, port: int, token: str | None = None, network: NetworkAccess | None = None, script: str = ""
) -> tuple[viser.ViserServer, AccessGuard]:
    """Open a viser server that is guarded from its first request on and cannot be shared through a tunnel.

    network: TLS and password, required for every host but loopback; script: what the page runs.

    Raises WaferViewerError if they are missing, or if the server answers a request without the token.
    """
    require_protected(host, network)
    guard = AccessGuard(host, token or new_token(), network, script)
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
