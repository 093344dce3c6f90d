"""Points section: size, depth shade, confidence, rejected points, clip box, and the number of drawn points."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.colormaps import ORIGIN_COLOURS
from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.overlays.hud import EDGE_PX
from wafer_viewer.gui.overlays.hud import WIDTH_PX as LEGEND_PX
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.scene.scene_contents import DisplayedSurface
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.tools.clip_box import ClipBoxFaces
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import guarded
from wafer_viewer.gui.widgets.controls import (
    BoundInput,
    FloatingPanel,
    HtmlBlock,
    ToggleGroup,
    button,
    in_a_row,
    set_prop,
)
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.surface.clipping import Box, LeftOut, Span
from wafer_viewer.model.surface.height_map import ORIGIN_TITLES, Origin
from wafer_viewer.session.rendering.render_request import RefusedCounts, Statistics
from wafer_viewer.session.state.snapshot import Snapshot

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


class PointsSection:
    """Section shown while the surface is drawn as points."""

    def __init__(self, page: Page) -> None:
        self._page = page
        gui = page.gui
        self._folder = gui.add_folder(None, visible=False)
        with self._folder:
            self._count = HtmlBlock(gui)
            size = gui.add_slider("Size, px", 1.0, 8.0, 0.5, 3.0)
            self._size = self._field(size, lambda px: page.change(point_px=float(px)))
            shade = gui.add_slider("Shade, %", 0.0, 100.0, 5.0, 60.0)
            self._shade = self._field(shade, lambda percent: page.change(depth_shade=percent / 100))
            least = gui.add_slider("At least", 0.0, 1.0, 0.05, 0.0)
            self._least = self._field(least, self._set_least)
            self._refused = ToggleGroup(gui, "Refused points", REFUSED, lambda key: page.change(refused=key))
            self._legend = HtmlBlock(gui)

    def show(self, view: View) -> None:
        """Bring the section up to date."""
        visible = view.look == "points"
        set_prop(self._folder, "visible", visible)
        if not visible:
            return
        statistics = self._page.statistics
        self._count.show(
            html.head("Points") + (_shares(statistics, self._page.drawn_points) if statistics is not None else "")
        )
        self._size.show(view.point_px)
        self._shade.show(round(100 * view.depth_shade, 3))
        self._least.show(view.clip.least_confidence)
        self._refused.show(view.refused)
        self._legend.show(_refused_words(statistics, view))

    def _set_least(self, least: float) -> None:
        clip = self._page.view.clip
        self._page.change(clip=replace(clip, least_confidence=round(float(least), 3)))

    def _field(self, handle: Any, act: Any) -> BoundInput[Any]:
        return BoundInput(handle, lambda event: act(event.target.value), self._page, FAILED)


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
        return _remark(NO_FIELDS)
    refused = statistics.refused if statistics is not None else None
    if refused is None:
        return _remark("Counting …")
    if refused.n_fields == 0:
        return _remark(NO_FIELDS)
    if refused.n_fields_without == refused.n_fields:
        return _remark(NOT_STORED)
    some = f"Not kept for {refused.n_fields_without} of {refused.n_fields} fields: reconstruct those again."
    none = "No point was refused here." if not refused.n_heights else "The clip leaves none of the refused points."
    return (refused_legend(refused) or _remark(none)) + (_remark(some) if refused.n_fields_without else "")


def _remark(text: str) -> Markup:
    return Markup('<div class="wv-lab">{}</div>').format(text)


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


class ClipSection:
    """Section shown for point clouds; the handles on the faces of the box in the scene are equivalent."""

    def __init__(self, page: Page, view_um: Callable[[], Box | None]) -> None:
        self._page = page
        gui = page.gui
        self._folder = gui.add_folder(None, visible=False)
        with self._folder:
            HtmlBlock(gui, html.head("Clip box", "Drag its balls, or type"))
            self._ends = [self._field(axis) for axis in range(3)]
            place = [
                self._button("To view", viser.Icon.EYE, view_um),
                self._button("To selection", viser.Icon.MARQUEE_2, lambda: page.view.selection),
            ]
            in_a_row(gui, place, 30)
            ends = [
                self._button("Whole surface", viser.Icon.BOX, self._full_box),
                button(gui, "Reset", viser.Icon.X, lambda _: self._reset()),
            ]
            in_a_row(gui, ends, 30)
            self._to_selection, self._reset_button = place[1], ends[1]

    def show(self, view: View) -> None:
        """Bring the section up to date."""
        visible = view.look == "points"
        set_prop(self._folder, "visible", visible)
        if not visible:
            return
        extent = self._extent(view)
        for axis, field in enumerate(self._ends):
            field.enable(extent is not None)
            if extent is not None:
                low, high = extent[axis]
                field.show((round(low, DECIMALS), round(high, DECIMALS)))
        set_prop(self._to_selection, "disabled", view.selection is None)
        set_prop(self._reset_button, "disabled", view.clip.box_um is None and view.clip.heights_um is None)

    def _button(self, label: str, icon: Any, box: Callable[[], Box | None]) -> Any:
        return button(self._page.gui, label, icon, guarded(self._page, CLIP_FAILED)(lambda _: self._put(box())))

    def _extent(self, view: View) -> tuple[Ends, Ends, Ends] | None:
        """Return the extent of the box along each axis; the whole surface where nothing is clipped."""
        on_show = self._page.on_show
        if on_show is None:
            return None
        x0, y0, x1, y1 = view.clip.box_um or on_show.box_um
        return (x0, x1), (y0, y1), view.clip.heights_um or all_heights_um(self._page, on_show)

    def _full_box(self) -> Box:
        on_show = self._page.on_show
        if on_show is None:
            raise MeasureError("The surface is not drawn yet: place the box when it is.")
        return on_show.box_um

    def _field(self, axis: int) -> BoundInput[Any]:
        handle = self._page.gui.add_vector2(f"{AXES[axis]}, µm", (0.0, 0.0), step=0.1)
        return BoundInput(handle, lambda event: self._type(axis, event.target.value), self._page, CLIP_FAILED)

    def _type(self, axis: int, ends: Ends) -> None:
        low, high = float(ends[0]), float(ends[1])
        if not low < high:
            raise MeasureError(f"{AXES[axis]} ends at {high:g} um, before it begins at {low:g} um: swap them.")
        extent = self._extent(self._page.view)
        if extent is None:
            return
        if axis == 2:
            self._clip(heights_um=(low, high))
            return
        (x0, x1), (y0, y1) = extent[:2]
        self._clip(box_um=(low, y0, high, y1) if axis == 0 else (x0, low, x1, high))

    def _put(self, box_um: Box | None) -> None:
        """Clip to a rectangle in stage um; None clips to all of the surface, so that its faces can be dragged."""
        self._clip(box_um=box_um or self._full_box())

    def _reset(self) -> None:
        self._clip(box_um=None, heights_um=None)

    def _clip(self, **changes: Box | Span | None) -> None:
        self._page.change(clip=replace(self._page.view.clip, **changes))  # pyright: ignore[reportArgumentType]


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


class PointCount:
    """Overlay shown while points are drawn and counted; its width leaves space for the colour bar."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._panel = FloatingPanel(page.gui, EDGE_PX, EDGE_PX + _BELOW_TOOLBAR_PX, _MOST_PX, _LINE_PX + _EDGES_PX)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the count up to date."""
        statistics = self._page.statistics
        visible = view.step in ("surface", "measure") and view.look == "points" and view.counted == "all"
        if not visible or statistics is None or not statistics.counts:
            self._panel.show("")
            return
        words = counted(statistics, self._page.drawn_points, view)
        width_px, height_px = size_px(words, self._page.client.camera.image_width)
        self._panel.show(
            Markup('<div class="wv-glass wv-points">{}</div>').format(words), width_px=width_px, height_px=height_px
        )


def size_px(words: str, scene_px: int) -> tuple[int, int]:
    """Return width and height of the overlay for a text in HTML, given the width of the scene."""
    n_letters = len(re.sub("<[^>]*>", "", words))
    width_px = min(_MOST_PX, max(_LEAST_PX, scene_px - LEGEND_PX - 3 * EDGE_PX))
    n_lines = math.ceil(n_letters * _LETTER_PX / (width_px - 2 * _EDGES_PX))
    return width_px, n_lines * _LINE_PX + _EDGES_PX
