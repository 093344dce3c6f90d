"""How a point cloud is drawn: how many of how many points, their size, depth shade, and what confidence they need."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import viser

from wafer_viewer.draw.numbers import number
from wafer_viewer.gui import html
from wafer_viewer.gui.kit import Cell, Field, button, in_a_row, set_prop
from wafer_viewer.gui.page import Page
from wafer_viewer.gui.view import View
from wafer_viewer.model.clipping import Box, LeftOut
from wafer_viewer.session.paint_request import Statistics

FAILED = "The points were not changed"
_MEGA, _KILO = 1e6, 1e3
WORDS: dict[LeftOut, str] = {
    "box": "outside of the box",
    "height": "clipped",
    "confidence": "under {confidence}",
    "slab": "before the slab",
}


class PointsSection:
    """Shown where the surface is drawn as points."""

    def __init__(self, page: Page, seen_um: Callable[[], Box | None]) -> None:
        self._page, self._seen_um = page, seen_um
        gui = page.gui
        self._folder = gui.add_folder(None, visible=False)
        with self._folder:
            self._count = Cell(gui)
            size = gui.add_slider("Size, px", 1.0, 8.0, 0.5, 3.0)
            self._size = self._field(size, lambda px: page.change(point_px=float(px)))
            shade = gui.add_slider("Shade, %", 0.0, 100.0, 5.0, 60.0)
            self._shade = self._field(shade, lambda percent: page.change(depth_shade=percent / 100))
            least = gui.add_slider("At least", 0.0, 1.0, 0.05, 0.0)
            self._least = self._field(least, self._set_least)
            clip = [
                button(gui, "Clip to view", viser.Icon.EYE, lambda _: self._clip_to(self._seen_um())),
                button(gui, "To selection", viser.Icon.MARQUEE_2, lambda _: self._clip_to(page.view.selection)),
                button(gui, "No box", viser.Icon.X, lambda _: self._clip_to(None)),
            ]
            in_a_row(gui, clip, 30)
            self._to_selection, self._no_box = clip[1:]
            self._box = Cell(gui)

    def show(self, view: View) -> None:
        """Bring the section up to date."""
        there = view.look == "points"
        set_prop(self._folder, "visible", there)
        if not there:
            return
        told = self._page.statistics
        self._count.show(html.head("Points") + (_shares(told, self._page.drawn_points) if told is not None else ""))
        self._size.show(view.point_px)
        self._shade.show(round(100 * view.depth_shade, 3))
        self._least.show(view.clip.least_confidence)
        set_prop(self._to_selection, "disabled", view.selection is None)
        set_prop(self._no_box, "disabled", view.clip.box_um is None)
        self._box.show(_box_words(view.clip.box_um))

    def _set_least(self, least: float) -> None:
        clip = self._page.view.clip
        self._page.change(clip=replace(clip, least_confidence=round(float(least), 3)))

    def _clip_to(self, box_um: Box | None) -> None:
        self._page.change(clip=replace(self._page.view.clip, box_um=box_um))

    def _field(self, handle: Any, act: Any) -> Field[Any]:
        return Field(handle, lambda event: act(event.target.value), self._page, FAILED)


def counted(told: Statistics, drawn: int, view: View) -> str:
    """How many of how many points are drawn, and where the rest is, HTML."""
    rest = [
        f"{amount(told.left_out[why])} {words.format(confidence=number(view.clip.least_confidence, 2))}"
        for why, words in WORDS.items()
        if told.left_out.get(why, 0)
    ]
    nearer = told.n_points - drawn
    if nearer > 0.005 * told.n_heights:
        rest.append(f"{amount(nearer)} when nearer or in view")
    beside = f' <span class="dim">· {" · ".join(rest)}</span>' if rest else ""
    return f"<b>{amount(min(drawn, told.n_heights))} of {amount(told.n_heights)} points</b>{beside}"


def amount(n: float) -> str:
    """``845``, ``12 k``, ``1.2 M``."""
    if n >= 0.9995 * _MEGA:
        return f"{number(n / _MEGA, 1)} M"
    return f"{number(n / _KILO, 0 if n >= 9950 else 1)} k" if n >= _KILO else number(n, 0)


def _box_words(box_um: Box | None) -> str:
    if box_um is None:
        return ""
    x0, y0, x1, y1 = (number(v, 0) for v in box_um)
    return f'<div class="wv-lab">Box x {x0} … {x1}, y {y0} … {y1} µm</div>'


def _shares(told: Statistics, drawn: int) -> str:
    """A bar of what is drawn, what comes when one goes nearer, and what is left out."""
    whole = max(1, told.n_heights)
    now, later = 100 * min(1.0, drawn / whole), 100 * max(0.0, (told.n_points - drawn) / whole)
    return (
        '<div class="wv-share" style="margin:0 0 6px">'
        f'<i style="width:{now:.1f}%"></i><i style="width:{later:.1f}%;opacity:.3"></i></div>'
    )
