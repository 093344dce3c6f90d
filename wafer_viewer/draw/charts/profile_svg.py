"""Profile as SVG for a report: axes with units, the curve, gaps where unmeasured. Pure."""

from __future__ import annotations

import numpy as np

from wafer_viewer.draw.charts.profile_axes import ProfileFrame, digits, frame_of, runs
from wafer_viewer.draw.colormaps import PROFILE_COLOURS
from wafer_viewer.draw.number_format import number
from wafer_viewer.model.measurement.sections import Section

WIDTH, HEIGHT = 680, 210
_LEFT, _RIGHT, _TOP, _FOOT = 58, 16, 8, 36
_MOST_POINTS = 1200
_INK, _SOFT, _LINE = "#15202B", "#445463", "#DCE3EA"


def profile_svg(section: Section) -> str:
    """Return the plot of one profile, distance and height in um, scaled to the available width."""
    frame = frame_of([section])
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" width="100%" role="img" font-size="11" fill="{_SOFT}">'
        f"{_grid(frame)}{_curve(section, frame)}"
        f'<g fill="{_INK}" text-anchor="middle">'
        f'<text x="{_x(0.5):.1f}" y="{HEIGHT - 4}">Distance along the line, µm</text>'
        f'<text transform="translate(12 {_y(0.5):.1f}) rotate(-90)">z, µm</text></g></svg>'
    )


def _grid(frame: ProfileFrame) -> str:
    xs, zs = frame.x_ticks(10), frame.z_ticks(6)
    across, down = frame.across(np.array(xs)).tolist(), frame.down(np.array(zs)).tolist()
    upright = "".join(f"M{_x(a):.1f} {_y(0):.1f}V{_y(1):.1f}" for a in across)
    level = "".join(f"M{_x(0):.1f} {_y(d):.1f}H{_x(1):.1f}" for d in down)
    under = "".join(
        f'<text x="{_x(a):.1f}" y="{_y(1) + 14:.1f}" text-anchor="middle">{number(x, digits(xs))}</text>'
        for x, a in zip(xs, across, strict=True)
    )
    beside = "".join(
        f'<text x="{_LEFT - 6}" y="{_y(d) + 4:.1f}" text-anchor="end">{number(z, digits(zs))}</text>'
        for z, d in zip(zs, down, strict=True)
    )
    box = f"M{_x(0):.1f} {_y(0):.1f}H{_x(1):.1f}V{_y(1):.1f}H{_x(0):.1f}Z"
    return (
        f'<path d="{upright}{level}" fill="none" stroke="{_LINE}"/>{under}{beside}'
        f'<path d="{box}" fill="none" stroke="{_SOFT}" stroke-width=".8"/>'
    )


def _curve(section: Section, frame: ProfileFrame) -> str:
    """Return each measured segment as a separate path; a single point is a dot."""
    pieces: list[str] = []
    for across, down in runs(section, frame, _MOST_POINTS):
        points = [f"{_x(a):.1f} {_y(d):.1f}" for a, d in zip(across.tolist(), down.tolist(), strict=True)]
        pieces.append(f"M{points[0]}" + (f"L{' '.join(points[1:])}" if len(points) > 1 else "h.1"))
    look = 'fill="none" stroke-width="1.4" stroke-linejoin="round" stroke-linecap="round"'
    return f'<path d="{"".join(pieces)}" {look} stroke="{PROFILE_COLOURS[section.asked.place]}"/>'


def _x(across: float) -> float:
    return _LEFT + across * (WIDTH - _LEFT - _RIGHT)


def _y(down: float) -> float:
    return _TOP + down * (HEIGHT - _TOP - _FOOT)
