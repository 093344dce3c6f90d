"""Callbacks of the page: guarded against errors, debounced, and without echoes of our own writes.

Expected errors are shown with their own message; any other is shown briefly, with the details in the log.
"""

from __future__ import annotations

import functools
import itertools
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from typing import Any, Generic, Protocol, TypeVar

from wafer_viewer.gui.widgets.html import Tone
from wafer_viewer.model.errors import ControlHeldError, MotionStopped, RoleError, WaferViewerError
from wafer_viewer.session.state.snapshot import Fault

# ---------------------------------------------------------------------------------------------------------- error guard


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
        page.say("Stopped", str(fault), "attention")
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


# ------------------------------------------------------------------------------------------------------ callback timing


COMMIT_S = 0.25
"""Pause in typing after which edits are sent to the session: one number typed is one undo step."""

MOVE_S = 1.0
"""Pause in typing after which the instrument follows: longer, because half a number cannot be undone."""


class Debouncer:
    """Counter of form edits. `commit` submits the form and returns a future if the session is queried.

    Until the last edit has arrived the form shows the typed text, because the session's value is older.
    """

    def __init__(
        self,
        commit: Callable[[], Future[Any] | None],
        guard: Callable[[Callable[[], None]], Any],
        pause_s: float = COMMIT_S,
    ) -> None:
        self._commit, self._pause_s = commit, pause_s
        self._hand_over = guard(self._hand_over_now)
        self._made = self._arrived = 0
        self._timer: threading.Timer | None = None

    @property
    def under_way(self) -> bool:
        """True if an edit has not reached the session yet."""
        return self._arrived < self._made

    def made(self) -> None:
        """Register an edit: submit the form when typing pauses."""
        self._made += 1
        if self._timer is not None:
            self._timer.cancel()
        self._timer = threading.Timer(self._pause_s, self._hand_over)
        self._timer.daemon = True
        self._timer.start()

    def hurry(self) -> None:
        """Submit the form now if it waits for a pause in typing."""
        if self._timer is not None and self._timer.is_alive():
            self._timer.cancel()
            self._hand_over()

    def _hand_over_now(self) -> None:
        self._timer = None
        handed = self._made
        answer: Future[Any] | None = None
        try:
            answer = self._commit()
        finally:
            if answer is None:
                self._arrive(handed)
        if answer is not None:
            answer.add_done_callback(lambda _: self._arrive(handed))

    def _arrive(self, handed: int) -> None:
        self._arrived = max(self._arrived, handed)


T = TypeVar("T")
_MOST = 64


class EchoFilter(Generic[T]):
    """Values that were sent and may be received again, in the order in which they were sent."""

    def __init__(self) -> None:
        self._sent: deque[T] = deque(maxlen=_MOST)
        self._heard: T | None = None

    def tell(self, value: T) -> T:
        """Record a value that is being sent and return it."""
        self._sent.append(value)
        return value

    def is_echo(self, value: T) -> bool:
        """Return whether a value was sent from here or received before; values sent before it are discarded."""
        if value == self._heard:
            return True
        self._heard = value
        if value not in self._sent:
            self._sent.clear()
            return False
        while self._sent.popleft() != value:
            pass
        return True

    def forget(self) -> None:
        """Discard all sent values, so that nothing counts as an echo."""
        self._sent.clear()
        self._heard = None


class LatestOnlyWorker:
    """Worker with one thread. `ask` never blocks, and drops a previous task that has not started."""

    def __init__(self, name: str) -> None:
        self._question: Callable[[], None] | None = None
        self._due = threading.Condition()
        self._closed = False
        threading.Thread(target=self._run, name=name, daemon=True).start()

    def ask(self, question: Callable[[], None]) -> None:
        """Submit a task in place of a pending one."""
        with self._due:
            self._question = question
            self._due.notify()

    def close(self) -> None:
        """Stop the thread after the current task."""
        with self._due:
            self._closed = True
            self._due.notify()

    def _run(self) -> None:
        while True:
            with self._due:
                self._due.wait_for(lambda: self._question is not None or self._closed)
                question, self._question = self._question, None
            if self._closed or question is None:
                return
            question()
