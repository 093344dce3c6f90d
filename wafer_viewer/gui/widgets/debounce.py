"""What a person types into a form on its way to the session: it goes when the typing rests."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

COMMIT_S = 0.25
"""Edits go to the session when nothing was typed for so long: one number typed is one step of undo."""


class Debouncer:
    """Counts the edits of a form; `commit` hands the form over, with a future where the session is asked.

    Until the last edit has arrived the form shows what was typed, however long the typing goes on: the session's
    value is the older one.
    """

    def __init__(self, commit: Callable[[], Future[Any] | None], guard: Callable[[Callable[[], None]], Any]) -> None:
        self._commit = commit
        self._hand_over = guard(self._hand_over_now)
        self._made = self._arrived = 0
        self._timer: threading.Timer | None = None

    @property
    def under_way(self) -> bool:
        """Whether something was typed that the session does not know yet."""
        return self._arrived < self._made

    def made(self) -> None:
        """Something was typed: hand the form over when the typing rests."""
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
