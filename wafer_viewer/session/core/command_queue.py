"""The session's desk: one thread that carries out verbs in order, the newest snapshot, and those who listen to it."""

from __future__ import annotations

import dataclasses
import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.session.state.snapshot import Snapshot

T = TypeVar("T")
Listener = Callable[[Snapshot], None]
ANNOUNCE_EVERY_S = 0.1
"""Listeners hear of the first change at once, and of those that follow at most this often."""
log = logging.getLogger(__name__)


class CommandQueue:
    """Changes happen on its one thread only; reading the snapshot needs no lock, for it is frozen.

    What a verb changes is seen together, when the verb has ended: `snapshot` is what all see, `now` what the verb
    sees that is being carried out.
    """

    def __init__(self, snapshot: Snapshot) -> None:
        self.snapshot = self.now = snapshot
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="session")
        self._listeners: tuple[Listener, ...] = ()
        self._announced_at = 0.0
        self._timer: threading.Timer | None = None
        self._changed = threading.Condition()
        self._closed = False

    def do(self, verb: Callable[..., Any], *args: Any, **kwargs: Any) -> Future[Any]:
        """Carry out a verb on the session's thread; one that answers with a future is done when that future is."""
        answer: Future[Any] = Future()
        if self._closed:
            answer.set_exception(WaferViewerError("The session is closed: restart the viewer."))
        else:
            done = self._thread.submit(self._carry_out, verb, *args, **kwargs)
            done.add_done_callback(lambda done: _hand_on(done, answer))
        return answer

    def then(self, first: Future[Any], verb: Callable[[Any], Any]) -> Future[Any]:
        """Carry out a verb with what `first` came to, unless it failed; done when the verb is."""
        answer: Future[Any] = Future()

        def go_on(done: Future[Any]) -> None:
            failed = done.cancelled() or done.exception() is not None
            last = done if failed else self.do(verb, done.result())
            last.add_done_callback(lambda last: _hand_on(last, answer))

        first.add_done_callback(go_on)
        return answer

    def afterwards(self, first: Future[Any], verb: Callable[[], None]) -> Future[Any]:
        """Carry out a verb once `first` is over, whatever it came to; done, as `first` was, when the verb is."""
        answer: Future[Any] = Future()
        first.add_done_callback(lambda done: self.do(verb).add_done_callback(lambda _: _hand_on(done, answer)))
        return answer

    def note(self, event: Callable[..., None], *args: Any) -> None:
        """Carry out what follows from an event; nobody waits for it, so what goes wrong is logged."""
        if not self._closed:
            self.do(event, *args).add_done_callback(_log_failure)

    def change(self, **fields: Any) -> None:
        """Change the state; on the session's thread only."""
        self.now = dataclasses.replace(self.now, **fields)

    def subscribe(self, listener: Listener) -> Callable[[], None]:
        """Call `listener` with the newest snapshot after changes, until the returned function is called."""
        self._listeners = (*self._listeners, listener)

        def leave() -> None:
            self._listeners = tuple(known for known in self._listeners if known is not listener)

        return leave

    def wait_until(self, condition: Callable[[Snapshot], bool], timeout_s: float) -> Snapshot:
        """Wait, on another thread than the session's, for a snapshot of which `condition` holds.

        Raises TimeoutError when none came in time.
        """
        with self._changed:
            if not self._changed.wait_for(lambda: condition(self.snapshot), timeout_s):
                raise TimeoutError(f"The session did not come to the awaited state within {timeout_s:g} s.")
            return self.snapshot

    def close(self) -> None:
        """Finish the verbs that were begun and let the thread go."""
        self._closed = True
        if self._timer is not None:
            self._timer.cancel()
        self._thread.shutdown(wait=True, cancel_futures=True)

    def _carry_out(self, verb: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        try:
            return verb(*args, **kwargs)
        finally:
            if self.now is not self.snapshot:
                self._publish()

    def _publish(self) -> None:
        """Show all what has changed, and tell the listeners now or soon."""
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


def _hand_on(done: Future[Any], answer: Future[Any]) -> None:
    """Give `answer` what `done` came to; a future as the outcome is waited for in its turn."""
    if done.cancelled():
        answer.cancel()
    elif (fault := done.exception()) is not None:
        answer.set_exception(fault)
    elif isinstance(outcome := done.result(), Future):
        outcome.add_done_callback(lambda last: _hand_on(last, answer))
    else:
        answer.set_result(outcome)


def _log_failure(done: Future[Any]) -> None:
    if not done.cancelled() and (fault := done.exception()) is not None:
        log.error("An event could not be dealt with.", exc_info=fault)
