"""What is known of the surfaces a browser looks at, asked of the painter once."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import msgspec

from wafer_viewer.draw.look import Look
from wafer_viewer.gui.stage import Paint, wait
from wafer_viewer.gui.view import View
from wafer_viewer.session.paint_request import Facts, PaintRequest, Relief, Scale, Source

Answer = TypeVar("Answer", Facts, Scale, Relief)
_KEPT = 256


class Book:
    """Facts, scales and reliefs by request. Asking may wait; it raises Superseded when the answer is not wanted."""

    def __init__(self, paint: Paint, is_stale: Callable[[], bool]) -> None:
        self._paint, self._is_stale = paint, is_stale
        self._known: dict[PaintRequest, Facts | Scale | Relief] = {}

    def facts(self, source: Source) -> Facts:
        """The surface as a whole."""
        request = PaintRequest(source, "facts")
        known = self._known.get(request)
        if isinstance(known, Facts):
            return known
        return self._note(request, msgspec.json.decode(self._ask(request), type=Facts))

    def scale(self, source: Source, view: View) -> Scale:
        """The quantity that colours the surface, over the range chosen or its own."""
        light = self.facts(source).light
        look = Look(colour_by=view.colour_by)
        request = PaintRequest(source, "scale", look=look, light=light, range_values=view.range_um)
        known = self._known.get(request)
        if isinstance(known, Scale):
            return known
        return self._note(request, msgspec.json.decode(self._ask(request), type=Scale))

    def relief(self, source: Source) -> Relief:
        """The coarse heights."""
        request = PaintRequest(source, "relief")
        known = self._known.get(request)
        if isinstance(known, Relief):
            return known
        return self._note(request, msgspec.msgpack.decode(self._ask(request), type=Relief))

    def _ask(self, request: PaintRequest) -> bytes:
        return wait(self._paint(request), self._is_stale)

    def _note(self, request: PaintRequest, answer: Answer) -> Answer:
        while len(self._known) >= _KEPT:
            del self._known[next(iter(self._known))]
        self._known[request] = answer
        return answer
