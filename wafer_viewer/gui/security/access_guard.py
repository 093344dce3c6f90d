"""Access control: only browsers that were given the address, and no foreign web pages.

viser answers every request and accepts any Origin. Each request is checked before viser sees it:
its Host must be this server (a rebound name is not), its Origin this page (a foreign page's script is not), and it
must bring the token, once in the printed address and from then on in a cookie that scripts cannot read.
"""

from __future__ import annotations

import contextlib
import hmac
import http
import http.cookies
from collections.abc import Callable
from urllib.parse import parse_qs, unquote, urlsplit

from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers, MultipleValuesError
from websockets.http11 import Request, Response

Answer = Callable[[ServerConnection, Request], Response | None]

_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
_EVERYWHERE = ("0.0.0.0", "::", "")
_REPORTS = "/reports/"
_HTTP_PORT = 80
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self' ws://{host} data: blob:; "
    "worker-src 'self' blob:; object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Content security policy with the permissions that viser's page needs: eval, textures and workers from blobs."""
_NO_TOKEN = (
    "This page opens with the address that the program printed when it started: it ends in ?token=... "
    "Copy the whole of it from the terminal.\n"
)


class AccessGuard:
    """Request checks of one server, and the address that passes them."""

    def __init__(self, host: str, token: str) -> None:
        self._host = host
        self._token = token
        self.report: Callable[[str], bytes | None] = lambda name: None
        """Bytes of a report by name, served under /reports/NAME to authorised browsers; None if missing."""
        self._port = 0

    @property
    def origin(self) -> str:
        """Address of the page without the token."""
        host = "127.0.0.1" if self._host in _EVERYWHERE else self._host
        return f"http://{host}:{self._port}"

    @property
    def address(self) -> str:
        """Address with the token, to be printed."""
        return f"{self.origin}/?token={self._token}"

    def refusal(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return the response to a refused request, or None if it is allowed."""
        try:
            host, origin = request.headers["Host"], request.headers.get("Origin")
            is_socket = "Upgrade" in request.headers
        except (KeyError, MultipleValuesError):
            return _text(http.HTTPStatus.BAD_REQUEST, "A request names one Host.\n")
        if host.lower() not in self._names(connection):
            return _text(http.HTTPStatus.FORBIDDEN, "This server does not go by that name.\n")
        if (origin is None and is_socket) or (origin is not None and origin.lower() != f"http://{host.lower()}"):
            return _text(http.HTTPStatus.FORBIDDEN, "Another page may not use this one.\n")
        if not (self._has_cookie(request) or self._has_token(request)):
            return _text(http.HTTPStatus.UNAUTHORIZED, _NO_TOKEN)
        return None

    def around(self, answer: Answer | None) -> Answer:
        """Wrap viser's handler with the checks, the cookie and the security headers."""

        def guarded(connection: ServerConnection, request: Request) -> Response | None:
            response = self.refusal(connection, request)
            if response is None:
                response = self._reported(request)
            if response is None and answer is not None:
                response = answer(connection, request)
                if response is not None and self._has_token(request):
                    response.headers["Set-Cookie"] = self._cookie()
            if response is not None:
                _harden(response.headers, request.headers.get_all("Host"))
            return response

        return guarded

    def _reported(self, request: Request) -> Response | None:
        """Return the response to a request for a report; None for other requests."""
        path = unquote(urlsplit(request.path).path)
        if not path.startswith(_REPORTS):
            return None
        body = self.report(path.removeprefix(_REPORTS))
        if body is None:
            return _text(http.HTTPStatus.NOT_FOUND, "There is no such report: write it again from the page.\n")
        headers = Headers({"Content-Type": "text/html; charset=utf-8", "Content-Length": str(len(body))})
        return Response(http.HTTPStatus.OK.value, http.HTTPStatus.OK.phrase, headers, body)

    def bound_to(self, port: int) -> None:
        """Set the port once it is known."""
        self._port = port

    def _names(self, connection: ServerConnection) -> set[str]:
        """Return the valid Host values: loopback, the configured host, the local address of the connection."""
        local = connection.local_address
        port = int(local[1]) if local else self._port
        names = {*_LOOPBACK, self._host.lower(), str(local[0]).lower() if local else ""} - set(_EVERYWHERE)
        return {f"{name}:{port}" for name in names} | (names if port == _HTTP_PORT else set())

    def _cookie_name(self) -> str:
        # Cookies do not know ports: two viewers on one machine would overwrite each other's.
        return f"wafer_viewer_{self._port}"

    def _cookie(self) -> str:
        return f"{self._cookie_name()}={self._token}; Path=/; HttpOnly; SameSite=Strict"

    def _has_cookie(self, request: Request) -> bool:
        for header in request.headers.get_all("Cookie"):
            with contextlib.suppress(http.cookies.CookieError):
                morsel = http.cookies.SimpleCookie(header).get(self._cookie_name())
                if morsel is not None and self._is_token(morsel.value):
                    return True
        return False

    def _has_token(self, request: Request) -> bool:
        given = parse_qs(urlsplit(request.path).query).get("token", [])
        return len(given) == 1 and self._is_token(given[0])

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), self._token.encode())


def _text(status: http.HTTPStatus, text: str) -> Response:
    body = text.encode()
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))})
    return Response(status.value, status.phrase, headers, body)


def _harden(headers: Headers, hosts: list[str]) -> None:
    headers["Content-Security-Policy"] = _POLICY.format(host=hosts[0] if len(hosts) == 1 else "")
    headers["X-Content-Type-Options"] = "nosniff"
    headers["Referrer-Policy"] = "no-referrer"
    headers["Cross-Origin-Opener-Policy"] = "same-origin"
    headers["Cross-Origin-Resource-Policy"] = "same-origin"
