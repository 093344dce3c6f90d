"""Debouncing of form edits: they are sent to the session when typing pauses."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

COMMIT_S = 0.25
"""Pause in typing after which edits are sent to the session: one number typed is one undo step."""


class Debouncer:
    """Counter of form edits. `commit` submits the form and returns a future if the session is queried.

    Until the last edit has arrived the form shows the typed text, because the session's value is older.
    """

    def __init__(self, commit: Callable[[], Future[Any] | None], guard: Callable[[Callable[[], None]], Any]) -> None:
        self._commit = commit
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
        self._timer = threading.Timer(COMMIT_S, self._hand_over)
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
