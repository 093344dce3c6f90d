"""Display options of point clouds: size, depth shade, minimum confidence, rejected points."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from wafer_viewer.draw.colormaps import ORIGIN_COLOURS
from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import BoundInput, HtmlBlock, ToggleGroup, set_prop
from wafer_viewer.model.surface.clipping import LeftOut
from wafer_viewer.model.surface.height_map import ORIGIN_TITLES, Origin
from wafer_viewer.session.rendering.render_request import RefusedCounts, Statistics

FAILED = "The points were not changed"
REFUSED: tuple[tuple[bool, str], ...] = ((False, "Hide"), (True, "Show"))
NO_FIELDS = "This surface has no fields, and so no refused points."
NOT_KEPT = "The fields were reconstructed before refused points were kept: reconstruct them again."
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
        there = view.look == "points"
        set_prop(self._folder, "visible", there)
        if not there:
            return
        told = self._page.statistics
        self._count.show(html.head("Points") + (_shares(told, self._page.drawn_points) if told is not None else ""))
        self._size.show(view.point_px)
        self._shade.show(round(100 * view.depth_shade, 3))
        self._least.show(view.clip.least_confidence)
        self._refused.show(view.refused)
        self._legend.show(_refused_words(told, view))

    def _set_least(self, least: float) -> None:
        clip = self._page.view.clip
        self._page.change(clip=replace(clip, least_confidence=round(float(least), 3)))

    def _field(self, handle: Any, act: Any) -> BoundInput[Any]:
        return BoundInput(handle, lambda event: act(event.target.value), self._page, FAILED)


def counted(told: Statistics, drawn: int, view: View) -> str:
    """Return the number of drawn points of all, and the reasons for the others, as HTML."""
    refused = told.refused
    n_all, n_left, left_out = _totals(told)
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
    beside = f' <span class="dim">· {" · ".join(rest)}</span>' if rest else ""
    return f"<b>{amount(min(drawn, n_all))} of {amount(n_all)} points</b>{beside}"


def amount(n: float) -> str:
    """Return a number in short form: ``845``, ``12 k``, ``1.2 M``."""
    if n >= 0.9995 * _MEGA:
        return f"{number(n / _MEGA, 1)} M"
    return f"{number(n / _KILO, 0 if n >= 9950 else 1)} k" if n >= _KILO else number(n, 0)


def refused_legend(refused: RefusedCounts) -> str:
    """Return the legend of rejection reasons with their colours and counts, most frequent first, as HTML."""
    found = sorted(refused.by_reason.items(), key=lambda item: -item[1])
    rows = "".join(
        f"{html.swatch(f'rgb{ORIGIN_COLOURS[Origin(code)]}!important', 'var(--ink3)')}"
        f"<span>{html.safe(ORIGIN_TITLES[Origin(code)])}</span><b>{number(n, 0)}</b>"
        for code, n in found
    )
    return f'<div class="wv-reasons">{rows}</div>' if rows else ""


def _refused_words(told: Statistics | None, view: View) -> str:
    """Return the legend of rejected points, or the reason why there are none, as HTML."""
    if not view.refused:
        return ""
    if view.show < 0:
        return _remark(NO_FIELDS)
    refused = told.refused if told is not None else None
    if refused is None:
        return _remark("Counting …")
    if refused.n_fields == 0:
        return _remark(NO_FIELDS)
    if refused.n_fields_without == refused.n_fields:
        return _remark(NOT_KEPT)
    some = f"Not kept for {refused.n_fields_without} of {refused.n_fields} fields: reconstruct those again."
    none = "No point was refused here." if not refused.n_heights else "The clip leaves none of the refused points."
    return (refused_legend(refused) or _remark(none)) + (_remark(some) if refused.n_fields_without else "")


def _remark(text: str) -> str:
    return f'<div class="wv-lab">{html.safe(text)}</div>'


def _totals(told: Statistics) -> tuple[int, int, dict[LeftOut, int]]:
    """Return the number of all points, of those within the clip, and of the others by reason.

    Rejected points are included if they are drawn.
    """
    refused = told.refused
    if refused is None:
        return told.n_heights, told.n_points, told.left_out
    left_out: dict[LeftOut, int] = {why: told.left_out.get(why, 0) + n for why, n in refused.left_out.items()}
    return told.n_heights + refused.n_heights, told.n_points + refused.n_points, left_out


def _shares(told: Statistics, drawn: int) -> str:
    """Return a bar of the points drawn, drawn when closer, and clipped, as HTML."""
    n_all, n_left, _ = _totals(told)
    whole = max(1, n_all)
    now, later = 100 * min(1.0, drawn / whole), 100 * max(0.0, (n_left - drawn) / whole)
    return (
        '<div class="wv-share" style="margin:0 0 6px">'
        f'<i style="width:{now:.1f}%"></i><i style="width:{later:.1f}%;opacity:.3"></i></div>'
    )
