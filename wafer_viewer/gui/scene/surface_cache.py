"""Caches of one browser: surface information, height datums, and height ranges of tiles."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import lru_cache
from typing import TypeVar

import msgspec
import numpy as np

from wafer_viewer.draw.surface.display_style import DisplayStyle
from wafer_viewer.gui.scene.quadtree import Heights, Span
from wafer_viewer.gui.scene.reconciler import NotReady, Paint, RenderQueue
from wafer_viewer.gui.scene.scene_contents import DisplayedSurface
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.model.measurement.levelling import Datum, Levelling
from wafer_viewer.session.rendering.render_request import (
    CoarseHeightField,
    ColourScale,
    RenderRequest,
    SurfaceKey,
    SurfaceStatistics,
)

FindDatum = Callable[[Levelling, int], Datum]
_MAX_DATUMS = 64


class DatumCache:
    """Datums by surface and levelling. `arrived` is called on another thread when one is available."""

    def __init__(self, find: FindDatum, arrived: Callable[[], None]) -> None:
        self._find, self._arrived = find, arrived
        self._requested: dict[tuple[SurfaceKey, Levelling], Future[Datum]] = {}
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="datum")

    def of(self, source: SurfaceKey, levelling: Levelling) -> Datum | None:
        """Return the datum, None for the stage's zero. Raises NotReady; MeasureError if it cannot be determined."""
        if levelling.by == "stage":
            return None
        future = self._requested.get((source, levelling))
        if future is None:
            while len(self._requested) >= _MAX_DATUMS:
                del self._requested[next(iter(self._requested))]
            future = self._requested[source, levelling] = self._pool.submit(self._find, levelling, source.show)
            future.add_done_callback(lambda _: self._arrived())
        if not future.done():
            raise NotReady
        return future.result()

    def close(self) -> None:
        """Stop the thread."""
        self._pool.shutdown(wait=False, cancel_futures=True)


Answer = TypeVar("Answer", SurfaceStatistics, ColourScale, CoarseHeightField)
_MAX_ENTRIES = 256


class SurfaceInfoCache:
    """Statistics, colour scales and coarse heights by request. Pending requests raise NotReady.

    All values are relative to the datum if one is given. `find_datum` is called on its own thread.
    """

    def __init__(self, paint: Paint, arrived: Callable[[], None], find_datum: FindDatum) -> None:
        self._orders = RenderQueue(paint, arrived)
        self._answers: dict[RenderRequest, SurfaceStatistics | ColourScale | CoarseHeightField] = {}
        self._datums = DatumCache(find_datum, arrived)

    def close(self) -> None:
        """Stop the thread."""
        self._datums.close()

    def datum(self, source: SurfaceKey, levelling: Levelling) -> Datum | None:
        """Return the zero-height datum; None for the stage's zero. Raises MeasureError if it cannot be determined."""
        return self._datums.of(source, levelling)

    def facts(self, source: SurfaceKey, datum: Datum | None = None) -> SurfaceStatistics:
        """Return the statistics of the surface."""
        return self._look_up(RenderRequest(source, "facts", datum=datum), SurfaceStatistics)

    def available_facts(self, sources: dict[int, SurfaceKey]) -> dict[int, SurfaceStatistics]:
        """Return the statistics of the surfaces for which they are available, and request the others."""
        facts: dict[int, SurfaceStatistics] = {}
        for number, source in sources.items():
            try:
                facts[number] = self.facts(source)
            except NotReady:
                continue
        return facts

    def scale(self, source: SurfaceKey, view: View, datum: Datum | None = None) -> ColourScale:
        """Return the colour scale of the displayed quantity, with the selected range or its default."""
        light, look = self.facts(source, datum).light, DisplayStyle(colour_by=view.colour_by)
        request = RenderRequest(source, "scale", look=look, light=light, range_values=view.range_um, datum=datum)
        return self._look_up(request, ColourScale)

    def relief(self, shown: DisplayedSurface) -> CoarseHeightField:
        """Return the coarse heights of the displayed surface."""
        return self._look_up(RenderRequest(shown.source, "relief", datum=shown.datum), CoarseHeightField)

    def available_relief(self, source: SurfaceKey, datum: Datum | None) -> CoarseHeightField | None:
        """Return the coarse heights; None while they are pending."""
        try:
            return self._look_up(RenderRequest(source, "relief", datum=datum), CoarseHeightField)
        except NotReady:
            return None

    def _look_up(self, request: RenderRequest, kind: type[Answer]) -> Answer:
        cached = self._answers.get(request)
        if isinstance(cached, kind):
            return cached
        answer = msgspec.msgpack.decode(self._orders.outcome(request).result(), type=kind)
        while len(self._answers) >= _MAX_ENTRIES:
            del self._answers[next(iter(self._answers))]
        self._answers[request] = answer
        return answer


_MAX_RANGES = 4096


def heights_of(on_show: DisplayedSurface, relief: CoarseHeightField | None) -> Heights:
    """Return a function for the lowest and highest scene z (mm) of a part; the global range without a relief."""
    facts = on_show.facts
    full_range = on_show.scene_z(facts.low_um), on_show.scene_z(facts.high_um)
    if relief is None:
        return lambda rows, cols: full_range
    z_um = np.frombuffer(relief.z_um, "<f4").reshape(relief.rows, relief.cols)
    scale = relief.pixel_um / facts.pixel_um

    @lru_cache(maxsize=_MAX_RANGES)
    def heights(rows: Span, cols: Span) -> tuple[float, float]:
        (r0, r1), (c0, c1) = (_part(span, scale, n) for span, n in zip((rows, cols), z_um.shape, strict=True))
        part = z_um[r0:r1, c0:c1]
        return on_show.scene_z(float(part.min())), on_show.scene_z(float(part.max()))

    return heights


def _part(span: Span, scale: float, n: int) -> Span:
    """Convert a span of level 0 to pixels of the relief, at least one."""
    first = min(max(0, int(span[0] / scale)), n - 1)
    return first, max(first + 1, min(n, int(np.ceil(span[1] / scale))))
