"""Scripts of the page: viser's two and the program's, by a nonce that no HTML can know."""

from __future__ import annotations

import contextlib
import http.client
import re
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest
import viser

from wafer_viewer.gui.app import SCRIPTS, page_script, page_shell
from wafer_viewer.gui.security import access_guard
from wafer_viewer.gui.security.access_guard import AccessGuard, PageIndex
from wafer_viewer.gui.security.server import open_server
from wafer_viewer.gui.widgets.style import FOLDER
from wafer_viewer.model.errors import WaferViewerError

SCRIPT = "window.wvRan = 1;"


@pytest.fixture(scope="module")
def server() -> Iterator[tuple[viser.ViserServer, AccessGuard]]:
    opened, guard = open_server("127.0.0.1", 0, script=SCRIPT)
    yield opened, guard
    opened.stop()


def page(server: tuple[viser.ViserServer, AccessGuard]) -> tuple[str, str]:
    """The page and its policy."""
    parts = urlsplit(server[1].address)
    with contextlib.closing(http.client.HTTPConnection("127.0.0.1", server[0].get_port(), timeout=5)) as wire:
        wire.request("GET", f"{parts.path}?{parts.query}", headers={"Accept-Encoding": "gzip"})
        answer = wire.getresponse()
        return answer.read().decode(), answer.getheader("Content-Security-Policy", "")


def test_scripts_run_by_the_nonce_of_the_answer_and_by_nothing_else(server) -> None:
    nonces = set[str]()
    for _ in range(2):
        html, policy = page(server)
        (allowed,) = re.findall(r"script-src ([^;]*);", policy)
        (nonce,) = re.fullmatch(r"'nonce-([\w-]{22})' 'unsafe-eval'", allowed).groups()
        assert re.findall(r"<script([^>]*?)(?: data-p=|>)", html) == [f' nonce="{nonce}"'] * 2
        assert f'const e=document.createElement("script");e.nonce="{nonce}";' in html
        assert f"{SCRIPT}</script></head>" in html
        nonces.add(nonce)
    assert len(nonces) == 2


def test_a_page_whose_scripts_are_elsewhere_does_not_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = tmp_path / "index.html"
    other.write_bytes(access_guard.INDEX.read_bytes().replace(b"</head>", b"<script>1</script></head>"))
    monkeypatch.setattr(access_guard, "INDEX", other)
    with pytest.raises(WaferViewerError, match=r"its scripts could not be told from others.*viser here is"):
        PageIndex(SCRIPT)


def test_every_script_is_in_the_one_of_the_page_and_none_can_end_it_early() -> None:
    assert sorted(SCRIPTS) == sorted(path.name for path in FOLDER.glob("*.js"))
    assert "</script" not in page_script().lower()


def test_the_page_has_its_regions_and_steps_before_its_scripts_run() -> None:
    html, _ = PageIndex(SCRIPT, page_shell()).answer()
    body = html.decode().partition("<body>")[2]
    assert body.startswith("<style>#wv-shell")
    assert "<b>Gauge check</b>" in body
    assert "prefers-color-scheme:dark" in body
    assert "<script" not in body
