"""What stands on one browser's stage: a list of items is compared with what is drawn, and only the rest is changed."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar, runtime_checkable

import viser

from wafer_viewer.gui.scene.send_window import SendWindow
from wafer_viewer.session.rendering.render_request import RenderRequest

T = TypeVar("T")
Handle = Any
"""A viser scene node handle; the kinds share `remove`, and those that are stretched `scale`."""
Make = Callable[[viser.SceneApi, str, bytes], Handle]
Paint = Callable[[RenderRequest], "Future[bytes]"]

_GRACE_S = 0.45
"""How long a tile stays after its successor was sent: the browser unpacks it meanwhile, and nothing flashes."""


@runtime_checkable
class Settling(Protocol):
    """A drawing that depends on how near one looks."""

    def settle(self, mm_per_pixel: float) -> None:
        """Be as is right for a pixel of this size."""
        ...


@dataclass(frozen=True, slots=True)
class TileExtent:
    """What an item covers: rows and columns of the surface that its layer shows."""

    layer: str
    rows: tuple[int, int]
    cols: tuple[int, int]

    def meets(self, other: TileExtent) -> bool:
        """Whether both cover some of the same."""
        return (
            self.layer == other.layer
            and self.rows[0] < other.rows[1]
            and other.rows[0] < self.rows[1]
            and self.cols[0] < other.cols[1]
            and other.cols[0] < self.cols[1]
        )


@dataclass(frozen=True, slots=True)
class SceneItem:
    """One thing in the scene. Items with the same name and content look alike; make(scene, node name, data) draws it.

    With a `request`, data is what the painter made of it. `stretched` items follow the exaggeration of heights. One
    that has a `cover` may leave as soon as others of its layer cover the same; one without, when all others are drawn.
    """

    name: str
    content: Hashable
    make: Make
    request: RenderRequest | None = None
    stretched: bool = False
    cover: TileExtent | None = None


@dataclass(slots=True)
class _Drawn:
    content: Hashable
    handle: Handle
    stretched: bool
    cover: TileExtent | None


class NotReady(Exception):  # nothing went wrong: no Error in its name
    """The answer is on its way; the scene is drawn again when it has come."""


class RenderQueue:
    """What was asked of the painter. It never waits: an answer that is not there yet calls `arrived` when it is."""

    def __init__(self, paint: Paint, arrived: Callable[[], None]) -> None:
        self._paint, self._arrived = paint, arrived
        self._open: dict[RenderRequest, Future[bytes]] = {}
        self._repeated: set[RenderRequest] = set()

    def outcome(self, request: RenderRequest, taken: bool = True) -> Future[bytes]:
        """The painter's answer, done. Raises NotYet; what failed is tried again when it is asked for again.

        What was lost with the painter's process is ordered once more, from the process that takes its place.
        taken: False has it made, and kept until it is asked for again.
        """
        future = self._open.get(request)
        if future is not None and request not in self._repeated and _is_lost(future):
            self._repeated.add(request)
            future = None
        if future is None or future.cancelled():
            future = self._open[request] = self._paint(request)
            if not future.done():
                future.add_done_callback(lambda done: None if done.cancelled() else self._arrived())
        if not future.done() or not taken:
            raise NotReady
        self._repeated.discard(request)
        return self._open.pop(request)

    def keep_only(self, wanted: set[RenderRequest]) -> None:
        """Withdraw the orders that no one waits for any more."""
        for request in [request for request in self._open if request not in wanted]:
            self._open.pop(request).cancel()
        self._repeated &= wanted


def _is_lost(future: Future[bytes]) -> bool:
    """Whether the process that was to answer has died."""
    return future.done() and not future.cancelled() and isinstance(future.exception(), BrokenProcessPool)


class SceneReconciler:
    """The nodes of one browser's scene, by item name. Used from one thread; it never waits."""

    def __init__(
        self, scene: viser.SceneApi, paint: Paint, arrived: Callable[[], None], gate: SendWindow | None = None
    ) -> None:
        self._scene, self._orders, self._gate = scene, RenderQueue(paint, arrived), gate
        self._drawn: dict[str, _Drawn] = {}
        self._leaving: list[tuple[float, Handle]] = []
        self._serial = 0
        self._stretch = 1.0

    @property
    def names(self) -> tuple[str, ...]:
        """What is drawn, by item name."""
        return tuple(name for name, drawn in self._drawn.items() if drawn.handle is not None)

    def show(self, items: Sequence[SceneItem], stretch: float) -> bool:
        """Draw what is missing and there to be drawn; whether that was all. What is not in the list leaves once
        nothing that would stand in its place is missing.

        Raises what went wrong in making an item, after all others are drawn; the same item is not tried again.
        """
        self._stretch_all(stretch)
        self._orders.keep_only({item.request for item in items if item.request is not None})
        missing = [item for item in items if not self._is_drawn(item)]
        faults: list[BaseException] = []
        waiting = [item for item in missing if not self._try(item, faults)]
        self._clear_away({item.name for item in items}, waiting)
        if faults:
            raise faults[0]
        return not waiting

    def settle(self, mm_per_pixel: float) -> None:
        """Have what lies in layers lie so far apart as is right for a pixel of this size."""
        for drawn in self._drawn.values():
            if isinstance(drawn.handle, Settling):
                drawn.handle.settle(mm_per_pixel)

    def each(self, kind: type[T]) -> list[T]:
        """What is drawn of one kind."""
        return [drawn.handle for drawn in self._drawn.values() if isinstance(drawn.handle, kind)]

    def tidy(self) -> float | None:
        """Remove what has had its grace; seconds until there is more to remove, None when there is not."""
        now = time.monotonic()
        for _, handle in [entry for entry in self._leaving if entry[0] <= now]:
            handle.remove()
        self._leaving = [entry for entry in self._leaving if entry[0] > now]
        return min((due for due, _ in self._leaving), default=now) - now if self._leaving else None

    def _clear_away(self, wanted: set[str], waiting: Sequence[SceneItem]) -> None:
        to_come = [item.cover for item in waiting if item.cover is not None]
        for name in [name for name in self._drawn if name not in wanted]:
            cover = self._drawn[name].cover
            if not waiting or (cover is not None and not any(cover.meets(other) for other in to_come)):
                self._let_leave(self._drawn.pop(name))

    def _is_drawn(self, item: SceneItem) -> bool:
        drawn = self._drawn.get(item.name)
        return drawn is not None and drawn.content == item.content

    def _try(self, item: SceneItem, faults: list[BaseException]) -> bool:
        """Draw an item if what it is made of is there."""
        data = b""
        if item.request is not None:
            try:
                outcome = self._orders.outcome(item.request, self._gate is None or self._gate.is_open)
            except NotReady:
                return False
            fault = outcome.exception()
            data = outcome.result() if fault is None else b""
            faults += [] if fault is None else [fault]
        self._draw(item, data)
        return True

    def _draw(self, item: SceneItem, data: bytes) -> None:
        self._serial += 1
        if self._gate is not None and data:
            self._gate.sent(len(data))
        empty = item.request is not None and not data
        handle = None if empty else item.make(self._scene, f"/{item.name}/{self._serial}", data)
        if handle is not None and item.stretched and self._stretch != 1:
            handle.scale = (1.0, 1.0, self._stretch)
        before = self._drawn.get(item.name)
        self._drawn[item.name] = _Drawn(item.content, handle, item.stretched, item.cover)
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
