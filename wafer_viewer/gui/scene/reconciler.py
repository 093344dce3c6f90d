"""Keyed reconciliation of one browser's scene, with flow control of what is sent.

A slow or hidden browser queues messages, and responses to the operator's input would wait behind them. After some bytes
the browser is therefore asked to respond, and unacknowledged bytes count as in flight.
"""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar, runtime_checkable

import viser

from wafer_viewer.session.rendering.render_request import RenderRequest

FIRST_BYTES, LEAST_BYTES, MOST_BYTES = 1_000_000, 100_000, 4_000_000
_GOAL_S = 0.8
Fence = Callable[[], object]
"""Returns when the browser has processed everything sent before; raises RuntimeError if the browser has gone."""


class SendWindow:
    """Counter of bytes in flight. `arrived` is called on another thread when the window has opened again."""

    def __init__(self, fence: Fence, arrived: Callable[[], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._fence, self._arrived, self._clock = fence, arrived, clock
        self._room, self._in_flight, self._since = FIRST_BYTES, 0, 0
        self._due = threading.Condition()
        self._closed = False
        threading.Thread(target=self._run, name="fence", daemon=True).start()

    @property
    def has_room(self) -> bool:
        """True if more may be sent now."""
        with self._due:
            return self._in_flight < self._room

    @property
    def is_idle(self) -> bool:
        """True if the browser has processed all that was sent, or has gone."""
        with self._due:
            return self._in_flight == 0 or self._closed

    def sent(self, n_bytes: int) -> None:
        """Add bytes to those in flight."""
        with self._due:
            self._in_flight += n_bytes
            self._since += n_bytes
            self._due.notify()

    def close(self) -> None:
        """Stop the thread."""
        with self._due:
            self._closed = True
            self._due.notify()

    def _run(self) -> None:
        """Send one fence at a time, each for the bytes sent since the previous one."""
        while True:
            with self._due:
                self._due.wait_for(lambda: self._since > 0 or self._closed)
                if self._closed:
                    return
                requested, self._since = self._since, 0
            began = self._clock()
            try:
                self._fence()
            except RuntimeError:
                self.close()
                return
            self._answered(requested, self._clock() - began)

    def _answered(self, n_bytes: int, took_s: float) -> None:
        with self._due:
            was_full = self._in_flight >= self._room
            self._in_flight -= n_bytes
            if was_full or took_s > _GOAL_S:
                wanted = int(n_bytes * _GOAL_S / max(took_s, 1e-3))
                self._room = min(max(wanted, LEAST_BYTES, self._room // 2), MOST_BYTES, 2 * self._room)
        if was_full:
            self._arrived()


T = TypeVar("T")
Handle = Any
"""A viser scene node handle. All kinds have `remove`; scaled kinds have `scale`."""
Make = Callable[[viser.SceneApi, str, bytes], Handle]
Paint = Callable[[RenderRequest], "Future[bytes]"]

_GRACE_S = 0.45
"""Delay before a replaced tile is removed: the browser decodes its successor meanwhile, which avoids flicker."""


@runtime_checkable
class Settling(Protocol):
    """A drawing that depends on the zoom level."""

    def settle(self, mm_per_pixel: float) -> None:
        """Update for a pixel size."""
        ...


@dataclass(frozen=True, slots=True)
class TileExtent:
    """Rows and columns of the surface that an item covers, in its layer."""

    layer: str
    rows: tuple[int, int]
    cols: tuple[int, int]

    def meets(self, other: TileExtent) -> bool:
        """Return whether both extents overlap in the same layer."""
        return (
            self.layer == other.layer
            and self.rows[0] < other.rows[1]
            and other.rows[0] < self.rows[1]
            and self.cols[0] < other.cols[1]
            and other.cols[0] < self.cols[1]
        )


@dataclass(frozen=True, slots=True)
class SceneItem:
    """One scene item. make(scene, node name, data) draws it; equal name and content imply an equal drawing.

    request: render request whose result is passed to `make` as data.
    bake: returns the data for `make` where there is no request; browsers with equal name and content share it.
    stretched: True if the item follows the exaggeration of heights.
    cover: extent of the item. An obsolete item with a cover is removed as soon as other items of its layer cover the
    same extent; one without is removed when all other items are drawn.
    """

    name: str
    content: Hashable
    make: Make
    request: RenderRequest | None = None
    stretched: bool = False
    cover: TileExtent | None = None
    bake: Callable[[], bytes] | None = None


_BAKED_ITEMS = 12
"""Baked data that are kept: shadow, hatch, plinth and picture of the sample, in two colour schemes, and some more."""


class BakeCache:
    """Baked data of all browsers. They are baked one at a time, because baking takes several times their memory."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._baked: OrderedDict[Hashable, bytes] = OrderedDict()

    def data(self, item: SceneItem, bake: Callable[[], bytes]) -> bytes:
        """Return the data of an item, baked for the first browser that draws it."""
        key = item.name, item.content
        with self._lock:
            if key not in self._baked:
                self._baked[key] = bake()
                if len(self._baked) > _BAKED_ITEMS:
                    self._baked.popitem(last=False)
            self._baked.move_to_end(key)
            return self._baked[key]


_BAKED = BakeCache()


@dataclass(slots=True)
class _Drawn:
    content: Hashable
    handle: Handle
    stretched: bool
    cover: TileExtent | None


class NotReady(Exception):  # nothing went wrong: no Error in its name
    """Raised while a result is pending. The scene is drawn again when the result has arrived."""


class RenderQueue:
    """Pending render requests. It never blocks: `arrived` is called when a pending result becomes available."""

    def __init__(self, paint: Paint, arrived: Callable[[], None]) -> None:
        self._paint, self._arrived = paint, arrived
        self._open: dict[RenderRequest, Future[bytes]] = {}
        self._repeated: set[RenderRequest] = set()

    def outcome(self, request: RenderRequest, taken: bool = True) -> Future[bytes]:
        """Return the completed result of a request. Raises NotReady while it is pending.

        A failed request is retried when it is requested again. A request lost with its render process is submitted once
        more, to the replacement process.
        taken: False renders the result and stores it until it is requested again.
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
        """Cancel the pending requests that are not in `wanted`."""
        for request in [request for request in self._open if request not in wanted]:
            self._open.pop(request).cancel()
        self._repeated &= wanted


def _is_lost(future: Future[bytes]) -> bool:
    """Return whether the render process of a request has died."""
    return future.done() and not future.cancelled() and isinstance(future.exception(), BrokenProcessPool)


class SceneReconciler:
    """Nodes of one browser's scene by item name. Used from a single thread; it never blocks."""

    def __init__(
        self,
        scene: viser.SceneApi,
        paint: Paint,
        arrived: Callable[[], None],
        gate: SendWindow | None = None,
        baked: BakeCache = _BAKED,
    ) -> None:
        self._scene, self._orders, self._gate, self._baked = scene, RenderQueue(paint, arrived), gate, baked
        self._drawn: dict[str, _Drawn] = {}
        self._leaving: list[tuple[float, Handle]] = []
        self._serial = 0
        self._stretch = 1.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the drawn items."""
        return tuple(name for name, drawn in self._drawn.items() if drawn.handle is not None)

    def show(self, items: Sequence[SceneItem], stretch: float) -> bool:
        """Draw the missing items that are available; return whether all items are drawn.

        Items that are not in the list are removed once no replacement is missing.
        Raises the first error of drawing an item, after all other items are drawn. A failed item is not retried.
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
        """Update the drawings that depend on the pixel size."""
        for drawn in self._drawn.values():
            if isinstance(drawn.handle, Settling):
                drawn.handle.settle(mm_per_pixel)

    def each(self, kind: type[T]) -> list[T]:
        """Return the drawn handles of one type."""
        return [drawn.handle for drawn in self._drawn.values() if isinstance(drawn.handle, kind)]

    def remove_expired(self) -> float | None:
        """Remove the nodes whose delay has expired; return seconds until the next is due, None if there are none."""
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
        """Draw an item if its data is available; return whether it was processed."""
        data = b"" if item.bake is None else self._baked.data(item, item.bake)
        if item.request is not None:
            try:
                outcome = self._orders.outcome(item.request, self._gate is None or self._gate.has_room)
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
