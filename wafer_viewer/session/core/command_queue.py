"""Command queue of the session: one thread that runs commands in order; and the history that undoes them."""

from __future__ import annotations

import dataclasses
import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Generic, TypeVar

from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.roles import Action
from wafer_viewer.session.state.snapshot import Snapshot

T = TypeVar("T")
Listener = Callable[[Snapshot], None]
ANNOUNCE_EVERY_S = 0.1
"""Minimum time in seconds between two notifications of listeners; the first change is announced at once."""
log = logging.getLogger(__name__)


class CommandQueue:
    """Single-threaded command queue with an immutable snapshot, which can be read without a lock.

    The changes of a command become visible together when it ends. `snapshot` is the published state, `now` the state
    seen by the running command. audit: is told of each action that the audit log holds, with its details and outcome.
    """

    def __init__(self, snapshot: Snapshot) -> None:
        self.snapshot = self.now = snapshot
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="session")
        self._listeners: tuple[Listener, ...] = ()
        self._announced_at = 0.0
        self._timer: threading.Timer | None = None
        self._changed = threading.Condition()
        self._closed = False
        self.audit: Callable[[Action, str, Future[Any]], None] = lambda action, detail, outcome: None

    def do(self, command: Callable[..., Any], *args: Any, **kwargs: Any) -> Future[Any]:
        """Run a command on the session's thread.

        If the command returns a future, the answer is done when that future is.
        """
        future: Future[Any] = Future()
        if self._closed:
            future.set_exception(WaferViewerError("The session is closed: restart the viewer."))
        else:
            done = self._thread.submit(self._carry_out, command, *args, **kwargs)
            done.add_done_callback(lambda done: _copy_outcome(done, future))
        return future

    def then(self, first: Future[Any], command: Callable[[Any], Any]) -> Future[Any]:
        """Run a command with the result of `first`, unless that failed; the future is done when the command is."""
        future: Future[Any] = Future()

        def go_on(done: Future[Any]) -> None:
            failed = done.cancelled() or done.exception() is not None
            last = done if failed else self.do(command, done.result())
            last.add_done_callback(lambda last: _copy_outcome(last, future))

        first.add_done_callback(go_on)
        return future

    def afterwards(self, first: Future[Any], command: Callable[[], None]) -> Future[Any]:
        """Run a command after `first` is over, even if it failed; the future then has the outcome of `first`."""
        future: Future[Any] = Future()
        first.add_done_callback(lambda done: self.do(command).add_done_callback(lambda _: _copy_outcome(done, future)))
        return future

    def note(self, event: Callable[..., None], *args: Any) -> None:
        """Run the handler of an event; nobody waits for it, so failures are logged."""
        if not self._closed:
            self.do(event, *args).add_done_callback(_log_failure)

    def change(self, **fields: Any) -> None:
        """Change fields of the state; on the session's thread only."""
        self.now = dataclasses.replace(self.now, **fields)

    def subscribe(self, listener: Listener) -> Callable[[], None]:
        """Call `listener` with the latest snapshot after changes, until the returned function is called."""
        self._listeners = (*self._listeners, listener)

        def leave() -> None:
            self._listeners = tuple(other for other in self._listeners if other is not listener)

        return leave

    def wait_until(self, condition: Callable[[Snapshot], bool], timeout_s: float) -> Snapshot:
        """Wait, on a thread other than the session's, until `condition` holds for a snapshot, and return it.

        Raises TimeoutError when that does not happen in time.
        """
        with self._changed:
            if not self._changed.wait_for(lambda: condition(self.snapshot), timeout_s):
                raise TimeoutError(f"The session did not come to the awaited state within {timeout_s:g} s.")
            return self.snapshot

    def close(self) -> None:
        """Finish the running command and end the thread; queued commands are cancelled."""
        self._closed = True
        if self._timer is not None:
            self._timer.cancel()
        self._thread.shutdown(wait=True, cancel_futures=True)

    def _carry_out(self, command: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        try:
            return command(*args, **kwargs)
        finally:
            if self.now is not self.snapshot:
                self._publish()

    def _publish(self) -> None:
        """Publish all changes, and notify the listeners now or soon."""
        self.snapshot = self.now = dataclasses.replace(self.now, version=self.snapshot.version + 1)
        with self._changed:
            self._changed.notify_all()
        wait_s = self._announced_at + ANNOUNCE_EVERY_S - time.monotonic()
        if wait_s <= 0:
            self._announce()
        elif self._timer is None:
            self._timer = threading.Timer(wait_s, lambda: self.note(self._announce))
            self._timer.daemon = True
            self._timer.start()

    def _announce(self) -> None:
        self._timer = None
        self._announced_at = time.monotonic()
        for listener in self._listeners:
            listener(self.snapshot)


def _copy_outcome(done: Future[Any], future: Future[Any]) -> None:
    """Copy the outcome of `done` to `future`; if the result is a future, wait for it as well."""
    if done.cancelled():
        future.cancel()
    elif (fault := done.exception()) is not None:
        future.set_exception(fault)
    elif isinstance(outcome := done.result(), Future):
        outcome.add_done_callback(lambda last: _copy_outcome(last, future))
    else:
        future.set_result(outcome)


def _log_failure(done: Future[Any]) -> None:
    if not done.cancelled() and (fault := done.exception()) is not None:
        log.error("An event could not be dealt with.", exc_info=fault)


DEPTH = 200


class UndoHistory(Generic[T]):
    """Value with its earlier and undone values; at most `DEPTH` earlier values are stored."""

    def __init__(self, value: T) -> None:
        self.value = value
        self._before: list[T] = []
        self._undone: list[T] = []

    def put(self, value: T) -> None:
        """Set a new value; undone values are dropped."""
        self._before = [*self._before, self.value][-DEPTH:]
        self._undone = []
        self.value = value

    def undo(self) -> T:
        """Return to the previous value, if there is one."""
        if self._before:
            self._undone.append(self.value)
            self.value = self._before.pop()
        return self.value

    def redo(self) -> T:
        """Return to the value undone last, if there is one."""
        if self._undone:
            self._before.append(self.value)
            self.value = self._undone.pop()
        return self.value

    def restart(self, value: T) -> None:
        """Set a new value and clear the history."""
        self.value = value
        self._before, self._undone = [], []

    @property
    def can_undo(self) -> bool:
        """True if there is a previous value."""
        return bool(self._before)

    @property
    def can_redo(self) -> bool:
        """True if there is an undone value."""
        return bool(self._undone)
