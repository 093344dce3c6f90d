"""The true session in a process of its own that a test asks, waits for and kills, itself or one of its processes."""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path

from tests.support.killed_programs import ENVIRONMENT, orphans_of
from tests.support.patience import PATIENCE_S
from tests.support.session_program import BEGUN, END, READY


class SessionProgram:
    """A session, asked line by line (tests/support/session_program.py)."""

    def __init__(self, data: Path) -> None:
        words = [sys.executable, "-m", "tests.support.session_program", str(data)]
        self.process = subprocess.Popen(
            words,
            env=ENVIRONMENT,
            text=True,
            start_new_session=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        self.pids: dict[str, int] = {}
        self._answers: queue.Queue[str] = queue.Queue()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        if (answer := self.answer()) != READY:
            raise AssertionError(f"the session does not start: {answer!r}")

    def begin(self, *words: str) -> str | None:
        """Begin to do something; return the sentence that prevented it, None if it has begun."""
        self._ask(*words)
        answer = self.answer()
        return None if answer == BEGUN else answer or "it hangs"

    def answer(self, most_s: float = PATIENCE_S) -> str | None:
        """Return the next answer: `done` or a sentence; None if there is none within some seconds."""
        with suppress(queue.Empty):
            return self._answers.get(timeout=most_s)
        return None

    def do(self, *words: str) -> str:
        """Do something to its end, and return `done` or the sentence that prevented it."""
        return self.begin(*words) or self.answer() or "it hangs"

    def kill(self) -> tuple[str, ...]:
        """Kill the process of the session, and return what it left running."""
        self.process.kill()
        return self._end()

    def close(self) -> tuple[str, ...]:
        """End the session as a person does, and return what it left running."""
        self._ask(END)
        return self._end()

    def _ask(self, *words: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(words) + "\n")
        self.process.stdin.flush()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            with suppress(ValueError):  # a line torn by the kill
                self.pids, answer = json.loads(line)
                self._answers.put(answer)
        self._answers.put("The session has ended.")

    def _end(self) -> tuple[str, ...]:
        self.process.wait(PATIENCE_S)
        self._reader.join(PATIENCE_S)
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe is not None
            with suppress(OSError):
                pipe.close()
        return orphans_of(self.process.pid)
