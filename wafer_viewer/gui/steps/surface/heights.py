"""Heights of what is on show: histogram with a brushed range, and the statistics that all parts of the page read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import msgspec
import viser
from markupsafe import Markup

from wafer_viewer.draw.charts.colour_bar import HEIGHT_PX, histogram_html, place_of
from wafer_viewer.draw.number_format import number, share, with_unit
from wafer_viewer.gui.elements.elements import Button, Buttons, Html, NumberPair, Stack
from wafer_viewer.gui.elements.step import Here, Picks
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.scene.reconciler import NotReady, RenderQueue
from wafer_viewer.gui.scene.scene_contents import DisplayedSurface
from wafer_viewer.gui.scene.surface_tiles import OWN_COLOURS
from wafer_viewer.gui.scenes.surface_scene import source_of
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.clipping import Box, Span
from wafer_viewer.session.rendering.render_request import Brushed, RenderRequest, Statistics
from wafer_viewer.session.state.snapshot import Snapshot, SurfaceInfo

FAILED = "The heights were not clipped"
BRUSH_HINT = "Heights that light up in scene, map and profile, µm"
_ROOM = 0.5
"""Margin around a place to be measured, as a share of its sides."""
_DECIMALS = 3


def heights_section(page: Page, view: View) -> Stack | None:
    """Return histogram and numbers of the brushed heights; in a point cloud its grips set the Z of the clip box."""
    statistics = page.statistics
    if statistics is None or not sum(statistics.counts):
        return None
    ends_um, span_um, brush_um = statistics.ends_um, statistics.span_um, view.brush_um
    clips, clip_um = view.look == "points", view.clip.heights_um if view.look == "points" else None
    brushed = statistics.brushed if brush_um is not None else None

    def brush(ends: Span) -> None:
        page.change(brush_um=_range_or_none(ends, span_um))

    def keep() -> None:
        page.change(look="points", clip=replace(page.view.clip, heights_um=page.view.brush_um), brush_um=None)

    def measure() -> None:
        if brushed is not None and brushed.places:
            page.change(step="measure", tool="volume", places=(around(brushed.places[0]),), selected=None)

    low, high = (round(z, _DECIMALS) for z in brush_um or span_um)
    none, icon = brushed is None or not brushed.n_points, viser.Icon
    verbs = [
        Button("Show only these", keep, icon.FILTER, disabled=none),
        Button("Measure the place", measure, icon.RULER_MEASURE, disabled=none),
    ]
    elements = [
        Html(_head(view)),
        Html(histogram_area(ends_um, brush_um, clip_um, clips=clips)),
        Html(histogram_html(statistics.counts, ends_um, _colours(page, view), clip_um)),
        NumberPair("Brushed, µm", (low, high), brush, BRUSH_HINT) if brush_um is not None else None,
        Html("" if brushed is None else html.pairs(brushed_rows(brushed))),
        Buttons(verbs) if brushed is not None else None,
    ]
    return Stack(elements, failed=FAILED)


def _drag(here: Here[Any], key: str) -> None:
    """Brush heights by a drag over the histogram, or clip the point cloud by a grip."""
    page, statistics = here.page, here.page.statistics
    if statistics is None:
        return
    drag, span_um = parse_drag(key, statistics.ends_um, statistics.span_um), statistics.span_um
    if drag.act == "brush":
        page.change(brush_um=None if drag.is_click else _sorted(drag.from_um, drag.to_um))
        return
    low, high = page.view.clip.heights_um or span_um
    ends = (drag.to_um, high) if drag.act == "low" else (low, drag.to_um)
    page.change(clip=replace(page.view.clip, heights_um=_range_or_none(ends, span_um)))


def _brush_all(here: Here[Any], _: str) -> None:
    """Brush all heights, whose ends can then be typed."""
    if (statistics := here.page.statistics) is not None:
        here.page.change(brush_um=statistics.span_um)


HISTOGRAM = "histogram"
HEIGHT_PICKS: Picks[Any] = {
    HISTOGRAM: _drag,
    "brush": _brush_all,
    "unbrush": lambda here, _: here.page.change(brush_um=None),
}


def _colours(page: Page, view: View) -> tuple[str, float, float] | None:
    """Return colour map and range of the bars, as on the surface; None if it is not coloured by height."""
    scale, by = page.scale, page.coloured_by(view)
    if scale is None or by not in ("height", "difference") or scale.quantity != by:
        return None
    return OWN_COLOURS.get(by, view.colours), scale.low, scale.high


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
        return html.head("Heights", Markup("Drag to brush, or {}").format(html.link("type", "brush")))
    low, high = view.brush_um
    words = f"{number(low, 2, signed=True)} … {with_unit(high, 2, signed=True)}"
    clear = html.link("Clear", "unbrush", title="Key Escape")
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
