"""Parser of GWY components into a tree of named values; arrays are views of the file."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAGIC = b"GWYP"
_DEEPEST = 16
_SIZES = {"b": 1, "c": 1, "i": 4, "q": 8, "d": 8}
_FORMS = {"b": "<?", "c": "<c", "i": "<i", "q": "<q", "d": "<d"}
_ARRAYS = {"C": "u1", "I": "<i4", "Q": "<i8", "D": "<f8"}
Tree = dict[str, Any]


def parsed(content: NDArray[np.uint8]) -> Tree:
    """Parse the container of a file. Raises ValueError or struct.error when the file ends too early."""
    return _Parser(content).whole()


class _Parser:
    """Component parser; arrays are views of the file. Raises ValueError or struct.error when it ends too early."""

    def __init__(self, content: NDArray[np.uint8]) -> None:
        self._content, self._at = content, len(MAGIC)

    def whole(self) -> Tree:
        """Return the container of the file."""
        return self._object(len(self._content), 0)

    def _object(self, limit: int, depth: int) -> Tree:
        if depth > _DEEPEST:
            raise ValueError("objects lie too deep in each other")
        self._text()
        (n_bytes,) = struct.unpack("<I", self._bytes(4))
        end = self._at + n_bytes
        if end > limit:
            raise ValueError("an object ends after the file")
        found: Tree = {}
        while self._at < end:
            name, kind = self._text(), self._bytes(1).decode("ascii")
            found[name] = self._value(kind, end, depth)
        return found

    def _value(self, kind: str, end: int, depth: int) -> Any:
        if kind == "o":
            return self._object(end, depth + 1)
        if kind == "s":
            return self._text()
        if kind in _SIZES:
            return struct.unpack(_FORMS[kind], self._bytes(_SIZES[kind]))[0]
        (n_items,) = struct.unpack("<I", self._bytes(4))
        if kind in _ARRAYS:
            dtype = np.dtype(_ARRAYS[kind])
            return np.frombuffer(self._view(n_items * dtype.itemsize), dtype)
        if kind == "S":
            return [self._text() for _ in range(n_items)]
        if kind == "O":
            return [self._object(end, depth + 1) for _ in range(n_items)]
        raise ValueError(f"a component is of an unknown kind {kind!r}")

    def _text(self) -> str:
        end = self._at
        while not (found := np.flatnonzero(self._content[end : end + 256] == 0)).size:
            end += 256
            if end >= len(self._content):
                raise ValueError("a text has no end")
        end += int(found[0])
        text = bytes(self._content[self._at : end]).decode()
        self._at = end + 1
        return text

    def _bytes(self, n: int) -> bytes:
        return bytes(self._view(n))

    def _view(self, n: int) -> NDArray[np.uint8]:
        if self._at + n > len(self._content):
            raise ValueError("the file ends too early")
        view = self._content[self._at : self._at + n]
        self._at += n
        return view
