"""Login with the password: a page with a form, and the check of what it sends, at a limited rate.

The server of websockets answers requests without a body only, so the form sends the password as HTTP's basic
credentials, in a header.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
import hashlib
import http
import logging

from markupsafe import Markup
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from wafer_viewer.session.core.page_password import WINDOW_S, AttemptLimit, PasswordHash

PATH = "/login"
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


POLICY = (
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
        headers["Content-Security-Policy"] = POLICY
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
