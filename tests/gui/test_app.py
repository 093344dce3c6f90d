"""The viewer as a program: it ends when it is asked to, whatever the moment."""

from __future__ import annotations

import signal
import sys
import threading
import traceback
from pathlib import Path

import pytest

from wafer_viewer.gui import app
from wafer_viewer.gui.app import Running, serve
from wafer_viewer.session.session import Session


@pytest.fixture
def restored_signals():
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.slow
@pytest.mark.usefixtures("restored_signals")
def test_a_request_to_end_that_a_finalizer_swallows_is_still_heard(tmp_path: Path) -> None:
    messages: list[str] = []

    def announce(text: str) -> None:
        messages.append(text)
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            return

    session = Session(tmp_path)
    try:
        serve(session, port=0, announce=lambda text: announce(text) if not messages else messages.append(text))
    finally:
        session.close()
    assert messages[-1] == "Wafer Viewer ends."


def doing(thread: int | None) -> list[str]:
    """Names of the innermost functions of a thread."""
    return [frame.f_code.co_name for frame, _ in traceback.walk_stack(sys._current_frames()[thread])][:3]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals go to the main thread there")
@pytest.mark.usefixtures("restored_signals")
def test_a_request_to_end_that_another_thread_receives_is_heard(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app, "start", lambda *_: Running("nowhere", "nowhere", lambda: None))
    main, ended, rescued = threading.main_thread().ident, threading.Event(), threading.Event()

    def ask() -> None:
        while doing(main) != ["wait", "wait", "serve"]:
            pass
        signal.pthread_kill(threading.get_ident(), signal.SIGTERM)
        if not ended.wait(10.0):
            rescued.set()
            signal.pthread_kill(main, signal.SIGTERM)

    asker = threading.Thread(target=ask)
    serve(None, announce=lambda text: asker.start() if not asker.ident else None)
    ended.set()
    asker.join()
    assert not rescued.is_set()
