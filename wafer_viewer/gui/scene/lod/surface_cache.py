"""Cache of surface information for one browser; each item is requested from the renderer once."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import msgspec

from wafer_viewer.draw.surface.display_style import DisplayStyle
from wafer_viewer.gui.scene.lod.datum_cache import DatumCache, FindDatum
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

Answer = TypeVar("Answer", SurfaceStatistics, ColourScale, CoarseHeightField)
_KEPT = 256


class SurfaceInfoCache:
    """Statistics, colour scales and coarse heights by request. Pending requests raise NotReady.

    All values are relative to the datum if one is given. `find_datum` is called on its own thread.
    """

    def __init__(self, paint: Paint, arrived: Callable[[], None], find_datum: FindDatum) -> None:
        self._orders = RenderQueue(paint, arrived)
        self._known: dict[RenderRequest, SurfaceStatistics | ColourScale | CoarseHeightField] = {}
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

    def facts_known(self, sources: dict[int, SurfaceKey]) -> dict[int, SurfaceStatistics]:
        """Return the statistics of the surfaces for which they are available, and request the others."""
        known: dict[int, SurfaceStatistics] = {}
        for number, source in sources.items():
            try:
                known[number] = self.facts(source)
            except NotReady:
                continue
        return known

    def scale(self, source: SurfaceKey, view: View, datum: Datum | None = None) -> ColourScale:
        """Return the colour scale of the displayed quantity, with the selected range or its default."""
        light, look = self.facts(source, datum).light, DisplayStyle(colour_by=view.colour_by)
        request = RenderRequest(source, "scale", look=look, light=light, range_values=view.range_um, datum=datum)
        return self._look_up(request, ColourScale)

    def relief(self, of: DisplayedSurface) -> CoarseHeightField:
        """Return the coarse heights of the displayed surface."""
        return self._look_up(RenderRequest(of.source, "relief", datum=of.datum), CoarseHeightField)

    def relief_if_known(self, source: SurfaceKey, datum: Datum | None) -> CoarseHeightField | None:
        """Return the coarse heights; None while they are pending."""
        try:
            return self._look_up(RenderRequest(source, "relief", datum=datum), CoarseHeightField)
        except NotReady:
            return None

    def _look_up(self, request: RenderRequest, kind: type[Answer]) -> Answer:
        known = self._known.get(request)
        if isinstance(known, kind):
            return known
        answer = msgspec.msgpack.decode(self._orders.outcome(request).result(), type=kind)
        while len(self._known) >= _KEPT:
            del self._known[next(iter(self._known))]
        self._known[request] = answer
        return answer
