"""Undo history: earlier values, the current value and undone values."""

from __future__ import annotations

from typing import Generic, TypeVar

T = TypeVar("T")
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
