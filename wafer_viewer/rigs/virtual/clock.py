"""Clock of the virtual rig: an event queue that runs during waits.

Time passes only in waits. By default it jumps to the next event as fast as the processor allows. In real time it
follows the wall clock, and overdue events run at the next wait, with their own time.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count


@dataclass(order=True, slots=True)
class Event:
    """Scheduled event; `action` is called with its time."""

    time_s: float
    number: int
    action: Callable[[float], None] = field(compare=False)
    cancelled: bool = field(default=False, compare=False)

    def cancel(self) -> None:
        """Cancel the event."""
        self.cancelled = True


class VirtualClock:
    """Implementation of Clock with event scheduling for the virtual devices. Not thread-safe."""

    def __init__(self, *, real_time: bool = False) -> None:
        self._real_time = real_time
        self._wall_origin_s = time.monotonic()
        self._now_s = 0.0
        self._events: list[Event] = []
        self._numbers = count()

    def now_s(self) -> float:
        """Return the seconds since the rig was switched on."""
        if self._real_time:
            return max(self._now_s, time.monotonic() - self._wall_origin_s)
        return self._now_s

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        self.wait_for(lambda: False, seconds)

    def at(self, time_s: float, action: Callable[[float], None]) -> Event:
        """Schedule an action at a time; one in the past runs at the next wait."""
        event = Event(time_s, next(self._numbers), action)
        heapq.heappush(self._events, event)
        return event

    def catch_up(self) -> None:
        """Run all events that are due."""
        self.sleep(0.0)

    def wait_for(self, ready: Callable[[], bool], timeout_s: float) -> bool:
        """Let time pass until `ready` or the timeout; return whether it is ready."""
        deadline_s = self.now_s() + timeout_s
        while not ready():
            event = self._next_event(deadline_s)
            if event is None:
                self._pass_to(deadline_s)
                return ready()
            self._pass_to(event.time_s)
            event.action(event.time_s)
        return True

    def _next_event(self, until_s: float) -> Event | None:
        while self._events and self._events[0].time_s <= until_s:
            event = heapq.heappop(self._events)
            if not event.cancelled:
                return event
        return None

    def _pass_to(self, time_s: float) -> None:
        if self._real_time:
            time.sleep(max(0.0, time_s - self.now_s()))
        self._now_s = max(self._now_s, time_s)
