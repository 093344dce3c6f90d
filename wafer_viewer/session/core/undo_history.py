"""Undo: what was, what is, what was undone."""

from __future__ import annotations

from typing import Generic, TypeVar

T = TypeVar("T")
DEPTH = 200


class UndoHistory(Generic[T]):
    """A value with the values before it and those undone; the oldest are forgotten beyond `DEPTH`."""

    def __init__(self, value: T) -> None:
        self.value = value
        self._before: list[T] = []
        self._undone: list[T] = []

    def put(self, value: T) -> None:
        """A new value; what had been undone cannot be done again."""
        self._before = [*self._before, self.value][-DEPTH:]
        self._undone = []
        self.value = value

    def undo(self) -> T:
        """Back to the value before, if there is one."""
        if self._before:
            self._undone.append(self.value)
            self.value = self._before.pop()
        return self.value

    def redo(self) -> T:
        """Forth to the value that was undone last, if there is one."""
        if self._undone:
            self._before.append(self.value)
            self.value = self._undone.pop()
        return self.value

    def restart(self, value: T) -> None:
        """Another thing altogether: nothing before it can be undone."""
        self.value = value
        self._before, self._undone = [], []

    @property
    def can_undo(self) -> bool:
        """Whether there is a value before."""
        return bool(self._before)

    @property
    def can_redo(self) -> bool:
        """Whether there is an undone value."""
        return bool(self._undone)
