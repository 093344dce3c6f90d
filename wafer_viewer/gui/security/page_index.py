"""HTML of the page: that of viser, with the script of the program. A nonce lets these scripts run, and no others.

viser's page is one script that unpacks another and adds it to the page, so that both need the nonce.
"""

from __future__ import annotations

import secrets
from pathlib import Path

import viser

from wafer_viewer.model.errors import WaferViewerError

INDEX = Path(viser.__file__).parent / "client" / "build" / "index.html"
_PACKED, _UNPACKED, _END = b"<script data-p=", b'const e=document.createElement("script");', b"</head>"


class PageIndex:
    """HTML of the page, with another nonce for each answer.

    script: that of the program. Raises WaferViewerError if viser's scripts are not where they are expected.
    """

    def __init__(self, script: str) -> None:
        html = INDEX.read_bytes()
        if [html.count(mark) for mark in (b"<script", _PACKED, _UNPACKED, _END)] != [1, 1, 1, 1]:
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
            b'">' + script.encode() + b"</script>" + _END + rest,
        )

    def answer(self) -> tuple[bytes, str]:
        """Return the page, and the nonce of its scripts."""
        nonce = secrets.token_urlsafe(16)
        return nonce.encode().join(self._parts), nonce
