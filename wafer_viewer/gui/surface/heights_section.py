"""Heights section: histogram with a brushed range, and statistics of what is on show.

The panel, the histogram, the range of colours, the map and the export read the statistics from the page, so that they
agree.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import msgspec
import viser
from markupsafe import Markup

from wafer_viewer.draw.charts.colour_bar import HEIGHT_PX, histogram_html, place_of
from wafer_viewer.draw.number_format import number, share, with_unit
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.scene.reconciler import NotReady, RenderQueue
from wafer_viewer.gui.scene.scene_contents import DisplayedSurface
from wafer_viewer.gui.scene.surface_tiles import OWN_COLOURS
from wafer_viewer.gui.scenes.surface_scene import source_of
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import guarded
from wafer_viewer.gui.widgets.controls import BoundInput, HtmlBlock, button, in_a_row, set_prop
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.clipping import Box, Span
from wafer_viewer.session.rendering.render_request import Brushed, RenderRequest, Statistics
from wafer_viewer.session.state.snapshot import Snapshot, SurfaceInfo

HISTOGRAM = "histogram"
Act = Literal["brush", "low", "high"]
_ACTS: dict[str, Act] = {"brush": "brush", "low": "low", "high": "high"}
_GRIP_PX = 9
_CLICK, _AT_END = 0.008, 0.006
"""Shares of the histogram's width."""


def histogram_area(ends_um: Span, brush_um: Span | None, clip_um: Span | None, *, clips: bool) -> Markup:
    """Return the element over the bars as HTML.

    clips: add grips at the ends of `clip_um`, or of the histogram without one.
    """
    band = "display:none"
    if brush_um is not None:
        first, last = (place_of(z, ends_um) for z in brush_um)
        band = f"left:{100 * first:.3f}%;width:{100 * (last - first):.3f}%"
    grips = ""
    if clips:
        places = (0.0, 1.0) if clip_um is None else tuple(place_of(z, ends_um) for z in clip_um)
        grips = Markup("").join(
            Markup('<b data-grip="{}" style="left:{:.3f}%"></b>').format(name, 100 * fraction)
            for name, fraction in zip(("low", "high"), places, strict=True)
        )
    return Markup(
        '<div class="wv-over-hist"><div class="wv-brush" style="height:{height_px}px" '
        'title="Drag to brush heights, click to clear" data-drag="{drag}" data-grip-px="{grip_px}">'
        '<div style="{band}"></div>{grips}</div></div>'
    ).format(height_px=HEIGHT_PX, drag=HISTOGRAM, grip_px=_GRIP_PX, band=band, grips=grips)


@dataclass(frozen=True, slots=True)
class Drag:
    """Drag on the histogram: the brush or grip, and the heights at its start and end.

    is_click: it did not move. Within `_AT_END` of an end of the histogram it includes all heights beyond.
    """

    act: Act
    from_um: float
    to_um: float
    is_click: bool


def parse_drag(key: str, ends_um: Span, span_um: Span) -> Drag:
    """Parse a drag event; `span_um` is the lowest and the highest of all heights."""
    act, first, last = key.split(":")
    from_um, to_um = (_height(float(share), ends_um, span_um) for share in (first, last))
    return Drag(_ACTS.get(act, "brush"), from_um, to_um, abs(float(first) - float(last)) < _CLICK)


def _height(share: float, ends_um: Span, span_um: Span) -> float:
    if share <= _AT_END:
        return min(span_um[0], ends_um[0])
    if share >= 1 - _AT_END:
        return max(span_um[1], ends_um[1])
    return ends_um[0] + share * (ends_um[1] - ends_um[0])


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
        page.on_pick(HISTOGRAM, self._dragged)
        page.on_pick("unbrush", lambda _: page.change(brush_um=None))

    def show(self, view: View) -> None:
        """Bring the section up to date with the page's statistics."""
        statistics = self._page.statistics
        counted = statistics is not None and sum(statistics.counts) > 0
        self._shown = statistics if counted else None
        clips = view.look == "points"
        set_prop(self._brush.handle, "visible", counted)
        if statistics is None or not counted:
            self._head.show("")
            self._area.show("")
            self._bars.show("")
            self._show_brushed(None)
            return
        self._head.show(_head(view))
        self._area.show(
            histogram_area(statistics.ends_um, view.brush_um, view.clip.heights_um if clips else None, clips=clips)
        )
        within = view.clip.heights_um if clips else None
        self._bars.show(histogram_html(statistics.counts, statistics.ends_um, self._colours(view), within))
        self._show_ends(self._brush, view.brush_um, statistics.span_um)
        self._show_brushed(statistics.brushed if view.brush_um is not None else None)

    # ---------------------------------------------------------------- bring up to date

    def _colours(self, view: View) -> tuple[str, float, float] | None:
        """Return colour map and range of the bars, as on the surface; None if it is not coloured by height."""
        scale, by = self._page.scale, self._page.coloured_by(view)
        if scale is None or by not in ("height", "difference") or scale.quantity != by:
            return None
        return OWN_COLOURS.get(by, view.colours), scale.low, scale.high

    def _show_ends(self, field: BoundInput[Any], span_um: Span | None, full_um: Span) -> None:
        low, high = span_um or full_um
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
        drag = parse_drag(key, self._shown.ends_um, self._shown.span_um)
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
    position = f"x {number((x0 + x1) / 2, 0)}, y {with_unit((y0 + y1) / 2, 0)}"
    size = f"{number(x1 - x0, 0)} × {with_unit(y1 - y0, 0)}"
    many = "1 place" if brushed.n_places == 1 else f"Largest of {number(brushed.n_places, 0)} places"
    return [*rows, (many, position), ("Its size", size)]


def around(box: Box) -> Region:
    """Return a rectangle with a margin around a box."""
    x0, y0, x1, y1 = box
    dx, dy = _ROOM * (x1 - x0), _ROOM * (y1 - y0)
    return Region.rectangle(*(round(v, 2) for v in (x0 - dx, y0 - dy, x1 + dx, y1 + dy)))


def _head(view: View) -> Markup:
    if view.brush_um is None:
        return html.head("Heights", "Drag to brush")
    low, high = view.brush_um
    words = f"{number(low, 2, signed=True)} … {with_unit(high, 2, signed=True)}"
    clear = Markup('<span class="wv-link" title="Key Escape" {}>Clear</span>').format(html.pick("unbrush"))
    sign = Markup('<i class="wv-swatch-brush"></i> Brushed')
    return Markup('<div class="wv-h"><b>{}</b><span>{} &ensp;{}</span></div>').format(sign, words, clear)


def _sorted(a: float, b: float) -> Span:
    return (a, b) if a <= b else (b, a)


def _range_or_none(ends: Span, full_um: Span) -> Span | None:
    """Return a range of heights; None if it contains all heights or is empty."""
    low, high = float(ends[0]), float(ends[1])
    all_of_it = low <= full_um[0] + 10**-_DECIMALS and high >= full_um[1] - 10**-_DECIMALS
    return None if high <= low or all_of_it else (low, high)


Corners = tuple[tuple[float, float], ...]
_MAX_STORED = 64
_ROUNDED = 200
"""The view is rounded to this part of the surface, so that small camera moves start no new count."""


class ShownStatistics:
    """Part of the page that updates the statistics before the parts that show them; the painter counts."""

    def __init__(self, page: Page, view_um: Callable[[], Corners | None]) -> None:
        self._page, self._view_um = page, view_um
        self._orders = RenderQueue(page.session.paint, page.redraw)
        self._stored: dict[RenderRequest, Statistics] = {}
        self._counted_request: RenderRequest | None = None
        self.problem = ""

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Request new statistics if the displayed part has changed."""
        self.problem = ""
        request = self._request(snapshot, view)
        self._page.counted_um = request.box_um if request is not None else None
        if request is None:
            self._page.statistics = _of_all(snapshot, view)
            self._orders.keep_only(set())
            return
        self._orders.keep_only({request})
        try:
            self._page.statistics, self._counted_request = self._counted(request), request
        except NotReady:
            if self._counted_request is None or not _same_part(self._counted_request, request):
                self._page.statistics = _of_all(snapshot, view)
        except WaferViewerError as fault:
            self._page.statistics, self.problem = None, str(fault)

    def view_box_um(self) -> Box | None:
        """Return the box of the surface in view; None if all of it is."""
        return self._box_um(self._page.on_show, replace(self._page.view, counted="view"))

    def _request(self, snapshot: Snapshot, view: View) -> RenderRequest | None:
        on_show, source = self._page.on_show, source_of(snapshot, view.show)
        looked_at = view.step in ("surface", "measure") and not snapshot.scanning
        if not looked_at or on_show is None or source is None or on_show.source != source:
            return None
        if view.counted == "selection" and view.selection is None:
            return None
        return RenderRequest(
            source,
            "statistics",
            datum=on_show.datum,
            box_um=self._box_um(on_show, view),
            clip=view.clipped,
            brush_um=view.brush,
            refused=view.draws_refused,
        )

    def _box_um(self, on_show: DisplayedSurface | None, view: View) -> Box | None:
        if view.counted == "selection":
            return view.selection
        corners = self._view_um() if view.counted == "view" else None
        if corners is None or on_show is None:
            return None
        facts = on_show.facts
        step = facts.pixel_um * max(1, max(facts.rows, facts.cols) // _ROUNDED)
        x0, y1 = facts.x0_um, facts.y0_um
        x1, y0 = x0 + (facts.cols - 1) * facts.pixel_um, y1 - (facts.rows - 1) * facts.pixel_um
        xs, ys = ([round(v / step) * step for v in axis] for axis in zip(*corners, strict=True))
        box = max(x0, min(xs)), max(y0, min(ys)), min(x1, max(xs)), min(y1, max(ys))
        return None if box == (x0, y0, x1, y1) else box

    def _counted(self, request: RenderRequest) -> Statistics:
        """Return the statistics of a request. Raises NotReady, or WaferViewerError if they cannot be computed."""
        if request not in self._stored:
            statistics = msgspec.msgpack.decode(self._orders.outcome(request).result(), type=Statistics)
            self._stored = dict(list(self._stored.items())[1 - _MAX_STORED :])
            self._stored[request] = statistics
        return self._stored[request]


def _same_part(a: RenderRequest, b: RenderRequest) -> bool:
    """Return whether two requests count the same part apart from clip, brush and rejected points.

    The statistics of the first can then be shown until those of the second are ready.
    """
    return replace(a, clip=b.clip, brush_um=b.brush_um, refused=b.refused) == b


def _of_all(snapshot: Snapshot, view: View) -> Statistics | None:
    """Return the statistics that the session has of the whole stitched surface; None for any other part."""
    info = snapshot.surface
    unrestricted = view.show == 0 and view.counted == "all" and view.levelling.by == "stage"
    return _as_statistics(info) if info is not None and unrestricted else None


def _as_statistics(info: SurfaceInfo) -> Statistics:
    n = round(info.rows * info.cols * info.measured_fraction)
    return Statistics(
        rows=info.rows,
        cols=info.cols,
        pixel_um=info.pixel_um,
        n_heights=n,
        n_points=n,
        measured_fraction=info.measured_fraction,
        filled_fraction=info.filled_fraction,
        unmeasured=info.unmeasured,
        lowest_um=info.lowest_um,
        highest_um=info.highest_um,
        mean_um=None,
        spread_um=None,
    )
