"""Colour range of the visible part of a surface."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace

import msgspec

from wafer_viewer.draw.surface.display_style import DisplayStyle
from wafer_viewer.gui.scene.lod.quadtree import Span
from wafer_viewer.gui.scene.reconciler import Paint
from wafer_viewer.gui.scene.scene_contents import DisplayedSurface
from wafer_viewer.session.rendering.render_request import ColourScale, RenderRequest, SurfaceStatistics

Corners = tuple[tuple[float, float], ...]
Range = tuple[float, float]
_PIXELS = 400_000
"""Most pixels evaluated for a range."""
_LEAST_PX = 8


def range_in_view(
    paint: Paint, on_show: DisplayedSurface, corners_um: Corners | None, then: Callable[[Range], None]
) -> None:
    """Call back, on another thread, with the central 99 % of the displayed quantity within `corners_um`; None: all.

    If the surface cannot be read the range is unchanged; the scene reports that error itself.
    """
    quantity, facts = on_show.scale.quantity, on_show.facts
    level, rows, cols = _window(facts, corners_um)
    request = RenderRequest(on_show.source, "scale", light=facts.light, datum=on_show.datum)
    request = replace(request, look=DisplayStyle(colour_by=quantity), level=level, rows=rows, cols=cols)  # pyright: ignore[reportArgumentType]

    def told(done: Future[bytes]) -> None:
        if not done.cancelled() and done.exception() is None:
            scale = msgspec.msgpack.decode(done.result(), type=ColourScale)
            then((scale.own_low, max(scale.own_high, scale.own_low + 1e-3)))

    paint(request).add_done_callback(told)


def _window(facts: SurfaceStatistics, corners_um: Corners | None) -> tuple[int, Span, Span]:
    """Return the finest level with few enough pixels, and the rows and columns within the corners."""
    rows, cols = (facts.first_row, facts.end_row), (facts.first_col, facts.end_col)
    if corners_um is not None:
        x, y = zip(*corners_um, strict=True)
        cols = _clipped((min(x) - facts.x0_um, max(x) - facts.x0_um), facts.pixel_um, cols)
        rows = _clipped((facts.y0_um - max(y), facts.y0_um - min(y)), facts.pixel_um, rows)
    n_pixels = (rows[1] - rows[0]) * (cols[1] - cols[0])
    level = max(0, math.ceil(math.log2(max(1.0, n_pixels / _PIXELS)) / 2))
    return level, _at_level(rows, level), _at_level(cols, level)


def _clipped(ends_um: tuple[float, float], pixel_um: float, within: Span) -> Span:
    """Return the pixels between two positions, limited to the span, and at least `_LEAST_PX` if it has as many."""
    first = min(max(within[0], round(ends_um[0] / pixel_um)), max(within[0], within[1] - _LEAST_PX))
    return first, max(min(within[1], round(ends_um[1] / pixel_um)), min(within[1], first + _LEAST_PX))


def _at_level(span: Span, level: int) -> Span:
    return span[0] >> level, max((span[0] >> level) + 1, -(-span[1] >> level))
