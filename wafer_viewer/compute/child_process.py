"""Child process and its pipe: requests go down, replies and events come up.

Both ends detect the loss of the other by the end of the pipe: the viewer then calls `on_exit`, a child shuts down
its devices and exits.

A page in use all day allocates and frees blocks of some hundred kilobytes: tiles, pictures, messages. The C library of
Linux (glibc) adapts to the first ones and keeps such blocks in its heaps. Longer-lived blocks between them fragment the
heaps, so the process only grows: half a day's use took 500 MB that nothing referenced, as tests/bench/bench_soak.py
shows.
"""

from __future__ import annotations

import contextlib
import ctypes
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from itertools import count
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from wafer_viewer.model.errors import WaferViewerError

PATIENCE_S = 20.0
"""Time in which a child shuts down after its pipe was closed; then it is killed."""
log = logging.getLogger(__name__)


class ChildDied(WaferViewerError):
    """The process that should have replied has ended."""


@dataclass(frozen=True, slots=True)
class Request:
    """Command to the child, with the number that its reply will carry."""

    number: int
    command: Any


@dataclass(frozen=True, slots=True)
class Reply:
    """Reply to a request: its value, or the error that prevented it."""

    number: int
    value: Any = None
    error: WaferViewerError | None = None


@contextlib.contextmanager
def alongside(work: Callable[[], None]) -> Generator[BaseProcess]:
    """Run `work` in a process of its own, which ends with the block at the latest; nobody depends on it."""
    process = get_context("spawn").Process(target=_work_for_parent, args=(work,), name="wafer-viewer beside")
    process.start()
    try:
        yield process
    finally:
        process.terminate()
        process.join()


def _work_for_parent(work: Callable[[], None]) -> None:
    end_with_parent()
    work()


def end_with_parent() -> None:
    """End this process when the one that started it has ended, even if that was killed."""
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=lambda: (parent.join(), os._exit(0)), daemon=True).start()


class ChildProcess:
    """Viewer's end of the pipe. The child runs ``target(pipe, *args)``; events arrive on a separate thread.

    A message that cannot be dealt with ends the child: nobody would read its further replies.
    """

    def __init__(
        self,
        name: str,
        target: Callable[..., None],
        args: tuple[Any, ...],
        on_event: Callable[[Any], None],
        on_exit: Callable[[int | None], None],
    ) -> None:
        spawn = get_context("spawn")
        self._pipe, theirs = spawn.Pipe()
        self.process = spawn.Process(target=target, args=(theirs, *args), name=name)
        self.process.start()
        theirs.close()
        self._on_event, self._on_exit = on_event, on_exit
        self._numbers = count(1)
        self._waiting: dict[int, Future[Any]] = {}
        self._sending = threading.Lock()
        self._closing = self._ended = False
        self._reader = threading.Thread(target=self._read, name=f"{name} events", daemon=True)
        self._reader.start()

    @property
    def alive(self) -> bool:
        """True while the child runs."""
        return self.process.is_alive() and self._reader.is_alive()

    def ask(self, command: Any) -> Future[Any]:
        """Send a command; the future completes with the child's reply, or fails with ChildDied."""
        answer: Future[Any] = Future()
        with self._sending:
            number = next(self._numbers)
            self._waiting[number] = answer
            try:
                if self._ended:
                    raise OSError("The pipe has ended.")
                self._pipe.send(Request(number, command))
            except OSError:
                self._waiting.pop(number).set_exception(_child_ended())
        return answer

    def close(self) -> None:
        """Close the pipe so that the child shuts down and exits; kill it if it does not exit in time."""
        self._closing = True
        with self._sending, contextlib.suppress(OSError):
            self._pipe.send(None)
        self._await_exit()
        self._reader.join(1.0)
        self._pipe.close()

    def _await_exit(self) -> None:
        self.process.join(PATIENCE_S)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()

    def _read(self) -> None:
        """Take messages until the pipe ends, then fail what waits for a reply."""
        try:
            with contextlib.suppress(EOFError, OSError):
                while True:
                    self._take(self._pipe.recv())
        except Exception:
            log.exception("A message of the process '%s' could not be dealt with.", self.process.name)
            with self._sending:
                self._pipe.close()
            self._await_exit()
        self.process.join(1.0)
        with self._sending:
            self._ended = True
        for number in list(self._waiting):
            self._waiting.pop(number).set_exception(_child_ended())
        if not self._closing:
            self._on_exit(self.process.exitcode)

    def _take(self, message: Any) -> None:
        if not isinstance(message, Reply):
            self._on_event(message)
        elif (answer := self._waiting.pop(message.number, None)) is None:
            log.error("The process '%s' replied to request %d twice.", self.process.name, message.number)
        elif message.error is not None:
            answer.set_exception(message.error)
        else:
            answer.set_result(message.value)


class ChildConnection:
    """Child's end of the pipe."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self._sending = threading.Lock()
        self._early: list[Request | None] = []

    def is_closed(self) -> bool:
        """Return whether the viewer has closed the pipe or is gone; `requests`, which come later, miss nothing."""
        try:
            while self._pipe.poll():
                self._early.append(self._pipe.recv())
        except (EOFError, OSError):
            self._early.append(None)
        return None in self._early

    def requests(self) -> Iterator[Request]:
        """Yield requests as they arrive, until the viewer closes the pipe or is gone."""
        with contextlib.suppress(EOFError, OSError):
            while (request := self._early.pop(0) if self._early else self._pipe.recv()) is not None:
                yield request

    def tell(self, event: Any) -> None:
        """Send an event to the viewer; it is dropped if the viewer is gone."""
        with self._sending, contextlib.suppress(OSError):
            self._pipe.send(event)

    def answer(self, request: Request, value: Any = None) -> None:
        """Reply to a request with its value."""
        self.tell(Reply(request.number, value))

    def refuse(self, request: Request, error: WaferViewerError) -> None:
        """Reply to a request with an error."""
        self.tell(Reply(request.number, error=error))


def run_in_background(niceness: int = 0) -> None:
    """Ignore SIGINT, since the viewer ends its children through their pipes, and lower this process's priority."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if niceness and hasattr(os, "nice"):
        os.nice(niceness)


def _child_ended() -> WaferViewerError:
    return ChildDied("The process that should do this has ended: try again, it is restarted.")


_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # malloc.h
_BLOCK = 256 * 1024
"""Bytes from which blocks are mapped: below the size of a tile's picture, above Python's frequent allocations."""


def return_what_is_freed() -> None:
    """Map large blocks separately for the whole process, so that freeing unmaps them; no effect without glibc."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, _BLOCK)
        mallopt(_M_TRIM_THRESHOLD, 4 * _BLOCK)
