"""Central error handling of page callbacks: the operator reads what failed and what to do.

Expected errors are shown with their own message; any other is shown briefly, with the details in the log.
"""

from __future__ import annotations

import functools
import itertools
import logging
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from typing import Any, Protocol

from wafer_viewer.gui.widgets.html import Tone
from wafer_viewer.model.errors import ControlHeldError, MotionStopped, RoleError, WaferViewerError
from wafer_viewer.session.state.snapshot import Fault

log = logging.getLogger("wafer_viewer.gui")
_numbers = itertools.count(1)


class ErrorSink(Protocol):
    """Receiver of messages to the operator."""

    def tell(self, fault: Fault) -> None:
        """Show a note until it is dismissed."""
        ...

    def say(self, title: str, text: str, tone: Tone = "good") -> None:
        """Show a transient notification."""
        ...


def guarded(page: ErrorSink, name: str) -> Callable[[Callable[..., Any]], Callable[..., None]]:
    """Wrap a callback of the page; `name` is the title of a failure, such as 'Import stopped'.

    If the callback returns a future (a session command), its outcome is reported as well.
    """

    def wrap(callback: Callable[..., Any]) -> Callable[..., None]:
        @functools.wraps(callback)
        def run(*args: Any, **kwargs: Any) -> None:
            try:
                outcome = callback(*args, **kwargs)
            except Exception as fault:  # noqa: BLE001 - callbacks run code of any kind: each failure is reported to the operator
                tell_failure(page, name, fault)
            else:
                if isinstance(outcome, Future):
                    outcome.add_done_callback(lambda done: _look_at(page, name, done))

        return run

    return wrap


def tell_failure(page: ErrorSink, name: str, fault: BaseException) -> None:
    """Report a failure to the operator, with its own message if it is an expected error; cancellations are silent."""
    if isinstance(fault, CancelledError):
        return
    if isinstance(fault, ControlHeldError | RoleError):
        page.say(name, str(fault), "attention")
        return
    if isinstance(fault, MotionStopped):
        page.say("Stopped", str(fault).replace(" -", " −"), "attention")
        return
    if isinstance(fault, WaferViewerError):
        page.tell(_note(*_headline(name, str(fault))))
        return
    log.error("%s", name, exc_info=fault)
    what = f"Unexpected error: {str(fault) or type(fault).__name__}."
    page.tell(_note(name, f"{what} The session continues; details are in the log."))


def _look_at(page: ErrorSink, name: str, done: Future[Any]) -> None:
    if done.cancelled():
        return
    fault = done.exception()
    if fault is not None:
        tell_failure(page, name, fault)


def _note(title: str, text: str) -> Fault:
    return Fault(id=f"page-{next(_numbers)}", title=title, text=text, at=time.strftime("%H:%M:%S"))


def _headline(name: str, sentence: str) -> tuple[str, str]:
    """Return title and text: a message such as 'Import stopped at stack_041.tif: It is …' contains its own title."""
    first, colon, rest = sentence.partition(": ")
    if colon and first.startswith(name.split(maxsplit=1)[0]) and len(first) < 70:
        return first, rest[:1].upper() + rest[1:]
    return name, sentence
