"""What the command `serve` hands to the page: host, token, password and certificate."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from wafer_viewer.cli.app import main
from wafer_viewer.session.core import network_access
from wafer_viewer.session.core.private_file import page_token, stored_password

GOOD = "correct horse battery"


@pytest.fixture
def served(quick_passwords: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., dict[str, Any]]:
    """Run the command with a page that only notes what it gets, and with someone who types these lines."""

    def run(*words: str, typed: tuple[str, ...] = ()) -> dict[str, Any]:
        got: dict[str, Any] = {}
        shown = SimpleNamespace(data_folder=tmp_path, kernels=None)
        session = SimpleNamespace(snapshot=shown, subscribe=lambda _: None, close=lambda: None)
        monkeypatch.setattr("wafer_viewer.session.session.Session", lambda *_: session)
        monkeypatch.setattr("wafer_viewer.gui.app.serve", lambda _, host, port, **more: got.update(host=host, **more))
        lines = iter(typed)
        monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: bool(typed)))
        monkeypatch.setattr(network_access.getpass, "getpass", lambda _: next(lines))
        monkeypatch.setattr("signal.signal", lambda *_: None)
        status = main(["serve", "--data", str(tmp_path), *words])
        return got | {"status": status}

    return run


def test_without_a_host_the_page_is_this_computers_with_the_stored_token(served, tmp_path: Path) -> None:
    got = served()
    assert (got["status"], got["host"], got["network"]) == (0, "127.0.0.1", None)
    assert got["token"] == page_token(tmp_path)
    assert served("--new-token")["token"] != got["token"]
    assert [path.name for path in (tmp_path / ".wafer-viewer").iterdir()] == ["token"]


def test_a_new_password_closes_the_page_for_whoever_was_in(served, tmp_path: Path) -> None:
    first = served("--host", "127.0.0.2", typed=(GOOD, GOOD))
    again = served("--host", "127.0.0.2")
    assert first["network"].password == again["network"].password == stored_password(tmp_path)
    assert first["token"] == again["token"]
    other = served("--host", "127.0.0.2", "--new-password", typed=("another long one", "another long one"))
    assert other["network"].password.matches("another long one")
    assert other["token"] != first["token"]


def test_without_a_password_nothing_is_served(served, capsys: pytest.CaptureFixture[str]) -> None:
    assert served("--host", "0.0.0.0") == {"status": 2}
    assert "The page is not served at 0.0.0.0 without a password" in capsys.readouterr().err
