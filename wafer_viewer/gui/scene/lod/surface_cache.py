"""What is known of the surfaces a browser looks at, asked of the painter once."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import msgspec

from wafer_viewer.draw.surface.display_style import Look
from wafer_viewer.gui.scene.lod.datum_cache import Datums, FindDatum
from wafer_viewer.gui.scene.reconciler import NotYet, Orders, Paint
from wafer_viewer.gui.scene.scene_contents import OnShow
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.model.measurement.levelling import Datum, Levelling
from wafer_viewer.session.rendering.render_request import Facts, PaintRequest, Relief, Scale, Source

Answer = TypeVar("Answer", Facts, Scale, Relief)
_KEPT = 256


class Book:
    """Facts, scales and reliefs by request. What is not known yet raises NotYet and is asked for meanwhile.

    All are over a datum where one is given. `find_datum` is asked on a thread of its own.
    """

    def __init__(self, paint: Paint, arrived: Callable[[], None], find_datum: FindDatum) -> None:
        self._orders = Orders(paint, arrived)
        self._known: dict[PaintRequest, Facts | Scale | Relief] = {}
        self._datums = Datums(find_datum, arrived)

    def close(self) -> None:
        """Let the thread go."""
        self._datums.close()

    def datum(self, source: Source, levelling: Levelling) -> Datum | None:
        """What counts as zero; None for the stage's own. Raises MeasureError when none can be laid."""
        return self._datums.of(source, levelling)

    def facts(self, source: Source, datum: Datum | None = None) -> Facts:
        """The surface as a whole."""
        return self._look_up(PaintRequest(source, "facts", datum=datum), Facts)

    def facts_known(self, sources: dict[int, Source]) -> dict[int, Facts]:
        """The facts of those surfaces that are known already; the others are asked for."""
        known: dict[int, Facts] = {}
        for number, source in sources.items():
            try:
                known[number] = self.facts(source)
            except NotYet:
                continue
        return known

    def scale(self, source: Source, view: View, datum: Datum | None = None) -> Scale:
        """The quantity that colours the surface, over the range chosen or its own."""
        light, look = self.facts(source, datum).light, Look(colour_by=view.colour_by)
        request = PaintRequest(source, "scale", look=look, light=light, range_values=view.range_um, datum=datum)
        return self._look_up(request, Scale)

    def relief(self, of: OnShow) -> Relief:
        """The coarse heights of the surface on show."""
        return self._look_up(PaintRequest(of.source, "relief", datum=of.datum), Relief)

    def relief_if_known(self, source: Source, datum: Datum | None) -> Relief | None:
        """The coarse heights, None while they are made."""
        try:
            return self._look_up(PaintRequest(source, "relief", datum=datum), Relief)
        except NotYet:
            return None

    def _look_up(self, request: PaintRequest, kind: type[Answer]) -> Answer:
        known = self._known.get(request)
        if isinstance(known, kind):
            return known
        answer = msgspec.msgpack.decode(self._orders.outcome(request).result(), type=kind)
        while len(self._known) >= _KEPT:
            del self._known[next(iter(self._known))]
        self._known[request] = answer
        return answer
