"""A child process and its pipe: verbs go down, answers and events come up.

Both ends notice when the other is gone, because the pipe ends: the viewer then calls `on_gone`, a child puts its
things at rest and exits.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from itertools import count
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

from wafer_viewer.model.errors import WaferViewerError


class ChildDied(WaferViewerError):
    """The process that should have answered has ended."""


@dataclass(frozen=True, slots=True)
class Request:
    """A verb on its way down, with the number its answer will carry."""

    number: int
    verb: Any


@dataclass(frozen=True, slots=True)
class Reply:
    """What a verb came to: a value, or the error that says why not."""

    number: int
    value: Any = None
    error: WaferViewerError | None = None


class ChildProcess:
    """The viewer's end. The child runs ``target(pipe, *args)``; events arrive on a thread of the link's own."""

    def __init__(
        self,
        name: str,
        target: Callable[..., None],
        args: tuple[Any, ...],
        on_event: Callable[[Any], None],
        on_gone: Callable[[int | None], None],
    ) -> None:
        spawn = get_context("spawn")
        self._pipe, theirs = spawn.Pipe()
        self.process = spawn.Process(target=target, args=(theirs, *args), name=name)
        self.process.start()
        theirs.close()
        self._on_event, self._on_gone = on_event, on_gone
        self._numbers = count(1)
        self._waiting: dict[int, Future[Any]] = {}
        self._sending = threading.Lock()
        self._closing = False
        self._reader = threading.Thread(target=self._read, name=f"{name} events", daemon=True)
        self._reader.start()

    @property
    def alive(self) -> bool:
        """Whether the child still runs."""
        return self.process.is_alive() and self._reader.is_alive()

    def ask(self, verb: Any) -> Future[Any]:
        """Send a verb; the future is done when the child answers it, or fails when the child is gone."""
        answer: Future[Any] = Future()
        with self._sending:
            number = next(self._numbers)
            self._waiting[number] = answer
            try:
                self._pipe.send(Request(number, verb))
            except OSError:
                self._waiting.pop(number).set_exception(_gone())
        return answer

    def close(self, patience_s: float = 20.0) -> None:
        """End the pipe; the child puts its things at rest. One that does not end in time is ended."""
        self._closing = True
        with self._sending, contextlib.suppress(OSError):
            self._pipe.send(None)
        self.process.join(patience_s)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self._reader.join(1.0)
        self._pipe.close()

    def _read(self) -> None:
        with contextlib.suppress(EOFError, OSError):
            while True:
                self._take(self._pipe.recv())
        self.process.join(1.0)
        for number in list(self._waiting):
            self._waiting.pop(number).set_exception(_gone())
        if not self._closing:
            self._on_gone(self.process.exitcode)

    def _take(self, message: Any) -> None:
        if not isinstance(message, Reply):
            self._on_event(message)
        elif message.error is not None:
            self._waiting.pop(message.number).set_exception(message.error)
        else:
            self._waiting.pop(message.number).set_result(message.value)


class ChildConnection:
    """The child's end of a link."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self._sending = threading.Lock()

    def verbs(self) -> Iterator[Request]:
        """The verbs as they come, until the viewer closes the pipe or is gone."""
        with contextlib.suppress(EOFError, OSError):
            while (ask := self._pipe.recv()) is not None:
                yield ask

    def tell(self, event: Any) -> None:
        """Send an event up; nobody is there to hear it once the viewer is gone."""
        with self._sending, contextlib.suppress(OSError):
            self._pipe.send(event)

    def answer(self, ask: Request, value: Any = None) -> None:
        """Say what a verb came to."""
        self.tell(Reply(ask.number, value))

    def refuse(self, ask: Request, error: WaferViewerError) -> None:
        """Say why a verb was not carried out."""
        self.tell(Reply(ask.number, error=error))


def live_in_the_background(niceness: int = 0) -> None:
    """Leave Ctrl-C to the viewer, which ends its children through their pipes, and give way to it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if niceness and hasattr(os, "nice"):
        os.nice(niceness)


def _gone() -> WaferViewerError:
    return ChildDied("The process that should do this has ended: try again, it is restarted.")
