"""The defect under review over the scene: place, reference and difference at one scale; below it the section."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser
from markupsafe import Markup

from wafer_viewer.draw.charts.axes import ChartAxes, PlotLook, line_svg, plot_html, round_ticks
from wafer_viewer.draw.colormaps import DIVERGING, PROFILE_COLOURS, css_gradient
from wafer_viewer.draw.number_format import length_text, number, round_length, tick_digits, ticks, with_unit
from wafer_viewer.draw.quantities import format_quantity
from wafer_viewer.draw.surface.pictures import LEAST_SPAN_GREY, LEAST_SPAN_UM
from wafer_viewer.gui.elements.elements import Elements, Html
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.overlays.hud import SheetRoom
from wafer_viewer.gui.presenters.review import chosen_defect, neighbour, review_items
from wafer_viewer.gui.state.view_state import Sheet, View
from wafer_viewer.gui.tools.region_tools import outline_of
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.ask import Answer
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.inspection.defect import Defect
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES
from wafer_viewer.session.inspection.reference_views import ELONGATED
from wafer_viewer.session.rendering.render_request import ComparisonView, ComparisonViews, Like
from wafer_viewer.session.state.snapshot import Snapshot

VIEWS = "defect compared"
TITLES: dict[Like, str] = {"here": "This place", "dies": "Other dies", "golden": "Golden die", "before": "Last scan"}
HEAD_PX, FOOT_PX, GAP_PX, PAD_PX, BAR_PX = 38, 22, 8, 12, 62
_BAR_OF_PICTURE, _STILL_PX = 0.4, 0.5
"""Maximum length of the scale bar as a share of a picture's width; offset of a scan that is not mentioned."""


@dataclass(frozen=True, slots=True)
class Sizes:
    """Sides of the large and the small pictures and height of the sheet, in CSS pixels."""

    large_px: int
    small_px: int
    sheet_px: int

    @classmethod
    def within(cls, room: SheetRoom) -> Sizes:
        """Return the sizes of the largest pictures that fit into the available area."""
        rest = HEAD_PX + FOOT_PX + 2 * PAD_PX
        by_width = (room.width_px - 2 * PAD_PX - BAR_PX - 1.5 * GAP_PX) / 1.5
        small = int((max(160, min(by_width, room.height_px - rest)) - GAP_PX) / 2)
        return cls(2 * small + GAP_PX, small, 2 * small + GAP_PX + rest)


def compared(here: Here[Any]) -> Answer[ComparisonViews]:
    """Return the views of the defect under review, and prepare those of the next one."""
    page, snapshot = here.page, here.snapshot
    defect = chosen_defect(snapshot, here.view.review)
    if defect is None or snapshot.surface is None or snapshot.dataset is None:
        return here.ask(VIEWS, None, None, NOT_MADE)
    recipe = snapshot.inspection.inspection.recipe if snapshot.inspection.inspection is not None else None
    about = (defect.number, defect.outline, snapshot.dataset.path, snapshot.surface.stamp, recipe)

    def make() -> ComparisonViews:
        views = page.session.defects.views
        if (answer := views.beside(defect.number).result()) is None:
            raise DatasetError("This place was not scanned.")
        ahead = neighbour(page.session.snapshot, page.view, 1)
        if ahead is not None and ahead.defect not in (None, defect.number):
            views.beside(ahead.defect)  # the painter keeps it
        return answer

    return here.ask(VIEWS, about, make, NOT_MADE, about=about)


NOT_MADE = "The pictures were not made"


def panes_sheet(here: Here[Any], room: SheetRoom) -> tuple[Markup, int]:
    """Return the pictures of the defect under review: place, reference and difference, with their scales."""
    answer, sizes = compared(here), Sizes.within(room)
    defect = chosen_defect(here.snapshot, here.view.review)
    words = html.empty(html.typeset(answer.problem) or "Making the pictures …")
    body, foot = Markup('<div class="wv-over-picture" style="grid-row:1/3">{}</div>').format(words), ""
    if defect is not None and answer.value is not None:
        panes = _Panes(defect, answer.value, here.view, sizes)
        body, foot = panes.drawn(), panes.foot()
    style = f"grid-template-columns:{sizes.large_px}px {sizes.small_px}px {BAR_PX}px;grid-auto-rows:{sizes.small_px}px"
    return (
        Markup('{}<div class="wv-beside" style="{}">{}</div><div class="wv-lab wv-sheet-foot">{}</div>').format(
            _head(here), style, body, foot
        ),
        sizes.sheet_px,
    )


def _head(here: Here[Any]) -> Markup:
    panes = html.segments("pane", PANES, here.view.pane, "Pictures of")
    to = html.pick("review-step", -1), html.pick("review-step", 1)
    return sheet_head(here.view, _position(here.snapshot, here.view), to, panes)


PANES = (("as seen", "As seen"), ("height", "Heights"), ("picture", "Picture"))
SHEETS: tuple[tuple[Sheet, str], ...] = (("beside", "Pictures"), ("gallery", "Gallery"), ("none", "3D"))


def sheet_head(view: View, position: str, to: tuple[Markup, Markup], *more: Markup) -> Markup:
    """Return the choice of what lies over the scene, the place in the list, and the ways back and forward."""
    ways = html.segments("sheet", SHEETS, view.sheet, "View of the defects · key Z")
    signs = (viser.Icon.CHEVRON_LEFT, "Previous"), (viser.Icon.CHEVRON_RIGHT, "Next")
    steps = Markup("").join(
        Markup('<span title="{0}" aria-label="{0}" class="wv-link" {1}>{2}</span>').format(
            name, pick, html.icon(sign, 18)
        )
        for (sign, name), pick in zip(signs, to, strict=True)
    )
    parts = Markup("").join((ways, *more))
    return Markup('<div class="wv-over-head">{}<span>{} {}</span></div>').format(parts, position, steps)


def _position(snapshot: Snapshot, view: View) -> str:
    items = [i for i in review_items(snapshot, view.review_filter, view.defects) if i.defect is not None]
    place = next((n for n, item in enumerate(items, 1) if item.key == view.review), None)
    return f"{place or '–'} of {number(len(items), 0)}"


@dataclass(frozen=True, slots=True)
class _Panes:
    """The three pictures of a defect."""

    defect: Defect
    answer: ComparisonViews
    view: View
    sizes: Sizes

    @property
    def by_grey(self) -> bool:
        return shows_grey(self.view, self.defect)

    def drawn(self) -> Markup:
        own, other = self.answer.views[0], reference(self.answer, self.view)
        below = html.typeset(f"die {self.defect.die}") if self.defect.die else "outside of the dies"
        reference_title, name = _named(other, self.answer.pixel_um) if other is not None else ("Reference", "")
        of = "picture" if self.by_grey else "heights"
        why = other.why_not if other is not None else "There is nothing to compare with."
        images = [
            (own.picture, own.height),
            (other.picture, other.height) if other else (b"", b""),
            (other.picture_difference, other.height_difference) if other else (b"", b""),
        ]
        jpegs = [grey if self.by_grey else height for grey, height in images]
        label = self._reference_choice() or Markup("<b>{}</b> {}").format(reference_title, name)
        cells = [
            self._pane(jpegs[0], Markup("<b>This place</b> {}").format(below), "", f"This place, {of}", large=True),
            self._pane(jpegs[1], label, why, f"{reference_title}, {of}"),
            self._bar(difference=False),
            self._pane(jpegs[2], Markup("<b>Difference</b>"), "", f"Difference, {of}"),
            self._bar(difference=True),
        ]
        return Markup("").join(cells)

    def foot(self) -> str:
        other = reference(self.answer, self.view)
        if other is None or other.why_not:
            return "Heights above the median of this place." if not self.by_grey else ""
        name = ": ".join(filter(None, _named(other, self.answer.pixel_um)))
        if self.by_grey:
            return f"Brightness matched · {name}"
        return f"Levelled heights over the reference's median · {name}"

    def _reference_choice(self) -> Markup:
        """Return the choice between the reference and the last scan, if there are both."""
        both = [one for one in self.answer.views[1:] if not one.why_not]
        if len(both) < 2:
            return Markup()
        options = [("before" if one.like == "before" else "reference", TITLES[one.like]) for one in both]
        return html.segments("compared", options, self.view.compared, "Compared with", "wv-by")

    def _pane(self, jpeg: bytes, label: Markup, why: str, name: str, large: bool = False) -> Markup:
        side = self.sizes.large_px if large else self.sizes.small_px
        span = "grid-row:1/3" if large else "grid-column:2"
        if not jpeg:
            inside = html.empty(html.typeset(why) or "Not measured here.")
        else:
            url = f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}"
            inside = Markup('<img alt="{}" src="{}">{}').format(name, url, self._over(side))
        return Markup('<div class="wv-over-picture" style="{}">{}<div class="wv-over-name">{}</div></div>').format(
            span, inside, label
        )

    def _over(self, side_px: int) -> Markup:
        """Return the outline of the defect, the section line and the scale bar over a picture, as SVG."""
        x0, _, x1, y1 = self.answer.box_um
        corners = outline_of(self.defect.outline)
        if len(corners) == 0:
            corners = np.array([(point.x_um, point.y_um) for point in self.defect.outline.points])
        ends = np.reshape(self.answer.section_um, (2, 2))
        at = [((xy - (x0, y1)) * (1, -1) / (x1 - x0) * side_px).round(1).tolist() for xy in (corners, ends)]
        outline, line = (" ".join(f"{x},{y}" for x, y in places) for places in at)
        colour = DEFECT_CLASSES[self.defect.seen_as].colour
        drawn = Markup(
            '<polygon points="{o}" stroke="#fff" stroke-width="3.4"/><polygon points="{o}" stroke="{colour}"/>'
            '<polyline points="{s}" stroke="#fff" stroke-width="2.6" opacity=".75"/>'
            '<polyline points="{s}" stroke="#15202B" stroke-dasharray="6 4"/>'
        ).format(o=outline, s=line, colour=colour)
        shapes = Markup('<g fill="none" stroke-width="1.6">{}</g>{}').format(drawn, _scale_bar(x1 - x0, side_px))
        return Markup('<svg viewBox="0 0 {0} {0}">{1}</svg>').format(side_px, shapes)

    def _bar(self, difference: bool) -> Markup:
        """Return a colour bar: of heights over the median of the reference, of greys, or of differences."""
        answer, grey = self.answer, self.by_grey
        if difference:
            half = answer.difference_grey if grey else answer.difference_um
            low, high = -half, half
        elif grey:
            return Markup('<div style="grid-column:3"></div>')
        else:
            low, high = answer.low_um - answer.zero_um, answer.high_um - answer.zero_um
        values = ticks(low, high, max(3, self.sizes.small_px // 36))
        marks = Markup("").join(
            Markup('<i style="bottom:{:.1f}%">{}</i>').format(
                100 * (value - low) / max(high - low, 1e-9), number(value, tick_digits(values), signed=True)
            )
            for value in values
        )
        gradient = css_gradient(DIVERGING if difference else "mako")
        bar = (
            '<div class="wv-over-bar" style="grid-column:3"><em>{}</em><u style="background:{}!important"></u>{}</div>'
        )
        return Markup(bar).format("grey" if grey else "µm", gradient, marks)


def shows_grey(view: View, defect: Defect) -> bool:
    """Return whether the pictures of a defect show grey values and not heights."""
    return view.pane == "picture" or (view.pane == "as seen" and defect.evidence == "picture")


def reference(answer: ComparisonViews, view: View) -> ComparisonView | None:
    """Return the view to compare with: the chosen one, else the one that there is."""
    of_scan = view.compared == "before"
    order = sorted(answer.views[1:], key=lambda one: (bool(one.why_not), (one.like == "before") != of_scan))
    return order[0] if order else None


def _named(shown: ComparisonView, pixel_um: float) -> tuple[str, str]:
    """Return the title and name of a view."""
    if shown.like == "before":
        away_um = math.hypot(*shown.moved_um)
        moved = "" if shown.why_not or away_um < _STILL_PX * pixel_um else f"found {with_unit(away_um, 1)} off"
        return TITLES["before"], " · ".join(part for part in (shown.name, moved) if part)
    median = f"median of {shown.dies}" if shown.dies else ""
    return TITLES[shown.like], " · ".join(part for part in (shown.name, median) if part)


def _scale_bar(width_um: float, side_px: int) -> Markup:
    length_um = round_length(_BAR_OF_PICTURE * width_um)
    length_px, foot = length_um / width_um * side_px, side_px - 8
    return Markup(
        '<text x="8" y="{}" font-size="11.5" fill="#fff" stroke="#15202B" stroke-width="3" '
        'paint-order="stroke">{}</text>'
        '<path d="M8 {foot}h{:.1f}" stroke="#15202B" stroke-width="5"/>'
        '<path d="M9 {foot}h{:.1f}" stroke="#fff" stroke-width="2.5"/>'
    ).format(foot - 6, length_text(length_um), length_px, length_px - 2, foot=foot)


# -------------------------------------------------------------------------------------------------------------- section


def section_dock(here: Here[Any]) -> Elements | None:
    """Return the section through the defect under review and through its reference, fitted to the plot."""
    defect = chosen_defect(here.snapshot, here.view.review)
    if defect is None:
        return []
    answer = here.ask.known(VIEWS) if here.view.sheet_over == "beside" else compared(here)
    curves = Markup(html.empty(answer.problem or "Measuring the section …"))
    if answer.value is not None:
        curves = section_plot(defect, answer.value, here.view)
    head = Markup(" ").join(Markup("<span>{}</span>").format(part) for part in _section_words(defect, here.view))
    return [
        Html(
            Markup('<div class="wv-below"><div class="wv-dock wv-tight"><b>Section</b>{}</div>{}</div>').format(
                head, curves
            )
        )
    ]


def _section_words(defect: Defect, view: View) -> Iterator[Markup]:
    height = Markup("height <b>{}</b>").format(format_quantity(defect.height.quantity, signed=True))
    yield Markup("{} {}").format(html.chip("A", PROFILE_COLOURS[0]), height)
    like = "last scan" if view.compared == "before" else "reference"
    where = "across it" if defect.major.value_um > ELONGATED * defect.minor.value_um else "along the rows"
    yield Markup("{} {} <span class=dim>{}<span class=wv-further>, dashed above</span></span>").format(
        html.chip("B", PROFILE_COLOURS[1]), like, where
    )


def section_plot(defect: Defect, answer: ComparisonViews, view: View) -> Markup:
    """Return the plot of both sections over the distance from the middle, the defect as a band."""
    own, other = answer.views[0], reference(answer, view)
    grey = shows_grey(view, defect)
    curves = [_values(own, grey, answer), *([_values(other, grey, answer)] if other is not None else [])]
    x0, y0, x1, y1 = answer.section_um
    half = math.hypot(x1 - x0, y1 - y0) / 2
    z_ends = _fitted(curves, LEAST_SPAN_GREY if grey else LEAST_SPAN_UM)
    x_ticks, y_ticks = round_ticks((-half, half), 9, signed=True), round_ticks(z_ends, 5, signed=not grey)
    axes = ChartAxes.stretched((-half, half), z_ends, x_ticks, y_ticks)
    band = _half_along(defect, answer)
    drawn = Markup('<rect x="{:.0f}" y="0" width="{:.0f}" height="1000" fill="{}" fill-opacity=".1"/>').format(
        axes.x.at(-band), axes.x.at(band) - axes.x.at(-band), DEFECT_CLASSES[defect.seen_as].colour
    )
    for curve, colour, width in reversed(list(zip(curves, PROFILE_COLOURS, (1.8, 1.5), strict=False))):
        drawn += Markup('<path class="wv-curve" d="{}" stroke="{}" stroke-width="{}"/>').format(
            _path(axes, np.linspace(-half, half, len(curve)), curve), colour, width
        )
    look = PlotLook("Section", "grey" if grey else "z, µm", "Distance from the middle, µm", classes="wv-profiles")
    return plot_html(axes, look, drawn + line_svg(axes.upright(0.0), "line", 1))


def _fitted(curves: Sequence[np.ndarray], least_span: float) -> tuple[float, float]:
    """Return ends that hold the section through the defect and nearly all of the other, with a margin."""
    known = [curve[np.isfinite(curve)] for curve in curves]
    ends = [np.percentile(values, (0, 100) if k == 0 else (2, 98)) for k, values in enumerate(known) if values.size]
    if not ends:
        return -1.0, 1.0
    low, high = float(min(low for low, _ in ends)), float(max(high for _, high in ends))
    margin = max(0.08 * (high - low), (least_span - (high - low)) / 2)
    return low - margin, high + margin


def _values(shown: ComparisonView, grey: bool, answer: ComparisonViews) -> np.ndarray:
    values: Sequence[float] = shown.section_grey if grey else shown.section
    return np.array(values, float) - (0.0 if grey else answer.zero_um)


def _half_along(defect: Defect, answer: ComparisonViews) -> float:
    """Return half the extent of the outline along the section."""
    corners = outline_of(defect.outline)
    if len(corners) == 0:
        return 0.0
    x0, y0, x1, y1 = answer.section_um
    along = np.array([x1 - x0, y1 - y0]) / max(math.hypot(x1 - x0, y1 - y0), 1e-9)
    places = corners @ along
    return float(places.max() - places.min()) / 2


def _path(axes: ChartAxes, x: np.ndarray, z: np.ndarray) -> str:
    """Return the measured pieces of a curve as a path."""
    known = np.isfinite(z)
    begins = known & ~np.concatenate([[False], known[:-1]])
    places = zip(begins[known], axes.x.at(x[known]), axes.y.at(z[known]), strict=True)
    return "".join(f"{'M' if new else 'L'}{a:.1f} {b:.1f}" for new, a, b in places)
