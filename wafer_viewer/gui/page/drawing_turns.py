"""Turns in which the pages of those who look on are drawn, so that those who work do not wait for them.

All pages are drawn by threads of one process, of which Python runs one at a time. While a scan runs, each of its ten
states a second is due on every page.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable

_LOOK_S = 0.02
"""Interval in s at which a page that waits for its turn looks whether it has to hurry."""
_REST = 2.0
"""Time that a turn leaves to others, in times of its drawing."""


class DrawingTurns:
    """Lets one page draw at a time, in the order in which they came, and those that have to hurry at any time.

    A turn lasts three times as long as its drawing: the rest is for the pages that hurry and for the session.
    """

    def __init__(self) -> None:
        self._moved = threading.Condition()
        self._queue = deque[object]()
        """Places of the pages that wait; the first one draws."""

    def draw(self, draw: Callable[[], None], hurries: Callable[[], bool]) -> None:
        """Draw in turn, or at once if the page hurries, which may begin while it waits."""
        if hurries() or not self._comes_first(place := object(), hurries):
            draw()
            return
        try:
            begun_s = time.perf_counter()
            draw()
            time.sleep(_REST * (time.perf_counter() - begun_s))
        finally:
            self._leave(place)

    def _comes_first(self, place: object, hurries: Callable[[], bool]) -> bool:
        """Wait in the queue; return False, having left it, if the page hurries before its turn comes."""
        with self._moved:
            self._queue.append(place)
            while self._queue[0] is not place:
                self._moved.wait(_LOOK_S)
                if hurries():
                    self._queue.remove(place)
                    return False
        return True

    def _leave(self, place: object) -> None:
        with self._moved:
            self._queue.remove(place)
            self._moved.notify_all()
