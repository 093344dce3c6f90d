"""Focus curve of a pixel as HTML: focus over z with one point per frame, the peak and its rivals marked."""

from __future__ import annotations

from markupsafe import Markup

from wafer_viewer.draw.charts.axes import Axes, PlotLook, line_svg, plot_html, round_ticks
from wafer_viewer.draw.number_format import share, with_unit
from wafer_viewer.model.surface.focus_curve import FocusCurve, Rival

_HEADROOM = 1.17
"""Height of the plot relative to the peak, with space for the label."""
_Y_TICKS = ((0.0, "0"), (0.5, "50"), (1.0, "100"))
_LEAST_NAMED, _APART_PERCENT = 0.05, 16
"""Least height of a labelled rival relative to the peak, and least label distance in percent of the width."""


def focus_plot_html(curve: FocusCurve, height_px: int, over: str = "") -> Markup:
    """Return the plot at `height_px`; `over` is HTML that covers the curve area."""
    ends_um = curve.z_um[0], curve.z_um[-1]
    axes = Axes.stretched(ends_um, (0.0, _HEADROOM), round_ticks(ends_um, 7), _Y_TICKS)
    look = PlotLook("Focus curve", "Focus, % of the peak", "z, µm", top_px=6, style=f"height:{height_px}px")
    drawn = Markup("").join(
        (_peak_line(axes, curve), _line(axes, curve), *(_ring(axes, rival) for rival in curve.rivals))
    )
    words = Markup("").join((_peak_label(axes, curve), *(_rival_label(axes, rival) for rival in _named(axes, curve))))
    return plot_html(axes, look, drawn, words + over)


def _point(axes: Axes, z_um: float, focus: float) -> str:
    return f"{axes.x.at(axes.x.within(z_um)):.1f} {axes.y.at(focus):.1f}"


def _line(axes: Axes, curve: FocusCurve) -> Markup:
    points = [_point(axes, z, focus) for z, focus in zip(curve.z_um, curve.focus, strict=True)]
    return line_svg(f"M{'L'.join(points)}", "accent", 1.8) + _dots(points, "accent", 4.6)


def _dots(points: list[str], colour: str, width_px: float) -> Markup:
    """Return round points as zero-length strokes with round caps, which do not distort when stretched."""
    return line_svg(Markup("").join(f"M{p}h.01" for p in points), colour, width_px, Markup('stroke-linecap="round"'))


def _peak_line(axes: Axes, curve: FocusCurve) -> Markup:
    dashes = Markup() if curve.height_um is not None else Markup('stroke-dasharray="5 4"')
    return line_svg(axes.upright(axes.x.within(curve.peak_z_um)), _peak_colour(curve), 1.6, dashes)


def _peak_colour(curve: FocusCurve) -> str:
    return "good" if curve.height_um is not None else "attention"


def _ring(axes: Axes, rival: Rival) -> Markup:
    points = [_point(axes, rival.z_um, rival.share)]
    return _dots(points, "attention", 10) + _dots(points, "panel", 6)


def _peak_label(axes: Axes, curve: FocusCurve) -> Markup:
    believed = "" if curve.height_um is not None else ", not believed"
    text = f"peak {with_unit(curve.peak_z_um, 2, signed=True)}{believed}"
    return _plot_label(_percent(axes, curve.peak_z_um), "top:-1px", _peak_colour(curve), text)


def _named(axes: Axes, curve: FocusCurve) -> list[Rival]:
    """Return the rivals that have space for a label, the highest first."""
    named: list[Rival] = []
    for rival in curve.rivals:
        taken = [curve.peak_z_um] if rival.share > 1 - _APART_PERCENT / 100 else []
        others = [_percent(axes, z) for z in (*taken, *(r.z_um for r in named))]
        across = _percent(axes, rival.z_um)
        if rival.share >= _LEAST_NAMED and all(abs(across - x) >= _APART_PERCENT for x in others):
            named.append(rival)
    return named


def _rival_label(axes: Axes, rival: Rival) -> Markup:
    where = f"top:calc({axes.y.percent(rival.share):.2f}% - 20px)"
    return _plot_label(_percent(axes, rival.z_um), where, "attention", f"rival {share(rival.share, 0)}")


def _percent(axes: Axes, z_um: float) -> float:
    return axes.x.percent(axes.x.within(z_um))


def _plot_label(across: float, where: str, colour: str, text: str) -> Markup:
    """Return a label right of a position in percent, or left of it in the right half of the plot."""
    side = f"left:calc({across:.2f}% + 7px)" if across < 50 else f"right:calc({100 - across:.2f}% + 7px)"
    return Markup('<b style="{side};{where};color:var(--{colour})">{text}</b>').format(
        side=side, where=where, colour=colour, text=text
    )
