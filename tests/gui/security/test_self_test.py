"""The page is not announced when its guard has no effect."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from wafer_viewer.cli.app import main
from wafer_viewer.gui.security import server
from wafer_viewer.gui.security.access_guard import AccessGuard, PlainAnswer
from wafer_viewer.gui.security.server import close_server, open_server, require_refusals
from wafer_viewer.model.errors import WaferViewerError


def free_port() -> int:
    with socket.socket() as trial:
        trial.bind(("127.0.0.1", 0))
        return trial.getsockname()[1]


def test_a_page_whose_guard_has_no_effect_does_not_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "_guarding", lambda *_: contextlib.nullcontext())
    port = free_port()
    with pytest.raises(WaferViewerError, match=r"request for the page without the token with 200 instead of 401\."):
        open_server("127.0.0.1", port)
    with socket.socket() as again:  # nothing listens there any more
        assert again.connect_ex(("127.0.0.1", port)) != 0


def test_a_page_whose_guard_lets_websockets_pass_does_not_start(monkeypatch: pytest.MonkeyPatch) -> None:
    around = AccessGuard.around

    def half(guard: AccessGuard, answer: PlainAnswer | None) -> PlainAnswer:
        guarded = around(guard, answer)
        return lambda connection, request: None if "Upgrade" in request.headers else guarded(connection, request)

    monkeypatch.setattr(AccessGuard, "around", half)
    with pytest.raises(WaferViewerError, match="request for a websocket without the token with 101 instead of 401"):
        open_server("127.0.0.1", 0)


def test_a_server_that_does_not_answer_itself_does_not_start() -> None:
    with pytest.raises(WaferViewerError, match="does not answer itself"):
        require_refusals(f"http://127.0.0.1:{free_port()}")


@pytest.mark.slow
def test_the_command_ends_with_one_sentence(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(server, "_guarding", lambda *_: contextlib.nullcontext())
    assert main(["serve", "--port", "0", "--data", str(tmp_path)]) == 2
    shown = capsys.readouterr()
    assert "http" not in shown.out
    assert shown.err.startswith("wafer-viewer: The page did not start, because it would be open to everyone")
    assert shown.err.count("\n") == 1


def least_ms(do: Callable[[], object]) -> float:
    def once() -> float:
        began = time.perf_counter()
        do()
        return time.perf_counter() - began

    return 1000 * min(once() for _ in range(5))


def test_the_test_costs_less_than_50_ms() -> None:
    opened, guard = open_server("127.0.0.1", 0)
    try:
        assert least_ms(lambda: require_refusals(guard.origin)) < 50
    finally:
        close_server(opened)
