"""Histogram of the displayed heights; a drag brushes a range, which is highlighted and listed in numbers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import viser

from wafer_viewer.draw.charts.histogram_html import histogram_html
from wafer_viewer.draw.number_format import number, share, with_unit
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.scene.lod.surface_tiles import OWN_COLOURS
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.surface import histogram_pointer as pointer
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import BoundInput, HtmlBlock, button, in_a_row, set_prop
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.clipping import Box, Span
from wafer_viewer.session.rendering.render_request import Brushed, Statistics

FAILED = "The heights were not clipped"
_ROOM = 0.5
"""Margin around a place to be measured, as a share of its sides."""
_DECIMALS = 3


class HeightsSection:
    """Histogram and numbers of the brushed heights; in a point cloud its grips set the Z of the clip box."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._shown: Statistics | None = None
        gui = page.gui
        self._head = HtmlBlock(gui)
        self._area = HtmlBlock(gui)
        self._bars = HtmlBlock(gui)
        self._brush = self._ends("Brush, µm", self._typed_brush)
        self._numbers = HtmlBlock(gui)
        self._keep = button(gui, "Keep only these", viser.Icon.FILTER, guarded(page, FAILED)(lambda _: self._keep_it()))
        self._measure = button(
            gui, "Measure the place", viser.Icon.RULER_MEASURE, guarded(page, FAILED)(lambda _: self._measure_it())
        )
        in_a_row(gui, [self._keep, self._measure])
        page.on_pick(pointer.HISTOGRAM, self._dragged)
        page.on_pick("unbrush", lambda _: page.change(brush_um=None))

    def show(self, view: View) -> None:
        """Bring the section up to date with the page's statistics."""
        told = self._page.statistics
        there = told is not None and sum(told.counts) > 0
        self._shown = told if there else None
        clips = view.look == "points"
        set_prop(self._brush.handle, "visible", there)
        if told is None or not there:
            self._head.show("")
            self._area.show("")
            self._bars.show("")
            self._show_brushed(None)
            return
        self._head.show(_head(view))
        self._area.show(
            pointer.histogram_area(told.ends_um, view.brush_um, view.clip.heights_um if clips else None, clips=clips)
        )
        within = view.clip.heights_um if clips else None
        self._bars.show(histogram_html(told.counts, told.ends_um, self._colours(view), within))
        self._show_ends(self._brush, view.brush_um, told.span_um)
        self._show_brushed(told.brushed if view.brush_um is not None else None)

    # ---------------------------------------------------------------- bring up to date

    def _colours(self, view: View) -> tuple[str, float, float] | None:
        """Return colour map and range of the bars, as on the surface; None if it is not coloured by height."""
        scale, by = self._page.scale, self._page.coloured_by(view)
        if scale is None or by not in ("height", "difference") or scale.quantity != by:
            return None
        return OWN_COLOURS.get(by, view.colours), scale.low, scale.high

    def _show_ends(self, field: BoundInput[Any], span_um: Span | None, whole_um: Span) -> None:
        low, high = span_um or whole_um
        field.show((round(low, _DECIMALS), round(high, _DECIMALS)))

    def _show_brushed(self, brushed: Brushed | None) -> None:
        for handle in (self._keep, self._measure):
            set_prop(handle, "visible", brushed is not None)
            set_prop(handle, "disabled", brushed is None or brushed.n_points == 0)
        self._numbers.show("" if brushed is None else html.pairs(brushed_rows(brushed)))

    # ---------------------------------------------------------------- what the operator does

    def _ends(self, label: str, act: Any) -> BoundInput[Any]:
        handle = self._page.gui.add_vector2(label, (0.0, 0.0), step=0.1, visible=False)
        return BoundInput(handle, lambda event: act(event.target.value), self._page, FAILED)

    def _dragged(self, key: str) -> None:
        if self._shown is None:
            return
        drag = pointer.parse_drag(key, self._shown.ends_um, self._shown.span_um)
        if drag.act == "brush":
            self._page.change(brush_um=None if drag.is_click else _sorted(drag.from_um, drag.to_um))
            return
        low, high = self._page.view.clip.heights_um or self._shown.span_um
        self._clip_at((drag.to_um, high) if drag.act == "low" else (low, drag.to_um))

    def _typed_brush(self, ends: Span) -> None:
        if self._shown is not None:
            self._page.change(brush_um=_range_or_none(ends, self._shown.span_um))

    def _clip_at(self, ends: Span) -> None:
        if self._shown is not None:
            span = _range_or_none(ends, self._shown.span_um)
            self._page.change(clip=replace(self._page.view.clip, heights_um=span))

    def _keep_it(self) -> None:
        """Clip to the brushed heights and show the points."""
        view = self._page.view
        if view.brush_um is not None:
            self._page.change(look="points", clip=replace(view.clip, heights_um=view.brush_um), brush_um=None)

    def _measure_it(self) -> None:
        brushed = self._shown.brushed if self._shown is not None else None
        if brushed is not None and brushed.places:
            self._page.change(step="measure", tool="volume", places=(around(brushed.places[0]),), selected=None)


def brushed_rows(brushed: Brushed) -> list[tuple[str, str]]:
    """Return the numbers of the brushed heights as rows."""
    rows = [("Points", f"{number(brushed.n_points, 0)} · {share(brushed.fraction)}")]
    if brushed.mean_um is None:
        return rows
    spread = with_unit(brushed.spread_um, 2)
    rows.append(("Mean, spread (1 σ)", f"{number(brushed.mean_um, 2, signed=True)} · {spread}"))
    x0, y0, x1, y1 = brushed.places[0]
    at = f"x {number((x0 + x1) / 2, 0)}, y {with_unit((y0 + y1) / 2, 0)}"
    size = f"{number(x1 - x0, 0)} × {with_unit(y1 - y0, 0)}"
    many = "1 place" if brushed.n_places == 1 else f"Largest of {number(brushed.n_places, 0)} places"
    return [*rows, (many, at), ("Its size", size)]


def around(box: Box) -> Region:
    """Return a rectangle with a margin around a box."""
    x0, y0, x1, y1 = box
    dx, dy = _ROOM * (x1 - x0), _ROOM * (y1 - y0)
    return Region.rectangle(*(round(v, 2) for v in (x0 - dx, y0 - dy, x1 + dx, y1 + dy)))


def _head(view: View) -> str:
    if view.brush_um is None:
        return html.head("Heights", "Drag to brush")
    low, high = view.brush_um
    words = f"{number(low, 2, signed=True)} … {with_unit(high, 2, signed=True)}"
    clear = f'<span class="wv-link" title="Key Escape" {html.pick("unbrush")}>Clear</span>'
    sign = '<i class="wv-swatch-brush"></i> Brushed'
    return f'<div class="wv-h"><b>{sign}</b><span>{html.safe(words)} &ensp;{clear}</span></div>'


def _sorted(a: float, b: float) -> Span:
    return (a, b) if a <= b else (b, a)


def _range_or_none(ends: Span, whole_um: Span) -> Span | None:
    """Return a range of heights; None if it contains all heights or is empty."""
    low, high = float(ends[0]), float(ends[1])
    all_of_it = low <= whole_um[0] + 10**-_DECIMALS and high >= whole_um[1] - 10**-_DECIMALS
    return None if high <= low or all_of_it else (low, high)
