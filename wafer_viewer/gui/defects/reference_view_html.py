"""HTML of a defect comparison: three pairs of pictures with the defect's outline and a common height scale."""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass

import numpy as np

from wafer_viewer.draw.charts.defect_symbols import KINDS
from wafer_viewer.draw.charts.symbols import symbol_svg
from wafer_viewer.draw.colormaps import css_gradient
from wafer_viewer.draw.number_format import number, with_unit
from wafer_viewer.draw.ticks import length_text, round_length, tick_digits, ticks
from wafer_viewer.gui.overlays.scene_sheet import SheetRoom
from wafer_viewer.gui.tools.region_shapes import outline_of
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.inspection.defect import Defect
from wafer_viewer.session.rendering.comparison_views import ComparisonView, ComparisonViews, Like

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
    sheet_px: int

    @classmethod
    def within(cls, room: SheetRoom) -> Sizes:
        """Return the sizes of the largest pictures that fit into the available area."""
        rest = HEAD_PX + NAMES_PX + FOOT_PX + 2 * PAD_PX + GAP_PX
        by_width = (room.width_px - 2 * PAD_PX - BAR_PX - COLUMNS * GAP_PX) / COLUMNS
        by_height = (room.height_px - rest) / 2 * ASPECT
        width = int(max(96, min(by_width, by_height)))
        height = round(width / ASPECT)
        return cls(width, height, 2 * height + rest)


def sheet(defect: Defect, answer: ComparisonViews, sizes: Sizes) -> str:
    """Return the sheet as HTML."""
    style = (
        f"grid-template-columns:repeat({COLUMNS},{sizes.width_px}px) {BAR_PX}px;"
        f"grid-template-rows:{NAMES_PX}px repeat(2,{sizes.height_px}px)"
    )
    columns = "".join(_column(n, seen, defect, answer, sizes) for n, seen in enumerate(answer.seen, 1))
    bar = f'<div style="grid-column:{COLUMNS + 1};grid-row:2">{_bar(answer, sizes.height_px)}</div>'
    foot = f'<div class="wv-lab" style="height:{FOOT_PX}px;padding-top:5px">{html.safe(_foot(answer))}</div>'
    return f'{head(defect)}<div class="wv-beside" style="{style}">{columns}{bar}</div>{foot}'


def head(defect: Defect) -> str:
    """Return the header with title and close link as HTML."""
    look = KINDS[defect.seen_as]
    name = f"{symbol_svg(look.shape, look.colour)} D{defect.number} · {look.title} compared"
    away = f'<span class="wv-link" {html.pick("sheet", "none")}>Close · Z</span>'
    return f'<div class="wv-over-head" style="height:{HEAD_PX}px"><b>{name}</b><span>{away}</span></div>'


def _column(place: int, seen: ComparisonView, defect: Defect, answer: ComparisonViews, sizes: Sizes) -> str:
    title, below = _named(seen, defect, answer.pixel_um)
    names = (
        f'<div style="grid-column:{place};grid-row:1" class="wv-over-name"><b>{html.safe(title)}</b>'
        f'<small title="{html.safe(below)}">{html.safe(below)}</small></div>'
    )
    if seen.why_not:
        why = f'<div class="wv-empty">{html.safe(html.with_micro_sign(seen.why_not))}</div>'
        return f'{names}<div style="grid-column:{place};grid-row:2/4">{why}</div>'
    over = _over(defect, answer, sizes)
    at = f'<div class="wv-over-picture" style="grid-column:{place};grid-row:'
    height, picture = _image(seen.height, title, "heights"), _image(seen.picture, title, "in focus everywhere")
    return f'{names}{at}2">{height}{over}</div>{at}3">{picture}{over}</div>'


def _named(seen: ComparisonView, defect: Defect, pixel_um: float) -> tuple[str, str]:
    """Return the title and subtitle of a pair of pictures."""
    if seen.like == "here":
        return "This place", f"Die {defect.die}" if defect.die else "Outside of the dies"
    if seen.like == "before":
        return TITLES["before"], " · ".join(part for part in (seen.name, _moved(seen, pixel_um)) if part)
    of = f"median of {seen.dies}" if seen.dies else ""
    return TITLES[seen.like], " · ".join(part for part in (seen.name, of) if part)


def _moved(seen: ComparisonView, pixel_um: float) -> str:
    away_um = math.hypot(*seen.moved_um)
    return "" if seen.why_not or away_um < _STILL_PX * pixel_um else f"found {with_unit(away_um, 1)} off"


def _image(jpeg: bytes, title: str, what: str) -> str:
    if not jpeg:
        return html.empty("Not measured here.")
    url = f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}"
    return f'<img alt="{html.safe(title)}, {what}" src="{url}">'


def _over(defect: Defect, answer: ComparisonViews, sizes: Sizes) -> str:
    """Return the overlay of a picture, the defect's outline and the scale bar, as SVG."""
    x0, y0, x1, y1 = answer.box_um
    corners = outline_of(defect.outline)
    if len(corners) == 0:
        corners = np.array([(point.x_um, point.y_um) for point in defect.outline.points])
    x = (corners[:, 0] - x0) / (x1 - x0) * sizes.width_px
    y = (y1 - corners[:, 1]) / (y1 - y0) * sizes.height_px
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True))
    colour = KINDS[defect.seen_as].colour
    lines = "".join(
        f'<polygon points="{points}" fill="none" stroke="{ink}" stroke-width="{width}"/>'
        for ink, width in (("#fff", 4), (colour, 2))
    )
    return f'<svg viewBox="0 0 {sizes.width_px} {sizes.height_px}">{lines}{_scale_bar(x1 - x0, sizes)}</svg>'


def _scale_bar(width_um: float, sizes: Sizes) -> str:
    length_um = round_length(_BAR_OF_PICTURE * width_um)
    length_px, foot = length_um / width_um * sizes.width_px, sizes.height_px - 8
    text = (
        f'<text x="8" y="{foot - 6}" font-size="11.5" fill="#fff" stroke="#15202B" stroke-width="3" '
        f'paint-order="stroke">{length_text(length_um)}</text>'
    )
    return f'{text}<path d="M8 {foot}h{length_px:.1f}" stroke="#15202B" stroke-width="5"/>' + (
        f'<path d="M9 {foot}h{length_px - 2:.1f}" stroke="#fff" stroke-width="2.5"/>'
    )


def _bar(answer: ComparisonViews, height_px: int) -> str:
    """Return the colour bar of heights relative to the middle of the reference, as HTML."""
    low, high = answer.low_um - answer.zero_um, answer.high_um - answer.zero_um
    values = ticks(low, high, max(3, height_px // 40))
    digits = tick_digits(values)
    marks = "".join(
        f'<i style="bottom:{100 * (value - low) / max(high - low, 1e-9):.1f}%">{number(value, digits, signed=True)}</i>'
        for value in values
    )
    return (
        f'<div class="wv-over-bar"><u style="background:{css_gradient("mako")}!important"></u>{marks}<em>µm</em></div>'
    )


def _foot(answer: ComparisonViews) -> str:
    compared = [seen for seen in answer.seen[1:] if not seen.why_not]
    if not compared:
        return "Heights over the middle of the place."
    words = {"dies": "the other dies", "golden": "the golden die", "before": "the last scan"}
    span = with_unit(answer.high_um - answer.low_um, 1)
    return f"One scale for all, {span} from dark to bright, over the middle height of {words[compared[0].like]} here."
