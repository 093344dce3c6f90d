"""Colour range of the displayed surface: of the visible part, and steady while the surface grows.

Lighting, the height drawn at 0 and the colour range are derived from the entire surface. If they were recomputed with
every added field, every tile would have to be rendered again and measured parts would change colour.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from dataclasses import replace

import msgspec
import numpy as np

from wafer_viewer.draw.surface.display_style import DisplayStyle
from wafer_viewer.gui.scene.quadtree import Span
from wafer_viewer.gui.scene.reconciler import Paint
from wafer_viewer.gui.scene.scene_contents import DisplayedSurface
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.model.acquisition.plan import ScanPlan
from wafer_viewer.session.rendering.render_request import ColourScale, RenderRequest, SurfaceKey, SurfaceStatistics

_HEIGHTS, _RANGE, _DEEPER = 0.12, 0.04, 0.02
"""Tolerances as fractions of the span: heights, colour range, and depth below the lowest displayed height."""
_GAIN = 1.25


class DisplayRangeHysteresis:
    """Retained display statistics and colour scale of one scene."""

    def __init__(self) -> None:
        self._facts: tuple[Hashable, SurfaceStatistics] | None = None
        self._scale: tuple[Hashable, ColourScale] | None = None

    def facts(self, source: SurfaceKey, view: View, now: SurfaceStatistics) -> SurfaceStatistics:
        """Return the statistics of a surface with the previous heights and lighting, if they still fit."""
        key = (_place(source), view.colour_by in ("deviation", "form"))
        if self._facts is None or self._facts[0] != key or not _fits(self._facts[1], now, key[1]):
            self._facts = key, now
        held = self._facts[1]
        return msgspec.structs.replace(
            now,
            lowest_um=held.lowest_um,
            low_um=held.low_um,
            high_um=held.high_um,
            gain=held.gain,
            plane=held.plane,
            form=held.form,
        )

    def scale(self, source: SurfaceKey, view: View, now: ColourScale) -> ColourScale:
        """Return the scale with the previous colour range if it still fits; a manual range is unchanged."""
        if view.range_um is not None:
            return now
        key, spare = (_place(source), now.quantity), _RANGE * (now.high - now.low)
        held = self._scale[1] if self._scale is not None and self._scale[0] == key else None
        if held is None or max(abs(held.low - now.low), abs(held.high - now.high)) > spare:
            self._scale = key, now
            return now
        return msgspec.structs.replace(now, low=held.low, high=held.high)


def _place(source: SurfaceKey) -> Hashable:
    return source.dataset, source.result, source.show


def _fits(held: SurfaceStatistics, now: SurfaceStatistics, with_plane: bool) -> bool:
    span = max(held.high_um - held.low_um, 1e-6)
    moved = max(abs(held.low_um - now.low_um), abs(held.high_um - now.high_um), now.lowest_um - held.lowest_um)
    deeper = held.lowest_um - now.lowest_um > _DEEPER * span
    relit = not 1 / _GAIN < now.gain / held.gain < _GAIN
    return (
        moved <= _HEIGHTS * span and not deeper and not relit and not (with_plane and _plane_changed(held, now, span))
    )


def _plane_changed(held: SurfaceStatistics, now: SurfaceStatistics, span: float) -> bool:
    """Return whether the reference plane of deviations differs noticeably at the corners of the surface."""
    x = now.x0_um + np.array([now.first_col, now.end_col]) * now.pixel_um
    y = now.y0_um - np.array([now.first_row, now.end_row]) * now.pixel_um
    (a, b, c), (a0, b0, c0) = now.plane, held.plane
    off = np.abs((a - a0) * x[:, None] + (b - b0) * y[None, :] + (c - c0))
    return bool(off.max() > _DEEPER * span)


def as_planned(facts: SurfaceStatistics, plan: ScanPlan) -> SurfaceStatistics:
    """Return the statistics with a window that covers all planned fields, so that it stays constant during a scan."""
    half_x, half_y = plan.cols * plan.pixel_um / 2, plan.rows * plan.pixel_um / 2
    x, y = [f.x_um for f in plan.fields], [f.y_um for f in plan.fields]
    cols = _indices((min(x) - half_x - facts.x0_um, max(x) + half_x - facts.x0_um), facts.pixel_um, facts.cols)
    rows = _indices((facts.y0_um - max(y) - half_y, facts.y0_um - min(y) + half_y), facts.pixel_um, facts.rows)
    return msgspec.structs.replace(
        facts,
        first_row=min(rows[0], facts.first_row),
        end_row=max(rows[1], facts.end_row),
        first_col=min(cols[0], facts.first_col),
        end_col=max(cols[1], facts.end_col),
    )


def _indices(ends_um: tuple[float, float], pixel_um: float, n: int) -> tuple[int, int]:
    first, end = round(ends_um[0] / pixel_um), round(ends_um[1] / pixel_um)
    return min(max(0, first), n - 1), min(max(1, end), n)


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

    def completed(done: Future[bytes]) -> None:
        if not done.cancelled() and done.exception() is None:
            scale = msgspec.msgpack.decode(done.result(), type=ColourScale)
            then((scale.own_low, max(scale.own_high, scale.own_low + 1e-3)))

    paint(request).add_done_callback(completed)


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
