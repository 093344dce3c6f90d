"""Die map of a wafer as SVG, coloured by verdict, for the page and for reports. Pure.

Colours are custom properties (``--good``, ``--fault`` …) of the embedding page; each verdict has a sign as well.
"""

from __future__ import annotations

import html
from collections.abc import Sequence

from wafer_viewer.draw.charts.wafer_map import Box, MapViewport
from wafer_viewer.model.decision_rule import Word
from wafer_viewer.model.job.verdict import JudgedDie

INKS: dict[Word, tuple[str, str]] = {
    "pass": ("good", ""),
    "fail": ("fault", "×"),
    "inconclusive": ("attention", "?"),
    "no verdict": ("ink3", "–"),
}
"""Colour and sign of each verdict."""
_ROUND_SHARE = 0.02
_LEAST_FOR_SIGN_PX = 9


def die_map_svg(
    dies: Sequence[JudgedDie], across_um: float = 0.0, *, width_px: int = 276, most_height_px: int = 236
) -> str:
    """Return the dies at their wafer positions, notch down; across_um: diameter of the wafer, 0 without outline.

    The outline is drawn if the dies take enough of it to be distinguishable.
    """
    frame = _frame(dies, across_um, width_px, most_height_px)
    outline = _outline(frame, across_um) if _shows_wafer(dies, across_um) else ""
    return (
        f'<svg viewBox="0 0 {width_px} {frame.height_px:.0f}" width="{width_px}" role="img" '
        f'aria-label="Dies by their word" style="max-width:100%">'
        f"{outline}{''.join(_die(frame, die) for die in dies)}</svg>"
    )


def _frame(dies: Sequence[JudgedDie], across_um: float, width_px: int, most_height_px: int) -> MapViewport:
    """Return a viewport that contains the dies, and the wafer if it is drawn."""
    half = across_um / 2 if _shows_wafer(dies, across_um) else 0.0
    x0, y0, x1, y1 = _bounds(dies)
    x0, y0, x1, y1 = (min(x0, -half), min(y0, -half), max(x1, half), max(y1, half)) if half else (x0, y0, x1, y1)
    pad = _ROUND_SHARE * max(x1 - x0, y1 - y0, 1.0)
    box = (x0 - pad, y0 - pad, x1 + pad, y1 + pad)
    height_px = min(most_height_px, max(40.0, width_px * (box[3] - box[1]) / (box[2] - box[0])))
    return MapViewport(box, width_px, height_px)


def _shows_wafer(dies: Sequence[JudgedDie], across_um: float) -> bool:
    x0, y0, x1, y1 = _bounds(dies)
    return across_um > 0 and max(x1 - x0, y1 - y0) > across_um / 4


def _bounds(dies: Sequence[JudgedDie]) -> Box:
    x0, y0 = min(die.x_um for die in dies), min(die.y_um for die in dies)
    return x0, y0, max(die.x_um + die.width_um for die in dies), max(die.y_um + die.height_um for die in dies)


def _outline(frame: MapViewport, across_um: float) -> str:
    x, y, r = frame.x(0.0), frame.y(0.0), across_um / 2 * frame.scale
    notch = f'<path d="M{x - 4:.1f} {y + r:.1f}l4 -6l4 6z" fill="var(--ink3)"/>'
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{r:.1f}" fill="var(--fill)" stroke="var(--ink3)"/>{notch}'


def _die(frame: MapViewport, die: JudgedDie) -> str:
    ink, sign = INKS[die.word]
    x, y = frame.x(die.x_um), frame.y(die.y_um + die.height_um)
    w, h = max(2.0, die.width_um * frame.scale - 1), max(2.0, die.height_um * frame.scale - 1)
    size = min(16.0, 0.7 * min(w, h))
    text = (
        f'<text x="{x + w / 2:.1f}" y="{y + h / 2 + 0.35 * size:.1f}" text-anchor="middle" font-size="{size:.1f}" '
        f'font-weight="700" fill="var(--{ink})">{sign}</text>'
        if sign and min(w, h) >= _LEAST_FOR_SIGN_PX
        else ""
    )
    return (
        f'<g data-die="{html.escape(die.name, quote=True)}"><title>Die {html.escape(die.name)}: {die.word}</title>'
        f'<rect x="{x:.1f}" y="{y:.1f}" width="{w:.1f}" height="{h:.1f}" fill="var(--{ink})" fill-opacity=".28" '
        f'stroke="var(--{ink})"/>{text}</g>'
    )
