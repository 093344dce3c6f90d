"""Profile plot as HTML: all curves in the colours of their lines over one distance axis, with cursors.

Axis colours are the page's custom properties, so one drawing serves light and dark. Lines are in a stretched SVG and
labels are placed over it in percent, so the plot fills its container.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.draw.charts.profile_axes import ProfileFrame, digits, dots, runs
from wafer_viewer.draw.colormaps import BRUSH, PROFILE_COLOURS
from wafer_viewer.draw.number_format import number
from wafer_viewer.model.measurement.sections import Section, SlabPoints

LEFT_PX, RIGHT_PX, TOP_PX, FOOT_PX = 58, 14, 8, 40
_SIDE = 8000
"""Side of the drawing in its own units: tenths of a pixel on a wide screen."""
_DOT_PX = 2.2
_DASHES = 'stroke-dasharray="5 3"'


def profile_plot_html(
    sections: Sequence[Section],
    frame: ProfileFrame,
    cursors_um: Sequence[float],
    brush_um: tuple[float, float] | None = None,
) -> str:
    """Return the plot, which fills its container. brush_um: a height range highlighted on the curves."""
    place = f"left:{LEFT_PX}px;right:{RIGHT_PX}px;top:{TOP_PX}px;bottom:{FOOT_PX}px"
    points = "".join(_dots(section.points, frame) for section in sections if section.points is not None)
    curves = points + "".join(_curve(section, frame) for section in sorted(sections, key=lambda s: s.asked.is_second))
    if brush_um is not None:
        curves = _band(frame, brush_um) + curves + "".join(_brushed(section, frame, brush_um) for section in sections)
    drawn = f"{_grid(frame)}<g>{curves}</g>{''.join(_cursor(frame, at) for at in cursors_um)}"
    return (
        f'<div class="wv-plot wv-profiles"><div style="position:absolute;{place}">'
        f'<svg viewBox="0 0 {_SIDE} {_SIDE}" preserveAspectRatio="none" role="img" aria-label="Profiles">{drawn}</svg>'
        f'{_words(frame)}</div><span class="wv-plot-y">z, µm</span>'
        f'<span class="wv-plot-x">Distance along the {"slab" if points else "profile"}, µm</span></div>'
    )


def _dots(points: SlabPoints, frame: ProfileFrame) -> str:
    """Return the points of a slab as dots; the running median is drawn over them."""
    across, down = dots(points, frame)
    at = np.rint(np.column_stack([across, down]) * _SIDE).astype(int).tolist()
    d = "".join(f"M{x} {y}h1" for x, y in at)
    look = f'stroke="var(--ink3)" stroke-opacity=".5" stroke-width="{_DOT_PX}" stroke-linecap="round"'
    return f'<path class="wv-slab-points" data-points="{len(points)}" d="{d}" {look}/>'


def _curve(section: Section, frame: ProfileFrame) -> str:
    second = section.asked.is_second
    d = "".join(f"M{_points(x, down)}" for x, down in runs(section, frame))
    colour = PROFILE_COLOURS[section.asked.place]
    # In its line's colour drawn towards that of text: it is seen over a noisy curve, on light and on dark.
    colour = f"color-mix(in srgb, {colour} 45%, var(--ink))" if second else colour
    more = _DASHES if second else ""
    return (
        f'<path class="wv-curve" data-curve="{section.asked.letter}{"+" if second else ""}" d="{d}" '
        f'stroke="{colour}" stroke-width="{1.4 if second else 1.8}" stroke-linecap="round" {more}/>'
    )


def _band(frame: ProfileFrame, brush_um: tuple[float, float]) -> str:
    """Return the brushed range as a band behind the curves."""
    top, foot = np.clip(_SIDE * frame.down(np.array([brush_um[1], brush_um[0]])), 0, _SIDE)
    return f'<path d="M0 {top:.0f}H{_SIDE}V{foot:.0f}H0Z" fill="{BRUSH}" fill-opacity=".09" stroke="none"/>'


def _brushed(section: Section, frame: ProfileFrame, brush_um: tuple[float, float]) -> str:
    """Return the parts of a curve within the brushed range."""
    z = section.curve.z_um
    curve = replace(section.curve, z_um=np.where((z >= brush_um[0]) & (z <= brush_um[1]), z, np.nan))
    d = "".join(f"M{_points(x, down)}" for x, down in runs(replace(section, curve=curve), frame))
    look = f'stroke="{BRUSH}" stroke-width="2.6" stroke-linecap="round"'
    return f'<path class="wv-brushed" d="{d}" {look}/>' if d else ""


def _points(x: NDArray[np.float64], down: NDArray[np.float64]) -> str:
    """Return coordinate pairs in drawing units; a single point is drawn as a dot."""
    pairs = np.clip(np.rint(np.column_stack([x, down]) * _SIDE), -_SIDE, 2 * _SIDE).astype(int)
    text = " ".join(map(str, pairs.ravel().tolist()))
    return text if len(pairs) > 1 else f"{text}h1"


def _grid(frame: ProfileFrame) -> str:
    up = "".join(f"M{x:.0f} 0V{_SIDE}" for x in _SIDE * frame.across(np.array(frame.x_ticks(11))))
    along = "".join(f"M0 {z:.0f}H{_SIDE}" for z in _SIDE * frame.down(np.array(frame.z_ticks(5))))
    return f'<path d="{up}{along}" stroke="var(--line)" stroke-width="1"/>'


def _cursor(frame: ProfileFrame, at_um: float) -> str:
    across = float(frame.across(np.array(at_um)))
    if not 0 <= across <= 1:
        return ""
    upright = f"M{_SIDE * across:.0f} 0V{_SIDE}"
    return f'<path class="wv-cursor" d="{upright}" stroke="var(--ink)" stroke-width="1.2"/>'


def _words(frame: ProfileFrame) -> str:
    xs, zs = frame.x_ticks(11), frame.z_ticks(5)
    below = "".join(
        f'<i class="x" style="left:{100 * at:.2f}%">{number(x, digits(xs))}</i>'
        for x, at in zip(xs, frame.across(np.array(xs)).tolist(), strict=True)
    )
    beside = "".join(
        f'<i class="y" style="top:{100 * at:.2f}%">{number(z, digits(zs))}</i>'
        for z, at in zip(zs, frame.down(np.array(zs)).tolist(), strict=True)
    )
    return below + beside
