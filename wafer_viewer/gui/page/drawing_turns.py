"""Turns in which the pages of those who look on are drawn, so that those who work do not wait for them.

All pages are drawn by threads of one process, of which Python runs one at a time. While a scan runs, each of its ten
states a second is due on every page.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

_LOOK_S = 0.02
"""Interval in s at which a page that waits for its turn looks whether it has to hurry."""


class DrawingTurns:
    """Lets one page draw at a time, and those that have to hurry at any time.

    A turn lasts twice as long as its drawing: the rest is for the pages that hurry and for the session.
    """

    def __init__(self) -> None:
        self._turn = threading.Lock()

    def draw(self, draw: Callable[[], None], hurries: Callable[[], bool]) -> None:
        """Draw in turn, or at once if the page hurries, which may begin while it waits."""
        while not hurries():
            if self._turn.acquire(timeout=_LOOK_S):
                try:
                    begun_s = time.perf_counter()
                    draw()
                    time.sleep(time.perf_counter() - begun_s)
                finally:
                    self._turn.release()
                return
        draw()
