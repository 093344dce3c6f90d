"""Timing of callbacks: debouncing, echoes of our own writes ignored, only the latest pending task run."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, Generic, TypeVar

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

    def _hand_over_now(self) -> None:
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
