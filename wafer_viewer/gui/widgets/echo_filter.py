"""Ignore updates that only echo our own last writes."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")
_MOST = 64


class EchoFilter(Generic[T]):
    """Values that were sent and may be received again, in the order in which they were sent."""

    def __init__(self) -> None:
        self._told: deque[T] = deque(maxlen=_MOST)
        self._heard: T | None = None

    def tell(self, value: T) -> T:
        """Record a value that is being sent and return it."""
        self._told.append(value)
        return value

    def is_echo(self, value: T) -> bool:
        """Return whether a value was sent from here or received before; values sent before it are discarded."""
        if value == self._heard:
            return True
        self._heard = value
        if value not in self._told:
            self._told.clear()
            return False
        while self._told.popleft() != value:
            pass
        return True

    def forget(self) -> None:
        """Discard all sent values, so that nothing counts as an echo."""
        self._told.clear()
        self._heard = None
