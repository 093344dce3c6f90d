"""Worker that runs only the latest of its pending tasks."""

from __future__ import annotations

import threading
from collections.abc import Callable


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
