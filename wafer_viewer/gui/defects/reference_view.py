"""Views of the defect under review: pairs of pictures over the scene, and its profile in the bottom panel."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser
from markupsafe import Markup

from wafer_viewer.draw.charts.axes import symbol_svg
from wafer_viewer.draw.charts.profile_plot import frame_of, profile_plot_html
from wafer_viewer.draw.colormaps import PROFILE_COLOURS, css_gradient
from wafer_viewer.draw.number_format import length_text, number, round_length, tick_digits, ticks, with_unit
from wafer_viewer.draw.quantities import format_quantity
from wafer_viewer.gui.overlays.hud import OverScene, SheetRoom
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.panels import BottomPanel
from wafer_viewer.gui.page.preconditions import no_defect
from wafer_viewer.gui.presenters.defects import DefectCut, chosen_defect, cut_through
from wafer_viewer.gui.presenters.review import neighbour
from wafer_viewer.gui.state.view_state import OF_DEFECT, View
from wafer_viewer.gui.tools.region_tools import outline_of
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import LatestOnlyWorker, guarded
from wafer_viewer.gui.widgets.controls import Command, HtmlBlock, with_precondition
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.inspection.defect import Defect
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES
from wafer_viewer.model.measurement.sections import Section, SectionRequest
from wafer_viewer.session.rendering.render_request import ComparisonView, ComparisonViews, Like
from wafer_viewer.session.state.snapshot import Snapshot

TITLES: dict[Like, str] = {"here": "", "dies": "Other dies", "golden": "Golden die", "before": "Last scan"}
COLUMNS, ASPECT = 3, 4 / 3
HEAD_PX, NAMES_PX, FOOT_PX, GAP_PX, PAD_PX, BAR_PX = 30, 38, 24, 8, 12, 64
_BAR_OF_PICTURE = 0.4
"""Maximum length of the scale bar as a share of a picture's width."""
_STILL_PX = 0.5
"""Offset of a scan, in pixels, below which it is not mentioned."""


@dataclass(frozen=True, slots=True)
class Sizes:
    """Width and height of a picture and height of the sheet, in CSS pixels."""

    width_px: int
    height_px: int
    panel_px: int

    @classmethod
    def within(cls, room: SheetRoom) -> Sizes:
        """Return the sizes of the largest pictures that fit into the available area."""
        rest = HEAD_PX + NAMES_PX + FOOT_PX + 2 * PAD_PX + GAP_PX
        by_width = (room.width_px - 2 * PAD_PX - BAR_PX - COLUMNS * GAP_PX) / COLUMNS
        by_height = (room.height_px - rest) / 2 * ASPECT
        width = int(max(96, min(by_width, by_height)))
        height = round(width / ASPECT)
        return cls(width, height, 2 * height + rest)


def comparison_html(defect: Defect, answer: ComparisonViews, sizes: Sizes) -> Markup:
    """Return the sheet as HTML."""
    style = (
        f"grid-template-columns:repeat({COLUMNS},{sizes.width_px}px) {BAR_PX}px;"
        f"grid-template-rows:{NAMES_PX}px repeat(2,{sizes.height_px}px)"
    )
    columns = Markup("").join(_column(n, shown, defect, answer, sizes) for n, shown in enumerate(answer.views, 1))
    bar = Markup('<div style="grid-column:{};grid-row:2">{}</div>').format(COLUMNS + 1, _bar(answer, sizes.height_px))
    foot = Markup('<div class="wv-lab" style="height:{}px;padding-top:5px">{}</div>').format(FOOT_PX, _foot(answer))
    return Markup('{head}<div class="wv-beside" style="{style}">{columns}{bar}</div>{foot}').format(
        head=head(defect), style=style, columns=columns, bar=bar, foot=foot
    )


def head(defect: Defect) -> Markup:
    """Return the header with title and close link as HTML."""
    look = DEFECT_CLASSES[defect.seen_as]
    name = Markup("{} D{} · {} compared").format(symbol_svg(look.shape, look.colour), defect.number, look.title)
    away = Markup('<span class="wv-link" {}>Close · Z</span>').format(html.pick("sheet", "none"))
    return Markup('<div class="wv-over-head" style="height:{}px"><b>{}</b><span>{}</span></div>').format(
        HEAD_PX, name, away
    )


def _column(place: int, shown: ComparisonView, defect: Defect, answer: ComparisonViews, sizes: Sizes) -> Markup:
    title, below = _named(shown, defect, answer.pixel_um)
    names = Markup(
        '<div style="grid-column:{place};grid-row:1" class="wv-over-name"><b>{title}</b>'
        '<small title="{below}">{below}</small></div>'
    ).format(place=place, title=title, below=below)
    if shown.why_not:
        why = Markup('<div class="wv-empty">{}</div>').format(html.with_micro_sign(shown.why_not))
        return Markup('{}<div style="grid-column:{};grid-row:2/4">{}</div>').format(names, place, why)
    over = _over(defect, answer, sizes)
    cell = Markup('<div class="wv-over-picture" style="grid-column:{};grid-row:').format(place)
    height, picture = _image(shown.height, title, "heights"), _image(shown.picture, title, "in focus everywhere")
    return Markup('{names}{cell}2">{height}{over}</div>{cell}3">{picture}{over}</div>').format(
        names=names, cell=cell, height=height, over=over, picture=picture
    )


def _named(shown: ComparisonView, defect: Defect, pixel_um: float) -> tuple[str, str]:
    """Return the title and subtitle of a pair of pictures."""
    if shown.like == "here":
        return "This place", f"Die {defect.die}" if defect.die else "Outside of the dies"
    if shown.like == "before":
        return TITLES["before"], " · ".join(part for part in (shown.name, _moved(shown, pixel_um)) if part)
    median = f"median of {shown.dies}" if shown.dies else ""
    return TITLES[shown.like], " · ".join(part for part in (shown.name, median) if part)


def _moved(shown: ComparisonView, pixel_um: float) -> str:
    away_um = math.hypot(*shown.moved_um)
    return "" if shown.why_not or away_um < _STILL_PX * pixel_um else f"found {with_unit(away_um, 1)} off"


def _image(jpeg: bytes, title: str, what: str) -> Markup:
    if not jpeg:
        return html.empty("Not measured here.")
    url = f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}"
    return Markup('<img alt="{}, {}" src="{}">').format(title, what, url)


def _over(defect: Defect, answer: ComparisonViews, sizes: Sizes) -> Markup:
    """Return the overlay of a picture, the defect's outline and the scale bar, as SVG."""
    x0, y0, x1, y1 = answer.box_um
    corners = outline_of(defect.outline)
    if len(corners) == 0:
        corners = np.array([(point.x_um, point.y_um) for point in defect.outline.points])
    x = (corners[:, 0] - x0) / (x1 - x0) * sizes.width_px
    y = (y1 - corners[:, 1]) / (y1 - y0) * sizes.height_px
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True))
    colour = DEFECT_CLASSES[defect.seen_as].colour
    lines = Markup("").join(
        Markup('<polygon points="{}" fill="none" stroke="{}" stroke-width="{}"/>').format(points, ink, width)
        for ink, width in (("#fff", 4), (colour, 2))
    )
    return Markup('<svg viewBox="0 0 {width_px} {height_px}">{lines}{scale_bar}</svg>').format(
        width_px=sizes.width_px, height_px=sizes.height_px, lines=lines, scale_bar=_scale_bar(x1 - x0, sizes)
    )


def _scale_bar(width_um: float, sizes: Sizes) -> Markup:
    length_um = round_length(_BAR_OF_PICTURE * width_um)
    length_px, foot = length_um / width_um * sizes.width_px, sizes.height_px - 8
    text = Markup(
        '<text x="8" y="{}" font-size="11.5" fill="#fff" stroke="#15202B" stroke-width="3" '
        'paint-order="stroke">{}</text>'
    ).format(foot - 6, length_text(length_um))
    return Markup('{}<path d="M8 {}h{:.1f}" stroke="#15202B" stroke-width="5"/>').format(text, foot, length_px) + (
        Markup('<path d="M9 {}h{:.1f}" stroke="#fff" stroke-width="2.5"/>').format(foot, length_px - 2)
    )


def _bar(answer: ComparisonViews, height_px: int) -> Markup:
    """Return the colour bar of heights relative to the middle of the reference, as HTML."""
    low, high = answer.low_um - answer.zero_um, answer.high_um - answer.zero_um
    values = ticks(low, high, max(3, height_px // 40))
    digits = tick_digits(values)
    marks = Markup("").join(
        Markup('<i style="bottom:{:.1f}%">{}</i>').format(
            100 * (value - low) / max(high - low, 1e-9), number(value, digits, signed=True)
        )
        for value in values
    )
    return Markup('<div class="wv-over-bar"><u style="background:{}!important"></u>{}<em>µm</em></div>').format(
        css_gradient("mako"), marks
    )


def _foot(answer: ComparisonViews) -> str:
    compared = [shown for shown in answer.views[1:] if not shown.why_not]
    if not compared:
        return "Heights over the middle of the place."
    words = {"dies": "the other dies", "golden": "the golden die", "before": "the last scan"}
    span = with_unit(answer.high_um - answer.low_um, 1)
    return f"One scale for all, {span} from dark to bright, over the middle height of {words[compared[0].like]} here."


WAITING_PX = 120
Request = tuple[Any, ...]


class DefectBeside:
    """Comparison sheet of the defect under review; its pictures are requested on a worker thread."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._panel = OverScene(page)
        self._worker = LatestOnlyWorker("a defect compared")
        self._requested: Request | None = None
        self._answer: ComparisonViews | None = None
        self._problem = ""
        page.on_close(self._worker.close)
        page.on_pick("sheet", lambda which: page.change(sheet=which))

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the sheet up to date."""
        defect = chosen_defect(snapshot, view.review) if view.sheet_over == "beside" else None
        if defect is None or snapshot.surface is None or snapshot.dataset is None:
            self._panel.show("")
            return
        recipe = snapshot.inspection.inspection.recipe if snapshot.inspection.inspection is not None else None
        self._ask((defect.number, defect.outline, snapshot.dataset.path, snapshot.surface.stamp, recipe))
        sizes = Sizes.within(self._panel.room)
        if self._answer is not None:
            self._panel.show(comparison_html(defect, self._answer, sizes), sizes.panel_px)
        else:
            self._panel.show(_placeholder_html(defect, self._problem), HEAD_PX + WAITING_PX + 2 * PAD_PX)

    def commands(self) -> list[Command]:
        """Return the command that opens and closes the sheet."""
        icon = viser.Icon.LAYOUT_COLUMNS
        return with_precondition(no_defect, Command("Compare the defect", "Z", self.toggle, icon, group="Review"))

    def toggle(self) -> None:
        """Open or close the sheet."""
        shown = self._page.view.sheet_over == "beside"
        self._page.change(sheet="none" if shown else "beside")

    def _ask(self, request: Request) -> None:
        """Request the pictures, once per defect and surface."""
        if request != self._requested:
            self._requested, self._answer, self._problem = request, None, ""
            look = guarded(self._page, "The pictures were not made")(self._look)
            self._worker.ask(lambda: look(request))

    def _look(self, request: Request) -> None:
        """Fetch the pictures on the worker's thread; drop them if another defect is under review by then."""
        answer, problem = None, "This place was not scanned."
        try:
            answer = self._page.session.defects.views.beside(request[0]).result()
        except WaferViewerError as fault:
            problem = str(fault)
        if request == self._requested:
            self._answer, self._problem = answer, problem
            self._page.redraw()
            self._make_next(request[0])

    def _make_next(self, number: int) -> None:
        """Request the pictures of the next defect ahead of time; the painter caches them."""
        page = self._page
        view, snapshot = page.view, page.session.snapshot
        item = neighbour(snapshot, f"{OF_DEFECT}{number}", 1, view.review_filter, view.defects)
        if item is not None and item.defect not in (None, number):
            page.session.defects.views.beside(item.defect)


def _placeholder_html(defect: Defect, problem: str) -> Markup:
    """Return the placeholder shown until the pictures are ready, or if there are none, as HTML."""
    text = html.empty(html.with_micro_sign(problem) if problem else "Making the pictures …")
    return Markup('{}<div style="height:{}px">{}</div>').format(head(defect), WAITING_PX, text)


CUTTING = "Measuring the profile …"


class DefectDock:
    """Header with figures, and the plot, for the defect under review."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._worker = LatestOnlyWorker("section through a defect")
        self._requested: tuple[DefectCut, int] | None = None
        self._sections: tuple[Section, ...] = ()
        self._problem = ""
        self._panel = BottomPanel(page, "defect")
        with self._panel.tab:
            self._plot = HtmlBlock(page.gui)
        page.on_close(self._worker.close)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the curve up to date."""
        defect = chosen_defect(snapshot, view.review)
        if not self._panel.show(view) or defect is None or snapshot.surface is None:
            return
        cut = cut_through(defect, snapshot.inspection.inspection, snapshot.surface.pixel_um)
        if (cut, snapshot.surface.stamp) != self._requested:
            self._requested, self._sections, self._problem = (cut, snapshot.surface.stamp), (), ""
            measure = guarded(self._page, "The profile was not measured")(self._measure)
            request = self._requested
            self._worker.ask(lambda: measure(request))
        self._plot.show(Markup('<div class="wv-below">{}{}</div>').format(self._head(defect, cut), self._curves()))

    def _measure(self, request: tuple[DefectCut, int]) -> None:
        """Measure the profiles on the worker's thread; drop the result if another defect is under review by then."""
        cut, problem = request[0], ""
        sections: list[Section] = []
        for place, line in enumerate(cut.lines):
            try:
                wanted = SectionRequest(place, line, cut.show, cut.levelling)
                sections.append(self._page.session.sections.section(wanted))
            except WaferViewerError as fault:
                problem = problem or (str(fault) if place == 0 else "")
        if request == self._requested:
            self._sections, self._problem = tuple(sections), problem
            self._page.redraw()

    def _head(self, defect: Defect, cut: DefectCut) -> Markup:
        words = Markup(" ").join(
            Markup("<span>{}</span>").format(part) for part in _header_parts(defect, cut, len(self._sections))
        )
        return Markup('<div class="wv-dock wv-tight"><b>Profile through the defect</b>{}</div>').format(words)

    def _curves(self) -> Markup:
        if self._problem:
            return html.note("attention", "No profile", self._problem)
        if not self._sections:
            return html.empty(CUTTING)
        return profile_plot_html(self._sections, frame_of(self._sections), ())


def _header_parts(defect: Defect, cut: DefectCut, n_curves: int) -> Iterator[str]:
    height = Markup("height <b>{}</b>").format(format_quantity(defect.height.quantity, signed=True))
    yield Markup('{} {} <span class="dim wv-hint">through the middle</span>').format(
        html.chip("A", PROFILE_COLOURS[0]), height
    )
    if cut.neighbour and n_curves > 1:
        other = f"same row, die {cut.neighbour}"
        yield Markup('{} <span class="dim" title="{}">{}</span>').format(
            html.chip("B", PROFILE_COLOURS[1]), other, other
        )
