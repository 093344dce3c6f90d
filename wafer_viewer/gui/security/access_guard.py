"""Access control: only browsers that were given the address, and no foreign web pages.

viser answers every request and accepts any Origin. Each request is checked before viser sees it:
its Host must be this server (a rebound name is not), its Origin this page (a foreign page's script is not), and it
must bring the token, once in the printed address and from then on in a cookie that scripts cannot read.

The server of websockets answers requests without a body only, so the form sends the password as HTTP's basic
credentials, in a header.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
import contextlib
import hashlib
import hmac
import http
import http.cookies
import logging
import mimetypes
import secrets
import socket
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from urllib.parse import parse_qs, unquote, urlsplit

import viser
from markupsafe import Markup
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers, MultipleValuesError
from websockets.http11 import Request, Response

from wafer_viewer.gui.incoming import Refusal
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.report import PRINTED
from wafer_viewer.session.core.network_access import EVERY_ADDRESS, LOOPBACK, NetworkAccess
from wafer_viewer.session.core.private_file import WINDOW_S, AttemptLimit, PasswordHash

# ---------------------------------------------------------------------------------------------------------------- login


LOGIN_PATH = "/login"
_STYLE = (
    "body{font:16px system-ui,sans-serif;background:#16191d;color:#e6e9ec;display:grid;place-items:center;height:95vh}"
    "form{display:grid;gap:12px;width:300px}input,button{font:inherit;padding:8px}h1{font-size:20px;margin:0}"
    "p{margin:0;min-height:1.5em;color:#ffb4a8}"
)
_SCRIPT = """
const form = document.querySelector("form"), told = document.querySelector("p");
form.addEventListener("submit", async event => {
  event.preventDefault();
  const bytes = new TextEncoder().encode(":" + form.password.value);
  const credentials = btoa(String.fromCharCode(...bytes));
  form.button.disabled = true;
  try {
    const answer = await fetch("/login", {headers: {Authorization: "Basic " + credentials}, cache: "no-store"});
    if (answer.ok) return location.replace("/");
    told.textContent = await answer.text();
  } catch {
    told.textContent = "The server does not answer: try again.";
  }
  form.button.disabled = false;
  form.password.select();
});
"""
_PAGE = Markup(
    '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Wafer Viewer: log in</title>'
    '<meta name="viewport" content="width=device-width"><style>{style}</style></head><body><form>'
    '<h1>Wafer Viewer</h1><input name="user" autocomplete="username" value="wafer-viewer" hidden>'
    '<label for="password">Password</label>'
    '<input id="password" name="password" type="password" autocomplete="current-password" required autofocus>'
    '<button name="button">Log in</button><p role="alert"></p><noscript>This page needs scripts.</noscript>'
    "</form><script>{script}</script></body></html>"
)
_BODY = _PAGE.format(style=Markup(_STYLE), script=Markup(_SCRIPT)).encode()
log = logging.getLogger(__name__)


def _hash(text: str) -> str:
    """Return the source expression of a content security policy for a text."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


LOGIN_POLICY = (
    f"default-src 'none'; script-src {_hash(_SCRIPT)}; style-src {_hash(_STYLE)}; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


class Login:
    """Check of the password that the form sends."""

    def __init__(self, password: PasswordHash, limit: AttemptLimit | None = None) -> None:
        self._password = password
        self._limit = limit or AttemptLimit()
        self._one_at_a_time = asyncio.Lock()

    @staticmethod
    def page() -> Response:
        """Return the page with the form, as the answer to a browser that is not logged in."""
        headers = Headers({"Content-Type": "text/html; charset=utf-8", "Content-Length": str(len(_BODY))})
        headers["Content-Security-Policy"] = LOGIN_POLICY
        status = http.HTTPStatus.UNAUTHORIZED
        return Response(status.value, status.phrase, headers, _BODY)

    async def problem(self, address: str, request: Request) -> tuple[http.HTTPStatus, str] | None:
        """Return why a login is refused, with its status; None for the right password."""
        if not self._limit.admit(address):
            log.warning("A login from %s was refused: too many attempts.", address)
            return http.HTTPStatus.TOO_MANY_REQUESTS, f"Too many attempts: try again in {WINDOW_S:.0f} s.\n"
        async with self._one_at_a_time:  # an attempt costs 128 MB
            right = await asyncio.to_thread(self._password.matches, _given(request))
        if not right:
            log.warning("A login from %s was refused: wrong password.", address)
            return http.HTTPStatus.UNAUTHORIZED, "This is not the password.\n"
        self._limit.forget(address)
        return None


def _given(request: Request) -> str:
    """Return the password in the basic credentials of a request; empty if there is none."""
    headers = request.headers.get_all("Authorization")
    scheme, _, credentials = headers[0].partition(" ") if len(headers) == 1 else ("", "", "")
    try:
        text = base64.b64decode(credentials, validate=True).decode()
    except (binascii.Error, ValueError):
        return ""
    return text.partition(":")[2] if scheme.lower() == "basic" else ""


# --------------------------------------------------------------------------------------------------------- access guard


Answer = Callable[[ServerConnection, Request], Response | Awaitable[Response] | None]
PlainAnswer = Callable[[ServerConnection, Request], Response | None]

_REPORTS = "/reports/"
_DEFAULT_PORTS = {"http": 80, "https": 443}
_POLICY = (
    "default-src 'self'; script-src 'nonce-{nonce}' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self' {socket}://{host} data: blob:; "
    "worker-src 'self' blob:; object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Content security policy with the permissions that viser's page needs: textures and workers from blobs, WebAssembly,
and the functions that its bindings make of text.

Scripts are those of viser and of the program, by the nonce of the answer; no HTML brings others in.
"""
_REPORT_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; font-src data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Policy of a report, one file without scripts: whatever a name brings into it, nothing of it runs."""
DOCUMENTATION = "/documentation/"
_SITE_POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "font-src 'self'; connect-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
"""Policy of the documentation, whose theme has scripts in its pages: none of them can reach the viewer."""
_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
_NO_TOKEN = (
    "This page opens with the address that the program printed when it started: it ends in ?token=... "
    "Copy the whole of it from the terminal.\n"
)


class AccessGuard:
    """Request checks of one server, and the address that passes them."""

    def __init__(
        self, host: str, token: str, network: NetworkAccess | None = None, script: str = "", shell: str = ""
    ) -> None:
        self._host = host
        self._index = PageIndex(script, shell)
        self._token = token
        self._scheme = "https" if network else "http"
        self._login = Login(network.password) if network else None
        self.report: Callable[[str], bytes | None] = lambda name: None
        """Bytes of a report by name, served under /reports/NAME to authorised browsers; None if missing."""
        self.documentation: Callable[[], Mapping[str, Path]] = dict
        """Files of the documentation by path, served under /documentation/PATH to authorised browsers."""
        self.refuse_upload: Refusal = lambda connection, upload: False
        """Tells whether a connection may not send a file."""
        self._port = 0

    @property
    def origin(self) -> str:
        """Address at which this machine reaches the page, without the token."""
        loopback = "::1" if self._host == "::" else "127.0.0.1"
        return f"{self._scheme}://{_in_address(loopback if self._host in EVERY_ADDRESS else self._host)}:{self._port}"

    @property
    def public_origin(self) -> str:
        """Address at which others reach the page: a page of all interfaces goes by the name of this machine."""
        if self._login is None or self._host not in EVERY_ADDRESS:
            return self.origin
        return f"{self._scheme}://{socket.gethostname()}:{self._port}"

    @property
    def address(self) -> str:
        """Address with the token, to be printed."""
        return f"{self.public_origin}/?token={self._token}"

    def refusal(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return the response to a request that is not of this page, or None."""
        try:
            host, origin = request.headers["Host"], request.headers.get("Origin")
            is_socket = "Upgrade" in request.headers
        except (KeyError, MultipleValuesError):
            return _text(http.HTTPStatus.BAD_REQUEST, "A request names one Host.\n")
        if host.lower() not in self._names(connection):
            return _text(http.HTTPStatus.FORBIDDEN, "This server does not go by that name.\n")
        own = f"{self._scheme}://{host.lower()}"
        if (origin is None and is_socket) or (origin is not None and origin.lower() != own):
            return _text(http.HTTPStatus.FORBIDDEN, "Another page may not use this one.\n")
        return None

    def around(self, answer: PlainAnswer | None) -> Answer:
        """Wrap viser's handler with the checks, the login, the cookie, the page's scripts and the security headers."""

        def guarded(connection: ServerConnection, request: Request) -> Response | Awaitable[Response] | None:
            response = self.refusal(connection, request)
            if response is None and self._login is not None and _path(request) == LOGIN_PATH:
                return self._logged_in(self._login, connection, request)
            if response is None and not (self._has_cookie(request) or self._has_token(request)):
                response = self._unauthorised(request)
            if response is None:
                response = self._reported(request) or self._documented(request)
            if response is None and answer is not None:
                response = self._with_scripts(answer(connection, request), request)
                if response is not None and self._has_token(request):
                    response.headers["Set-Cookie"] = self._cookie()
            return response and _hardened(response)

        return guarded

    def _with_scripts(self, response: Response | None, request: Request) -> Response | None:
        """Return the page with the scripts of the program and its policy for viser's page, other responses as is."""
        if response is None or not response.headers.get("Content-Type", "").startswith("text/html"):
            return response
        body, nonce = self._index.answer()
        headers = Headers({"Content-Type": "text/html; charset=utf-8", "Content-Length": str(len(body))})
        socket = "wss" if self._login else "ws"
        headers["Content-Security-Policy"] = _POLICY.format(nonce=nonce, socket=socket, host=request.headers["Host"])
        return Response(response.status_code, response.reason_phrase, headers, body)

    async def _logged_in(self, login: Login, connection: ServerConnection, request: Request) -> Response:
        """Return the response to a password: the cookie for the right one."""
        remote = connection.remote_address
        problem = await login.problem(str(remote[0]) if remote else "", request)
        response = _text(*(problem or (http.HTTPStatus.OK, "Logged in.\n")))
        if problem is None:
            response.headers["Set-Cookie"] = self._cookie()
        return _hardened(response)

    def _unauthorised(self, request: Request) -> Response:
        if self._login is not None and "Upgrade" not in request.headers:
            return self._login.page()
        return _text(http.HTTPStatus.UNAUTHORIZED, _NO_TOKEN)

    def _reported(self, request: Request) -> Response | None:
        """Return the response to a request for a report; None for other requests."""
        path = unquote(_path(request))
        if not path.startswith(_REPORTS):
            return None
        body = self.report(path.removeprefix(_REPORTS))
        if body is None:
            return _text(http.HTTPStatus.NOT_FOUND, "There is no such report: write it again from the page.\n")
        kind = "application/pdf" if path.endswith(PRINTED) else "text/html; charset=utf-8"
        headers = Headers({"Content-Type": kind, "Content-Length": str(len(body))})
        headers["Content-Security-Policy"] = _REPORT_POLICY
        return Response(http.HTTPStatus.OK.value, http.HTTPStatus.OK.phrase, headers, body)

    def _documented(self, request: Request) -> Response | None:
        """Return the response to a request for a page of the documentation; None for other requests."""
        path = unquote(_path(request))
        if not path.startswith(DOCUMENTATION):
            return None
        file = self.documentation().get(path.removeprefix(DOCUMENTATION))
        if file is None:
            return _text(http.HTTPStatus.NOT_FOUND, "There is no such page of the documentation.\n")
        body, kind = file.read_bytes(), mimetypes.guess_type(file.name)[0] or "application/octet-stream"
        headers = Headers({"Content-Type": kind, "Content-Length": str(len(body))})
        headers["Content-Security-Policy"] = _SITE_POLICY
        return Response(http.HTTPStatus.OK.value, http.HTTPStatus.OK.phrase, headers, body)

    def bound_to(self, port: int) -> None:
        """Set the port once it is known."""
        self._port = port

    def _names(self, connection: ServerConnection) -> set[str]:
        """Return the valid Host values: loopback, the configured host, the local address of the connection."""
        local = connection.local_address
        port = int(local[1]) if local else self._port
        own = {self._host, str(local[0]) if local else ""} | ({socket.gethostname()} if self._login else set())
        names = {_in_address(name.lower()) for name in {*LOOPBACK, *own} - set(EVERY_ADDRESS)}
        return {f"{name}:{port}" for name in names} | (names if port == _DEFAULT_PORTS[self._scheme] else set())

    def _cookie_name(self) -> str:
        # Cookies do not know ports: two viewers on one machine would overwrite each other's.
        return f"wafer_viewer_{self._port}"

    def _cookie(self) -> str:
        secure = "; Secure" if self._login else ""
        return f"{self._cookie_name()}={self._token}; Path=/; HttpOnly; SameSite=Strict{secure}"

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
        return hmac.compare_digest(given.encode("utf-8", "surrogateescape"), self._token.encode())


def _text(status: http.HTTPStatus, text: str) -> Response:
    body = text.encode()
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))})
    return Response(status.value, status.phrase, headers, body)


def _path(request: Request) -> str:
    return urlsplit(request.path).path


def _in_address(host: str) -> str:
    """Return a host as it stands in an address: IPv6 in brackets."""
    return f"[{host}]" if ":" in host else host


def _hardened(response: Response) -> Response:
    """Set the security headers of a response; a policy of its own stays."""
    response.headers.setdefault("Content-Security-Policy", "default-src 'none'; frame-ancestors 'none'")
    for name, value in _HEADERS.items():
        response.headers[name] = value
    return response


INDEX = Path(viser.__file__).parent / "client" / "build" / "index.html"
_PACKED, _UNPACKED, _END = b"<script data-p=", b'const e=document.createElement("script");', b"</head>"
_BEGIN = b"<body>"


class PageIndex:
    """HTML of the page, with another nonce for each answer.

    viser's page is one script that unpacks another and adds it to the page, so that both need the nonce.

    script: that of the program; shell: HTML that is shown until the scripts have drawn. Raises WaferViewerError if
    viser's scripts are not where they are expected.
    """

    def __init__(self, script: str, shell: str = "") -> None:
        html = INDEX.read_bytes()
        if [html.count(mark) for mark in (b"<script", _PACKED, _UNPACKED, _END, _BEGIN)] != [1] * 5:
            raise WaferViewerError(
                "The page did not start, because its scripts could not be told from others: reinstall the program "
                f"together with its dependencies (viser here is {viser.__version__})."
            )
        before, rest = html.split(_PACKED)
        packed, rest = rest.split(_UNPACKED)
        unpacking, rest = rest.split(_END)
        self._parts = (
            before + b'<script nonce="',
            b'" data-p=' + packed + _UNPACKED + b'e.nonce="',
            b'";' + unpacking + b'<script nonce="',
            b'">' + script.encode() + b"</script>" + _END + rest.replace(_BEGIN, _BEGIN + shell.encode()),
        )

    def answer(self) -> tuple[bytes, str]:
        """Return the page, and the nonce of its scripts."""
        nonce = secrets.token_urlsafe(16)
        return nonce.encode().join(self._parts), nonce
