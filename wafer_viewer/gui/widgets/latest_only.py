"""A worker for questions that overtake each other: while one is answered, only the newest of those waiting is kept."""

from __future__ import annotations

import threading
from collections.abc import Callable


class LatestOnlyWorker:
    """One thread of its own; `ask` never waits, an older question that has not begun is dropped."""

    def __init__(self, name: str) -> None:
        self._question: Callable[[], None] | None = None
        self._due = threading.Condition()
        self._closed = False
        threading.Thread(target=self._run, name=name, daemon=True).start()

    def ask(self, question: Callable[[], None]) -> None:
        """Have a question answered, in place of one that still waits."""
        with self._due:
            self._question = question
            self._due.notify()

    def close(self) -> None:
        """Let the thread go when it has answered what it is at."""
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
