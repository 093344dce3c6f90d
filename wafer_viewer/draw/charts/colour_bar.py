"""Colour legend and height histogram of the surface as HTML."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from wafer_viewer.draw.charts.axes import Axis, round_ticks
from wafer_viewer.draw.colormaps import ELSEWHERE, ORIGIN_COLOURS, css_gradient, table
from wafer_viewer.model.surface.clipping import Span
from wafer_viewer.model.surface.height_map import ORIGIN_TITLES

_HISTOGRAM_PX = 44
_LONG_TITLE = 12
"""Title length in characters above which a smaller font is used."""
_BAR_PX, _TOP_PX = 19, 34
LINE_PX = 20
NOT_MEASURED_CSS = "repeating-linear-gradient(45deg,var(--ink3) 0 1px,transparent 1px 4px)"


def colour_bar_html(
    title: str,
    unit: str,
    low: float,
    high: float,
    colours: str,
    counts: Sequence[float],
    *,
    height_px: int = 300,
    signed: bool = True,
    elsewhere: str = "",
) -> Markup:
    """Return the colour bar from low to high, with the histogram `counts` in equal bins between them.

    The bars are square roots of the counts, so that rare values stay visible. The legend is 124 px wide and `height_px`
    + 78 high, and uses the page's custom properties; `title` is escaped. `elsewhere` explains the grey of the surface
    in an additional line of `LINE_PX`.
    """
    foot_px = LINE_PX if elsewhere else 0
    title_px = 13.5 if len(title) <= _LONG_TITLE else 12
    axis = Axis((low, high), (_TOP_PX + height_px, _TOP_PX))
    ticks = round_ticks(axis.ends, max(3, height_px // 48), signed=signed)
    labels = Markup("").join(_label(axis.at(value), text) for value, text in ticks)
    return Markup(
        '<div style="position:relative;height:{height}px;width:124px">'
        '<div style="position:absolute;left:12px;top:8px;font-weight:650;font-size:{title_px}px">{title} '
        '<span style="font-weight:450;color:var(--ink3)">{unit}</span></div>'
        "{histogram}"
        '<div style="position:absolute;left:54px;top:{top_px}px;width:{bar_px}px;height:{height_px}px;'
        "border-radius:2px;border:1px solid var(--line);box-sizing:border-box;"
        'background:{background}!important"></div>'
        "{labels}{not_measured_html}"
        "{elsewhere_html}</div>"
    ).format(
        height=height_px + 78 + foot_px,
        title_px=title_px,
        title=title,
        unit=unit,
        histogram=_histogram(counts, height_px),
        top_px=_TOP_PX,
        bar_px=_BAR_PX,
        height_px=height_px,
        background=css_gradient(colours),
        labels=labels,
        not_measured_html=not_measured_html(f"position:absolute;left:12px;bottom:{9 + foot_px}px"),
        elsewhere_html=_elsewhere_html(elsewhere) if elsewhere else "",
    )


def origin_legend_html(shares: dict[int, float]) -> Markup:
    """Return the legend of `origin`: the codes that occur on the surface; shares are fractions of the pixels."""
    rows = Markup("").join(
        Markup(
            '<div style="display:flex;gap:7px;align-items:center;white-space:nowrap">'
            '<i style="width:13px;height:10px;background:rgb{}!important;display:inline-block"></i>'
            "{}</div>"
        ).format(ORIGIN_COLOURS[origin], ORIGIN_TITLES[origin])
        for origin in ORIGIN_TITLES
        if shares.get(int(origin), 0) > 0
    )
    return Markup('<div style="padding:8px 12px;font-size:12px;display:grid;gap:4px">{}</div>').format(rows)


def not_measured_html(style: str = "") -> Markup:
    """Return the legend line for holes."""
    return Markup(
        '<div style="font-size:12px;color:var(--ink2);display:flex;gap:6px;align-items:center;{}">'
        '<i style="width:13px;height:10px;border:1.5px solid var(--ink3);display:inline-block;'
        'background:{}!important"></i>not measured</div>'
    ).format(style, NOT_MEASURED_CSS)


def _elsewhere_html(text: str) -> Markup:
    swatch = f"width:13px;height:10px;display:inline-block;background:rgb{ELSEWHERE}!important"
    return Markup(
        '<div style="font-size:12px;color:var(--ink2);display:flex;gap:6px;align-items:center;white-space:nowrap;'
        'position:absolute;left:12px;bottom:9px"><i style="{}"></i>{}</div>'
    ).format(swatch, text)


def _histogram(counts: Sequence[float], height_px: int) -> Markup:
    root = np.sqrt(np.asarray(counts, float))
    if root.size == 0 or root.max() <= 0:
        return Markup()
    share, n = root / root.max(), root.size
    edge = " ".join(
        f"{_HISTOGRAM_PX * (1 - s):.1f},{height_px * (1 - (k + 0.5) / n):.1f}" for k, s in enumerate(share.tolist())
    )
    outline = f"{_HISTOGRAM_PX},{height_px} {edge} {_HISTOGRAM_PX},0"
    return Markup(
        '<svg style="position:absolute;left:8px;top:{top_px}px" width="{histogram_px}" height="{height_px}">'
        '<polygon points="{outline}" fill="var(--ink3)" opacity=".38"/></svg>'
    ).format(top_px=_TOP_PX, histogram_px=_HISTOGRAM_PX, height_px=height_px, outline=outline)


def _label(top: float, text: str) -> Markup:
    dash = f"position:absolute;left:74px;top:{top:.0f}px;width:6px;height:1px;background:var(--ink2)!important"
    word = f"position:absolute;left:84px;top:{top - 9:.0f}px;font-size:12.5px;white-space:nowrap"
    return Markup('<div style="{}"></div><div style="{}">{}</div>').format(dash, word, text)


HEIGHT_PX, TICKS_PX = 92, 20
_SIDE = 1000


def histogram_html(
    counts: Sequence[int], ends_um: Span, colours: tuple[str, float, float] | None, within_um: Span | None = None
) -> Markup:
    """Return the histogram of `counts` in equal bins between `ends_um`, as square roots to show rare heights.

    colours: a colour map and the heights at its ends; None draws all bars grey, like those outside `within_um`.
    """
    root = np.sqrt(np.asarray(counts, float))
    if root.size == 0 or root.max() <= 0:
        return Markup()
    low, high = ends_um
    n = root.size
    middles = low + (np.arange(n) + 0.5) / n * (high - low)
    bars = Markup("").join(
        Markup('<rect x="{x:.1f}" y="{y:.0f}" width="{width:.1f}" height="{height:.0f}" fill="{fill}"/>').format(
            x=_SIDE * k / n,
            y=_SIDE * (1 - s),
            width=_SIDE / n + 0.6,
            height=_SIDE * s,
            fill=_fill(z, colours, within_um),
        )
        for k, (s, z) in enumerate(zip((0.96 * root / root.max()).tolist(), middles.tolist(), strict=True))
        if s > 0
    )
    return Markup(
        '<div class="wv-hist" style="height:{height}px"><svg viewBox="0 0 {side} {side}" '
        'preserveAspectRatio="none" style="height:{height_px}px" role="img" aria-label="Histogram of heights">{bars}'
        "</svg>{ticks}</div>"
    ).format(height=HEIGHT_PX + TICKS_PX, side=_SIDE, height_px=HEIGHT_PX, bars=bars, ticks=_ticks(ends_um))


def place_of(z_um: float, ends_um: Span) -> float:
    """Return the position of a height, from 0 (left) to 1 (right), clamped to the ends."""
    return min(max(Axis(ends_um, (0.0, 1.0)).at(z_um), 0.0), 1.0)


def _fill(z_um: float, colours: tuple[str, float, float] | None, within_um: Span | None) -> str:
    if colours is None or (within_um is not None and not within_um[0] <= z_um <= within_um[1]):
        return "var(--ink3)" if colours is None else "var(--line)"
    name, low, high = colours
    red, green, blue = table(name)[round(255 * place_of(z_um, (low, high)))].tolist()
    return f"rgb({red},{green},{blue})"


def _ticks(ends_um: Span) -> Markup:
    axis = Axis(ends_um, (0, 100), round_ticks(ends_um, 6, signed=True))
    return Markup("").join(
        Markup('<i style="left:{:.2f}%">{}</i>').format(axis.at(value), text) for value, text in axis.ticks
    )
