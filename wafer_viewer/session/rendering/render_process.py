"""Render process: renders the page's pictures in a separate process, so that the page never waits for them."""

from __future__ import annotations

import dataclasses
import importlib
import multiprocessing
import threading
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import lru_cache
from typing import TYPE_CHECKING

from wafer_viewer.compute.child_process import end_with_parent, run_in_background
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.surface.comparison import ComparisonFace
from wafer_viewer.model.surface.height_map import Mosaic
from wafer_viewer.session.rendering.render_request import RenderRequest, SurfaceKey

if TYPE_CHECKING:
    from wafer_viewer.session.rendering.surface_source import PlacedField

__all__ = ["Painter", "RenderRequest", "SurfaceKey"]

_CACHE_BYTES = 48 * 2**20
"""Cache size in bytes for answers to other browsers: a few views of one browser."""
NICENESS = 5
"""Niceness of the render process."""


@dataclasses.dataclass(slots=True)
class _Rendering:
    """A request in the render process, and the futures of those who wait for it."""

    future: Future[bytes]
    answers: list[Future[bytes]] = dataclasses.field(default_factory=list[Future[bytes]])


class Painter:
    """Client of the render process, which answers `RenderRequest`s in order, one at a time.

    Answers are cached, so that a second browser gets them at once, and browsers that ask while one is rendered get the
    same bytes. A rendering is withdrawn when all its futures are cancelled. If the process dies, it is restarted with
    the next request; the futures it held raise BrokenProcessPool.
    """

    def __init__(self, work: Callable[[RenderRequest], bytes] | None = None) -> None:
        self._work = work or paint_from_store
        self._lock = threading.Lock()
        self._cache: OrderedDict[RenderRequest, bytes] = OrderedDict()
        self._cache_bytes = 0
        self._pending: dict[RenderRequest, _Rendering] = {}
        self._pool = _new_pool()
        self._pool.submit(_warm_up)

    def paint(self, request: RenderRequest) -> Future[bytes]:
        """Return the answer to a request, rendered or from the cache. The future raises WaferViewerErrors."""
        with self._lock:
            if request in self._cache:
                self._cache.move_to_end(request)
                return _done(self._cache[request])
            rendering = self._pending.get(request)
            is_new = rendering is None
            if rendering is None:
                rendering = self._pending[request] = _Rendering(self._submit(request))
            answer: Future[bytes] = Future()
            rendering.answers.append(answer)
        answer.add_done_callback(lambda done: self._withdraw(request, rendering) if done.cancelled() else None)
        if is_new:
            rendering.future.add_done_callback(lambda done: self._answer(request, rendering, done))
        return answer

    def close(self) -> None:
        """End the process; pending requests are cancelled."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _submit(self, request: RenderRequest) -> Future[bytes]:
        try:
            return self._pool.submit(self._work, request)
        except BrokenProcessPool:
            self._pool = _new_pool()
            return self._pool.submit(self._work, request)

    def _withdraw(self, request: RenderRequest, rendering: _Rendering) -> None:
        """Cancel a rendering that no one waits for any more."""
        with self._lock:
            if self._pending.get(request) is not rendering or not all(one.cancelled() for one in rendering.answers):
                return
            del self._pending[request]
        rendering.future.cancel()

    def _answer(self, request: RenderRequest, rendering: _Rendering, done: Future[bytes]) -> None:
        fault = None if done.cancelled() else done.exception()
        with self._lock:
            if self._pending.get(request) is rendering:
                del self._pending[request]
            if not done.cancelled() and fault is None:
                self._store(request, done.result())
        for answer in rendering.answers:
            if done.cancelled():
                answer.cancel()
            elif answer.set_running_or_notify_cancel():
                answer.set_result(done.result()) if fault is None else answer.set_exception(fault)

    def _store(self, request: RenderRequest, data: bytes) -> None:
        self._cache_bytes += len(data) - len(self._cache.pop(request, b""))
        self._cache[request] = data
        while self._cache_bytes > _CACHE_BYTES and len(self._cache) > 1:
            self._cache_bytes -= len(self._cache.popitem(last=False)[1])


def _done(data: bytes) -> Future[bytes]:
    future: Future[bytes] = Future()
    future.set_result(data)
    return future


def _new_pool() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"), initializer=_settle_in)


def _settle_in() -> None:
    """Lower the priority below the scan's, and end with the viewer even if that is killed."""
    run_in_background(NICENESS)
    end_with_parent()


def _warm_up() -> None:
    """Import the modules for the first picture while the page is still loading."""
    importlib.import_module("wafer_viewer.session.rendering.render_pictures")


def paint_from_store(request: RenderRequest) -> bytes:
    """Execute a request from the datasets on disk, in the render process."""
    from wafer_viewer.session.rendering.render_pictures import paint

    return paint(_STORE, request)


class _StoreShelf:
    """Surfaces and stacks from datasets; the last few used ones stay open."""

    def surface(self, source: SurfaceKey) -> Mosaic:
        return _surface(source)

    def stacks(self, source: SurfaceKey) -> list[FieldStack]:
        return _stacks(source)

    def fields(self, source: SurfaceKey) -> list[PlacedField]:
        return _fields(source)


_STORE = _StoreShelf()


@lru_cache(maxsize=4)
def _fields(source: SurfaceKey) -> list[PlacedField]:
    from wafer_viewer.session.rendering.surface_source import placed_fields

    return placed_fields(source)


@lru_cache(maxsize=12)
def _surface(source: SurfaceKey) -> Mosaic:
    from wafer_viewer.store.dataset.dataset import Dataset

    if source.show < 0:
        from wafer_viewer.session.surface.comparison_job import comparison_view

        return comparison_view(source.dataset, source.result, ComparisonFace(-source.show))
    dataset = Dataset.open(source.dataset)
    result = dataset.result(source.result)
    return result.mosaic() if source.show == 0 else result.surface(dataset.field(source.show))


@lru_cache(maxsize=2)
def _stacks(source: SurfaceKey) -> list[FieldStack]:
    from wafer_viewer.session.surface.focus_evidence import as_stitched
    from wafer_viewer.store.dataset.dataset import Dataset

    dataset = Dataset.open(source.dataset)
    if source.show:
        return [dataset.stack(source.show, verify=False)]
    complete = dataset.complete_fields()
    shown = as_stitched(dataset.fields, dataset.result(source.result).poses())
    return [
        dataclasses.replace(dataset.stack(field.number, verify=False), field=field)
        for field in shown
        if field.number in complete
    ]
