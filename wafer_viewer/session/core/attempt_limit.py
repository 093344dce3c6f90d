"""Limit of attempts to give a password, in a sliding window."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable

WINDOW_S = 60.0
MOST_OF_ONE, MOST_OF_ALL = 5, 30
"""Most attempts in the window, from one place and in all: with 12 characters nobody guesses the password."""


class AttemptLimit:
    """Limit of attempts in a sliding window, for each place, such as an address, and in all."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._attempts: deque[tuple[float, str]] = deque()
        self._lock = threading.Lock()

    def admit(self, place: str) -> bool:
        """Return whether a place may try now, and count the attempt if so; refused ones do not count."""
        with self._lock:
            now = self._clock()
            while self._attempts and now - self._attempts[0][0] >= WINDOW_S:
                self._attempts.popleft()
            of_one = sum(1 for _, other in self._attempts if other == place)
            if of_one >= MOST_OF_ONE or len(self._attempts) >= MOST_OF_ALL:
                return False
            self._attempts.append((now, place))
            return True

    def forget(self, place: str) -> None:
        """Forget the attempts of a place that knew the password."""
        with self._lock:
            self._attempts = deque(attempt for attempt in self._attempts if attempt[1] != place)
