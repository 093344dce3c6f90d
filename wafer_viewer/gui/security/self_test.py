"""Self-test of the guard: the server asks its own page without a token, and must be refused.

The guard is patched into a function that viser calls. With another version of viser or websockets the patch could have
no effect, and the page would be open to every program of this machine.
"""

from __future__ import annotations

import base64
import contextlib
import http
import http.client
import secrets
import ssl
from urllib.parse import urlsplit

import viser

from wafer_viewer.model.errors import WaferViewerError

PATIENCE_S = 10.0
"""Time limit of an answer; the server of this process answers within milliseconds."""
_REFUSED = http.HTTPStatus.UNAUTHORIZED
_TRUSTING = ssl._create_unverified_context()
"""The certificate is for others: nothing secret is sent, and whoever answers without a refusal is found out."""


def require_refusals(origin: str) -> None:
    """Raise WaferViewerError unless a page and a websocket are refused without the token.

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
