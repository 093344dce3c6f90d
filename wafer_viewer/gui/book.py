"""What is known of the surfaces a browser looks at, asked of the painter once."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import msgspec

from wafer_viewer.draw.look import Look
from wafer_viewer.gui.stage import NotYet, Orders, Paint
from wafer_viewer.gui.view import View
from wafer_viewer.session.paint_request import Facts, PaintRequest, Relief, Scale, Source

Answer = TypeVar("Answer", Facts, Scale, Relief)
_KEPT = 256


class Book:
    """Facts, scales and reliefs by request. What is not known yet raises NotYet and is asked for meanwhile."""

    def __init__(self, paint: Paint, arrived: Callable[[], None]) -> None:
        self._orders = Orders(paint, arrived)
        self._known: dict[PaintRequest, Facts | Scale | Relief] = {}

    def facts(self, source: Source) -> Facts:
        """The surface as a whole."""
        return self._look_up(PaintRequest(source, "facts"), Facts)

    def facts_known(self, sources: dict[int, Source]) -> dict[int, Facts]:
        """The facts of those surfaces that are known already; the others are asked for."""
        known: dict[int, Facts] = {}
        for number, source in sources.items():
            try:
                known[number] = self.facts(source)
            except NotYet:
                continue
        return known

    def scale(self, source: Source, view: View) -> Scale:
        """The quantity that colours the surface, over the range chosen or its own."""
        light, look = self.facts(source).light, Look(colour_by=view.colour_by)
        return self._look_up(PaintRequest(source, "scale", look=look, light=light, range_values=view.range_um), Scale)

    def relief(self, source: Source) -> Relief:
        """The coarse heights."""
        return self._look_up(PaintRequest(source, "relief"), Relief)

    def _look_up(self, request: PaintRequest, kind: type[Answer]) -> Answer:
        known = self._known.get(request)
        if isinstance(known, kind):
            return known
        answer = msgspec.msgpack.decode(self._orders.outcome(request).result(), type=kind)
        while len(self._known) >= _KEPT:
            del self._known[next(iter(self._known))]
        self._known[request] = answer
        return answer
