"""Focus curve of a pixel as HTML: focus over z with one point per frame, the peak and its rivals marked.

Colours are the page's custom properties (``--ink``, ``--accent``, ...), so one drawing serves light and dark. Lines are
in a stretched SVG and labels are placed over it in percent, so the plot fills its container.
"""

from __future__ import annotations

from wafer_viewer.draw.number_format import number, share, tick_digits, ticks, with_unit
from wafer_viewer.model.surface.focus_curve import FocusCurve, Rival

LEFT_PX, RIGHT_PX, TOP_PX, FOOT_PX = 50, 14, 6, 40
_HEADROOM = 1.17
"""Height of the plot relative to the peak, with space for the label."""
_SIDE = 1000.0
_LEAST_NAMED, _APART = 0.05, 0.16
"""Least height of a labelled rival relative to the peak, and least label distance as a share of the width."""


def focus_plot_html(curve: FocusCurve, height_px: int, over: str = "") -> str:
    """Return the plot at `height_px`; `over` is HTML that covers the curve area."""
    place = f"left:{LEFT_PX}px;right:{RIGHT_PX}px;top:{TOP_PX}px;bottom:{FOOT_PX}px"
    drawn = "".join((_grid(curve), _peak_line(curve), _line(curve), *(_ring(curve, r) for r in curve.rivals)))
    words = "".join((_axes(curve), _peak_label(curve), *(_rival_label(curve, r) for r in _named(curve))))
    return (
        f'<div class="wv-plot" style="height:{height_px}px"><div style="position:absolute;{place}">'
        f'<svg viewBox="0 0 {_SIDE:g} {_SIDE:g}" preserveAspectRatio="none">{drawn}</svg>{words}{over}</div>'
        '<span class="wv-plot-y">Focus, % of the peak</span><span class="wv-plot-x">z, µm</span></div>'
    )


def _across(curve: FocusCurve, z_um: float) -> float:
    """Return the horizontal position of a z, from 0 (left) to 1 (right)."""
    low, high = curve.z_um[0], curve.z_um[-1]
    return min(max((z_um - low) / (high - low), 0.0), 1.0)


def _down(focus: float) -> float:
    """Return the vertical position of a focus value relative to the peak, 0 at the top."""
    return 1 - focus / _HEADROOM


def _points(curve: FocusCurve) -> list[str]:
    return [
        f"{_SIDE * _across(curve, z):.1f} {_SIDE * _down(f):.1f}" for z, f in zip(curve.z_um, curve.focus, strict=True)
    ]


def _path(d: str, colour: str, width_px: float, more: str = "") -> str:
    return f'<path d="{d}" stroke="var(--{colour})" stroke-width="{width_px:g}" {more}/>'


def _grid(curve: FocusCurve) -> str:
    up = "".join(f"M{_SIDE * _across(curve, z):.1f} 0V{_SIDE:g}" for z in _z_ticks(curve))
    along = "".join(f"M0 {_SIDE * _down(f):.1f}H{_SIDE:g}" for f in (0.0, 0.5, 1.0))
    return _path(up + along, "line", 1)


def _line(curve: FocusCurve) -> str:
    points = _points(curve)
    return _path(f"M{'L'.join(points)}", "accent", 1.8) + _dots(points, "accent", 4.6)


def _dots(points: list[str], colour: str, width_px: float) -> str:
    """Return round points as zero-length strokes with round caps, which do not distort when stretched."""
    return _path("".join(f"M{p}h.01" for p in points), colour, width_px, 'stroke-linecap="round"')


def _peak_line(curve: FocusCurve) -> str:
    x = _SIDE * _across(curve, curve.peak_z_um)
    dashes = "" if curve.height_um is not None else 'stroke-dasharray="5 4"'
    return _path(f"M{x:.1f} 0V{_SIDE:g}", _peak_colour(curve), 1.6, dashes)


def _peak_colour(curve: FocusCurve) -> str:
    return "good" if curve.height_um is not None else "attention"


def _ring(curve: FocusCurve, rival: Rival) -> str:
    at = [f"{_SIDE * _across(curve, rival.z_um):.1f} {_SIDE * _down(rival.share):.1f}"]
    return _dots(at, "attention", 10) + _dots(at, "panel", 6)


def _axes(curve: FocusCurve) -> str:
    zs = _z_ticks(curve)
    below = "".join(
        f'<i class="x" style="left:{100 * _across(curve, z):.2f}%">{number(z, tick_digits(zs))}</i>' for z in zs
    )
    beside = "".join(f'<i class="y" style="top:{100 * _down(f):.2f}%">{100 * f:.0f}</i>' for f in (0.0, 0.5, 1.0))
    return below + beside


def _peak_label(curve: FocusCurve) -> str:
    believed = "" if curve.height_um is not None else ", not believed"
    text = f"peak {with_unit(curve.peak_z_um, 2, signed=True)}{believed}"
    return _beside(curve, curve.peak_z_um, "top:-1px", _peak_colour(curve), text)


def _named(curve: FocusCurve) -> list[Rival]:
    """Return the rivals that have space for a label, the highest first."""
    named: list[Rival] = []
    for rival in curve.rivals:
        taken = [curve.peak_z_um] if rival.share > 1 - _APART else []
        others = [_across(curve, z) for z in (*taken, *(r.z_um for r in named))]
        if rival.share >= _LEAST_NAMED and all(abs(_across(curve, rival.z_um) - x) >= _APART for x in others):
            named.append(rival)
    return named


def _rival_label(curve: FocusCurve, rival: Rival) -> str:
    where = f"top:calc({100 * _down(rival.share):.2f}% - 20px)"
    return _beside(curve, rival.z_um, where, "attention", f"rival {share(rival.share, 0)}")


def _beside(curve: FocusCurve, z_um: float, where: str, colour: str, text: str) -> str:
    """Return a label right of a z, or left of it in the right half of the plot."""
    across = 100 * _across(curve, z_um)
    side = f"left:calc({across:.2f}% + 7px)" if across < 50 else f"right:calc({100 - across:.2f}% + 7px)"
    return f'<b style="{side};{where};color:var(--{colour})">{text}</b>'


def _z_ticks(curve: FocusCurve) -> list[float]:
    return ticks(curve.z_um[0], curve.z_um[-1], 7)
