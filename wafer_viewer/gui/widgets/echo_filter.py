"""Tells what was chosen elsewhere from what comes back of what was told from here."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")
_MOST = 64


class EchoFilter(Generic[T]):
    """Values that were told and may be heard again, in the order in which they were told."""

    def __init__(self) -> None:
        self._told: deque[T] = deque(maxlen=_MOST)
        self._heard: T | None = None

    def tell(self, value: T) -> T:
        """Remember a value that is told now."""
        self._told.append(value)
        return value

    def is_echo(self, value: T) -> bool:
        """Whether a value was told from here, or heard before; those told before it are past."""
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
        """From now on nothing is an echo."""
        self._told.clear()
        self._heard = None
