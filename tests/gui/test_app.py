"""The viewer as a program: it ends when it is asked to, whatever the moment."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from wafer_viewer.gui.app import serve
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
    said: list[str] = []

    def announce(text: str) -> None:
        said.append(text)
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            return

    session = Session(tmp_path)
    try:
        serve(session, port=0, announce=lambda text: announce(text) if not said else said.append(text))
    finally:
        session.close()
    assert said[-1] == "Wafer Viewer ends."
