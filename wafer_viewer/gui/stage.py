"""What stands on one browser's stage: a list of items is compared with what is drawn, and only the rest is changed."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import CancelledError, Future
from concurrent.futures import TimeoutError as NotYet
from dataclasses import dataclass
from typing import Any

import viser

from wafer_viewer.session.paint_request import PaintRequest

Handle = Any
"""A viser scene node handle; the kinds share `remove`, and those that are stretched `scale`."""
Make = Callable[[viser.SceneApi, str, bytes], Handle]
Paint = Callable[[PaintRequest], "Future[bytes]"]

_GRACE_S = 0.45
"""How long a tile stays after its successor was sent: the browser unpacks it meanwhile, and nothing flashes."""
_LOOK_UP_S = 0.05


@dataclass(frozen=True, slots=True)
class Item:
    """One thing in the scene. Items with the same name and content look alike; make(scene, node name, data) draws it.

    With a `request`, data is what the painter made of it. `stretched` items follow the exaggeration of heights.
    """

    name: str
    content: Hashable
    make: Make
    request: PaintRequest | None = None
    stretched: bool = False


@dataclass(slots=True)
class _Drawn:
    content: Hashable
    handle: Handle
    stretched: bool


class Superseded(Exception):  # nothing went wrong: no Error in its name
    """What is being drawn is no longer wanted."""


class Stage:
    """The nodes of one browser's scene, by item name. Used from one thread."""

    def __init__(self, scene: viser.SceneApi, paint: Paint) -> None:
        self._scene, self._paint = scene, paint
        self._drawn: dict[str, _Drawn] = {}
        self._leaving: list[tuple[float, Handle]] = []
        self._serial = 0
        self._stretch = 1.0

    def __contains__(self, name: str) -> bool:
        return name in self._drawn

    def show(self, items: Sequence[Item], stretch: float, is_stale: Callable[[], bool]) -> None:
        """Draw what is missing, then let what is not in the list leave.

        Raises Superseded as soon as `is_stale`; what was drawn by then stays and is compared again next time.
        """
        self._stretch_all(stretch)
        missing = [item for item in items if not self._is_drawn(item)]
        awaited = {i.name: self._paint(i.request) for i in missing if i.request is not None}
        try:
            for item in missing:
                self._draw(item, wait(awaited[item.name], is_stale) if item.name in awaited else b"")
        finally:
            for future in awaited.values():
                future.cancel()
        wanted = {item.name for item in items}
        for name in [name for name in self._drawn if name not in wanted]:
            self._let_leave(self._drawn.pop(name))

    def tidy(self) -> float | None:
        """Remove what has had its grace; seconds until there is more to remove, None when there is not."""
        now = time.monotonic()
        for _, handle in [entry for entry in self._leaving if entry[0] <= now]:
            handle.remove()
        self._leaving = [entry for entry in self._leaving if entry[0] > now]
        return min((due for due, _ in self._leaving), default=now) - now if self._leaving else None

    def _is_drawn(self, item: Item) -> bool:
        drawn = self._drawn.get(item.name)
        return drawn is not None and drawn.content == item.content

    def _draw(self, item: Item, data: bytes) -> None:
        self._serial += 1
        empty = item.request is not None and not data
        handle = None if empty else item.make(self._scene, f"/{item.name}/{self._serial}", data)
        if handle is not None and item.stretched and self._stretch != 1:
            handle.scale = (1.0, 1.0, self._stretch)
        before = self._drawn.get(item.name)
        self._drawn[item.name] = _Drawn(item.content, handle, item.stretched)
        if before is not None:
            self._let_leave(before)

    def _stretch_all(self, stretch: float) -> None:
        if stretch == self._stretch:
            return
        self._stretch = stretch
        for drawn in self._drawn.values():
            if drawn.stretched and drawn.handle is not None:
                drawn.handle.scale = (1.0, 1.0, stretch)

    def _let_leave(self, drawn: _Drawn) -> None:
        if drawn.handle is not None:
            self._leaving.append((time.monotonic() + _GRACE_S, drawn.handle))


def wait(future: Future[bytes], is_stale: Callable[[], bool]) -> bytes:
    """A future's answer. Raises Superseded when what it is for is stale or it was withdrawn, else what it raises."""
    while True:
        if is_stale():
            raise Superseded
        try:
            return future.result(_LOOK_UP_S)
        except NotYet:
            continue
        except CancelledError:
            raise Superseded from None
