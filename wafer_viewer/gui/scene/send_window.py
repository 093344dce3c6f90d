"""Flow control of data sent to a browser: at most about one second's worth in flight, none while it is hidden.

A slow or hidden browser queues messages, and responses to the operator's input would wait behind them. After some bytes
the browser is therefore asked to respond, and unacknowledged bytes count as in flight.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

FIRST_BYTES, LEAST_BYTES, MOST_BYTES = 1_000_000, 100_000, 4_000_000
_GOAL_S = 0.8
Fence = Callable[[], object]
"""Returns when the browser has processed everything sent before; raises RuntimeError if the browser has gone."""


class SendWindow:
    """Counter of bytes in flight. `arrived` is called on another thread when the window has opened again."""

    def __init__(self, fence: Fence, arrived: Callable[[], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._fence, self._arrived, self._clock = fence, arrived, clock
        self._room, self._pairs_in_cells, self._since = FIRST_BYTES, 0, 0
        self._due = threading.Condition()
        self._closed = False
        threading.Thread(target=self._run, name="fence", daemon=True).start()

    @property
    def has_room(self) -> bool:
        """True if more may be sent now."""
        with self._due:
            return self._pairs_in_cells < self._room

    def sent(self, n_bytes: int) -> None:
        """Add bytes to those in flight."""
        with self._due:
            self._pairs_in_cells += n_bytes
            self._since += n_bytes
            self._due.notify()

    def close(self) -> None:
        """Stop the thread."""
        with self._due:
            self._closed = True
            self._due.notify()

    def _run(self) -> None:
        """Send one fence at a time, each for the bytes sent since the previous one."""
        while True:
            with self._due:
                self._due.wait_for(lambda: self._since > 0 or self._closed)
                if self._closed:
                    return
                asked, self._since = self._since, 0
            began = self._clock()
            try:
                self._fence()
            except RuntimeError:
                return
            self._answered(asked, self._clock() - began)

    def _answered(self, n_bytes: int, took_s: float) -> None:
        with self._due:
            was_full = self._pairs_in_cells >= self._room
            self._pairs_in_cells -= n_bytes
            if was_full or took_s > _GOAL_S:
                wanted = int(n_bytes * _GOAL_S / max(took_s, 1e-3))
                self._room = min(max(wanted, LEAST_BYTES, self._room // 2), MOST_BYTES, 2 * self._room)
        if was_full:
            self._arrived()
