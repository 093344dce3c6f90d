"""Point cloud in the step Surface: its points, refused ones, and the clip box; the number of points over the scene."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import viser
from markupsafe import Markup

from wafer_viewer.draw.colormaps import ORIGIN_COLOURS
from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.elements.elements import Button, Buttons, Html, NumberPair, Slider, Stack, Toggle
from wafer_viewer.gui.elements.step import Here, Overlay
from wafer_viewer.gui.overlays.hud import EDGE_PX
from wafer_viewer.gui.overlays.hud import WIDTH_PX as LEGEND_PX
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.scene.scene_contents import DisplayedSurface
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.tools.clip_box import ClipBoxFaces
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.surface.clipping import Box, LeftOut, Span
from wafer_viewer.model.surface.height_map import ORIGIN_TITLES, Origin
from wafer_viewer.session.rendering.render_request import RefusedCounts, Statistics

FAILED = "The points were not changed"
REFUSED: tuple[tuple[bool, str], ...] = ((False, "Hide"), (True, "Show"))
NO_FIELDS = "This surface has no fields, and so no refused points."
NOT_STORED = "The fields were reconstructed before refused points were kept: reconstruct them again."
_MEGA, _KILO = 1e6, 1e3
WORDS: dict[LeftOut, str] = {
    "box": "outside of the box",
    "height": "clipped",
    "confidence": "under {confidence}",
    "slab": "before the slab",
}
SIZE_HINT = "Of a point on the screen, at the place looked at"
SHADE_HINT = "Shade in hollows, so that points of one colour show their relief; 0 draws none"
LEAST_HINT = "Confidence that a point needs to be drawn; 0 draws all"
REFUSED_HINT = "Points that gates refused, at the height of their refused peak, coloured by reason"


def points_section(page: Page, view: View) -> Stack:
    """Return the settings of the point cloud, and the number of points that are drawn."""
    statistics, clip = page.statistics, view.clip

    def confidence(least: float) -> None:
        page.change(clip=replace(page.view.clip, least_confidence=round(least, 3)))

    shares = _shares(statistics, page.drawn_points) if statistics is not None else Markup()
    percent = round(100 * view.depth_shade, 3)
    elements = [
        Html(html.head("Points") + shares),
        Slider("Size, px", view.point_px, lambda px: page.change(point_px=px), SIZE_HINT, least=1, most=8, step=0.5),
        Slider("Shade, %", percent, lambda p: page.change(depth_shade=p / 100), SHADE_HINT, most=100, step=5),
        Slider("Minimum confidence", clip.least_confidence, confidence, LEAST_HINT),
        Toggle("Refused points", view.refused, lambda on: page.change(refused=on), REFUSED_HINT, options=REFUSED),
        Html(_refused_words(statistics, view)),
    ]
    return Stack(elements, failed=FAILED)


def counted(statistics: Statistics, drawn: int, view: View) -> Markup:
    """Return the number of drawn points of all, and the reasons for the others, as HTML."""
    refused = statistics.refused
    n_all, n_left, left_out = _totals(statistics)
    rest = [
        f"{amount(left_out[why])} {words.format(confidence=number(view.clip.least_confidence, 2))}"
        for why, words in WORDS.items()
        if left_out.get(why, 0)
    ]
    nearer = n_left - drawn
    if nearer > 0.005 * n_all:
        rest.append(f"{amount(nearer)} when nearer or in view")
    if refused is not None and refused.n_heights:
        rest.insert(0, f"{amount(refused.n_heights)} of them refused")
    details = Markup(' <span class="dim">· {}</span>').format(Markup(" · ").join(rest)) if rest else Markup()
    return Markup("<b>{} of {} points</b>{}").format(amount(min(drawn, n_all)), amount(n_all), details)


def amount(n: float) -> str:
    """Return a number in short form: ``845``, ``12 k``, ``1.2 M``."""
    if n >= 0.9995 * _MEGA:
        return f"{number(n / _MEGA, 1)} M"
    return f"{number(n / _KILO, 0 if n >= 9950 else 1)} k" if n >= _KILO else number(n, 0)


def refused_legend(refused: RefusedCounts) -> Markup:
    """Return the legend of rejection reasons with their colours and counts, most frequent first, as HTML."""
    reasons = sorted(refused.by_reason.items(), key=lambda item: -item[1])
    rows = Markup("").join(
        Markup("{}<span>{}</span><b>{}</b>").format(
            html.swatch(f"rgb{ORIGIN_COLOURS[Origin(code)]}!important", "var(--ink3)"),
            ORIGIN_TITLES[Origin(code)],
            number(n, 0),
        )
        for code, n in reasons
    )
    return Markup('<div class="wv-reasons">{}</div>').format(rows) if rows else Markup()


def _refused_words(statistics: Statistics | None, view: View) -> Markup:
    """Return the legend of rejected points, or the reason why there are none, as HTML."""
    if not view.refused:
        return Markup()
    if view.show < 0:
        return html.remark(NO_FIELDS)
    refused = statistics.refused if statistics is not None else None
    if refused is None:
        return html.remark("Counting …")
    if refused.n_fields == 0:
        return html.remark(NO_FIELDS)
    if refused.n_fields_without == refused.n_fields:
        return html.remark(NOT_STORED)
    some = f"Not kept for {refused.n_fields_without} of {refused.n_fields} fields: reconstruct those again."
    none = "No point was refused here." if not refused.n_heights else "The clip leaves none of the refused points."
    return (refused_legend(refused) or html.remark(none)) + (html.remark(some) if refused.n_fields_without else "")


def _totals(statistics: Statistics) -> tuple[int, int, dict[LeftOut, int]]:
    """Return the number of all points, of those within the clip, and of the others by reason.

    Rejected points are included if they are drawn.
    """
    refused = statistics.refused
    if refused is None:
        return statistics.n_heights, statistics.n_points, statistics.left_out
    left_out: dict[LeftOut, int] = {why: statistics.left_out.get(why, 0) + n for why, n in refused.left_out.items()}
    return statistics.n_heights + refused.n_heights, statistics.n_points + refused.n_points, left_out


def _shares(statistics: Statistics, drawn: int) -> Markup:
    """Return a bar of the points drawn, drawn when closer, and clipped, as HTML."""
    n_all, n_left, _ = _totals(statistics)
    total = max(1, n_all)
    now, later = 100 * min(1.0, drawn / total), 100 * max(0.0, (n_left - drawn) / total)
    return Markup(
        '<div class="wv-share" style="margin:0 0 6px">'
        '<i style="width:{:.1f}%"></i><i style="width:{:.1f}%;opacity:.3"></i></div>'
    ).format(now, later)


CLIP_FAILED = "The clip box was not changed"
DECIMALS = 2
Ends = tuple[float, float]
AXES = ("X", "Y", "Z")
BOX_HINTS = (
    "Clip box along X, from and to, stage µm",
    "Clip box along Y, from and to, stage µm",
    "Heights of the clip box, from and to, µm over the zero chosen",
)
"""Hints of the axes of the clip box."""


def clip_section(page: Page, view: View, view_um: Callable[[], Box | None]) -> Stack:
    """Return the clip box in numbers; the handles on its faces in the scene are equivalent."""

    def whole() -> Box:
        if page.on_show is None:
            raise MeasureError("The surface is not drawn yet: place the box when it is.")
        return page.on_show.box_um

    def clip(**changes: Box | Span | None) -> None:
        page.change(clip=replace(page.view.clip, **changes))  # pyright: ignore[reportArgumentType]

    def put(box_um: Callable[[], Box | None]) -> None:
        """Clip to a rectangle in stage um; without one to all of the surface, so that its faces can be dragged."""
        clip(box_um=box_um() or whole())

    def typed(axis: int, ends: Ends) -> None:
        low, high = ends
        if not low < high:
            raise MeasureError(f"{AXES[axis]} ends at {high:g} um, before it begins at {low:g} um: swap them.")
        if axis == 2:
            clip(heights_um=(low, high))
        elif (extent := _extent(page, page.view)) is not None:
            (x0, x1), (y0, y1) = extent[:2]
            clip(box_um=(low, y0, high, y1) if axis == 0 else (x0, low, x1, high))

    extent, icon = _extent(page, view), viser.Icon
    free = view.clip.box_um is None and view.clip.heights_um is None
    numbers = (_rounded(extent[k]) if extent is not None else (0.0, 0.0) for k in range(3))
    in_view = Button("To view", lambda: put(view_um), icon.EYE)
    selected = Button(
        "To selection", lambda: put(lambda: page.view.selection), icon.MARQUEE_2, disabled=view.selection is None
    )
    reset = Button("Reset", lambda: clip(box_um=None, heights_um=None), icon.X, disabled=free)
    elements = [
        Html(html.head("Clip box", "Drag its balls, or type")),
        *(
            NumberPair(f"{name}, µm", ends, partial(typed, axis), BOX_HINTS[axis], disabled=extent is None)
            for axis, (name, ends) in enumerate(zip(AXES, numbers, strict=True))
        ),
        Buttons([in_view, selected], 30),
        Buttons([Button("Whole surface", lambda: put(whole), icon.BOX), reset], 30),
    ]
    return Stack(elements, failed=CLIP_FAILED)


def _extent(page: Page, view: View) -> tuple[Ends, Ends, Ends] | None:
    """Return the extent of the box along each axis; the whole surface where nothing is clipped."""
    on_show = page.on_show
    if on_show is None:
        return None
    x0, y0, x1, y1 = view.clip.box_um or on_show.box_um
    return (x0, x1), (y0, y1), view.clip.heights_um or all_heights_um(page, on_show)


def _rounded(ends: Ends) -> Ends:
    return round(ends[0], DECIMALS), round(ends[1], DECIMALS)


def clip_box_callback(page: Page) -> Callable[[ClipBoxFaces, str], ClipBoxFaces]:
    """Return the callback for the box dragged in the scene; a face that was never moved clips nothing."""

    def moved(faces: ClipBoxFaces, key: str) -> ClipBoxFaces:
        clip, on_show = page.view.clip, page.on_show
        if key.startswith("z") and on_show is not None:
            low, high = clip.heights_um or all_heights_um(page, on_show)
            to_um = faces.heights_um[int(key[1])]
            clip = replace(clip, heights_um=(low, to_um) if key[1] == "1" else (to_um, high))
        else:
            clip = replace(clip, box_um=faces.box_um)
        page.change(clip=clip)
        return ClipBoxFaces(clip.box_um or faces.box_um, clip.heights_um or faces.heights_um)

    return moved


def all_heights_um(page: Page, on_show: DisplayedSurface) -> Span:
    """Return the lowest and the highest displayed point, um; includes rejected points if they are drawn."""
    statistics = page.statistics
    if statistics is None or not statistics.n_heights:
        return on_show.heights_um
    low, high = statistics.span_um if statistics.counts else on_show.heights_um
    if statistics.refused is not None and statistics.refused.n_heights:
        low, high = min(low, statistics.refused.span_um[0]), max(high, statistics.refused.span_um[1])
    return low, high


_LEAST_PX, _MOST_PX = 230, 760
_LINE_PX, _EDGES_PX, _LETTER_PX, _BELOW_TOOLBAR_PX = 18, 14, 7.2, 48
"""Pixels; _LETTER_PX: upper bound of the average width of a letter."""


def point_count(here: Here[None]) -> Overlay | None:
    """Return the number of points while they are drawn and counted, with space for the colour bar."""
    page, view, statistics = here.page, here.view, here.page.statistics
    visible = view.step in ("surface", "measure") and view.look == "points" and view.counted == "all"
    if not visible or statistics is None or not statistics.counts:
        return None
    words = counted(statistics, page.drawn_points, view)
    content = Markup('<div class="wv-glass wv-points">{}</div>').format(words)
    return Overlay.of(content, EDGE_PX, EDGE_PX + _BELOW_TOOLBAR_PX, *size_px(words, page.client.camera.image_width))


def size_px(words: str, scene_px: int) -> tuple[int, int]:
    """Return width and height of the overlay for a text in HTML, given the width of the scene."""
    n_letters = len(re.sub("<[^>]*>", "", words))
    width_px = min(_MOST_PX, max(_LEAST_PX, scene_px - LEGEND_PX - 3 * EDGE_PX))
    n_lines = math.ceil(n_letters * _LETTER_PX / (width_px - 2 * _EDGES_PX))
    return width_px, n_lines * _LINE_PX + _EDGES_PX
