"""Profile plots: live curves on the page, a profile in a report, and the zones of a groove or step.

Axis colours are the page's custom properties, so one drawing serves light and dark. Lines are in a stretched SVG and
labels are placed over it in percent, so the plot fills its container.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.draw.colormaps import BRUSH, PROFILE_COLOURS
from wafer_viewer.draw.number_format import number, round_step, tick_digits, ticks
from wafer_viewer.model.measurement.measurements import StepProfile
from wafer_viewer.model.measurement.sections import Section, SlabPoints

Floats = NDArray[np.float64]
Ends = tuple[float, float]
MOST_POINTS = 1500
"""Greatest number of curve points, above the pixel width of a plot on the page."""
MOST_DOTS = 4000
"""Greatest number of drawn slab points; more would hide each other."""
_NEARLY_ALL = 0.2, 99.8
"""Percentiles of the slab points that the plot contains at least."""
_LEAST_SPAN_UM = 1e-3


@dataclass(frozen=True, slots=True)
class ProfileFrame:
    """Limits of a plot in um: distance along the lines, and heights."""

    x_um: Ends
    z_um: Ends

    def across(self, x_um: Floats) -> Floats:
        """Return the horizontal positions of distances, from 0 (left) to 1 (right)."""
        return (x_um - self.x_um[0]) / (self.x_um[1] - self.x_um[0])

    def down(self, z_um: Floats) -> Floats:
        """Return the vertical positions of heights, from 0 (top) to 1 (bottom)."""
        return (self.z_um[1] - z_um) / (self.z_um[1] - self.z_um[0])

    def x_ticks(self, most: int) -> list[float]:
        """Return round distances."""
        return ticks(*self.x_um, most)

    def z_ticks(self, most: int) -> list[float]:
        """Return round heights."""
        return ticks(*self.z_um, most)

    def holding(self, z_um: Ends) -> ProfileFrame:
        """Return the frame with other height limits."""
        return replace(self, z_um=z_um)


def frame_of(sections: Sequence[Section], span_um: Ends | None = None) -> ProfileFrame:
    """Return the frame of all curves, or of a distance range, with height limits from `round_ends`."""
    longest = max((float(s.curve.distance_um[-1]) for s in sections), default=1.0)
    low, high = (max(0.0, span_um[0]), min(longest, span_um[1])) if span_um is not None else (0.0, longest)
    if not high - low > _LEAST_SPAN_UM:
        low, high = 0.0, longest
    seen = [s.curve.z_um[(s.curve.distance_um >= low) & (s.curve.distance_um <= high)] for s in sections]
    seen += [_nearly_all(s.points, (low, high)) for s in sections if s.points is not None]
    return ProfileFrame((low, high), round_ends(np.concatenate([*seen, np.empty(0)])))


def dots(points: SlabPoints, frame: ProfileFrame, most: int = MOST_DOTS) -> tuple[Floats, Floats]:
    """Return the points of a slab within a frame as fractions (across, down) of it.

    Above `most` points a random subset with a fixed seed is drawn, so that nothing flickers.
    """
    inside = np.flatnonzero(
        (points.distance_um >= frame.x_um[0])
        & (points.distance_um <= frame.x_um[1])
        & (points.z_um >= frame.z_um[0])
        & (points.z_um <= frame.z_um[1])
    )
    if inside.size > most:
        inside = np.sort(np.random.default_rng(0).choice(inside, most, replace=False))
    return frame.across(points.distance_um[inside].astype(float)), frame.down(points.z_um[inside].astype(float))


def _nearly_all(points: SlabPoints, x_um: Ends) -> Floats:
    """Return height percentiles of the points in a distance range, so that outliers do not flatten the plot."""
    z_um = points.z_um[(points.distance_um >= x_um[0]) & (points.distance_um <= x_um[1])]
    return np.percentile(z_um.astype(float), _NEARLY_ALL) if z_um.size else np.empty(0)


def round_ends(z_um: Floats) -> Ends:
    """Return round limits around heights, which are stable against small changes of the heights."""
    good = z_um[np.isfinite(z_um)]
    if good.size == 0:
        return -1.0, 1.0
    low, high = float(good.min()), float(good.max())
    step = round_step(max((high - low) / 4, 0.05))
    return float(step * np.floor(low / step - 0.15)), float(step * np.ceil(high / step + 0.15))


def digits(values: list[float]) -> int:
    """Return the number of decimals of ticks."""
    return tick_digits(values)


def runs(section: Section, frame: ProfileFrame, most: int = MOST_POINTS) -> list[tuple[Floats, Floats]]:
    """Return the measured segments of a curve within a frame, as fractions (across, down) of it.

    A curve with more than `most` points retains every peak, valley and gap that the frame can resolve.
    """
    curve = section.curve
    first, last = np.searchsorted(curve.distance_um, frame.x_um)
    part = slice(max(0, int(first) - 1), int(last) + 1)
    x, z = thinned(curve.distance_um[part], curve.z_um[part], most)
    good = np.flatnonzero(np.isfinite(z))
    pieces = np.split(good, np.flatnonzero(np.diff(good) > 1) + 1) if good.size else []
    return [(frame.across(x[piece]), frame.down(z[piece])) for piece in pieces]


def thinned(x: Floats, z: Floats, most: int) -> tuple[Floats, Floats]:
    """Decimate a curve to at most `most` points, with all peaks, valleys, and gaps as wide as an interval.

    Each interval is represented by its lowest and highest point; one without a measured point is a gap (NaN).
    """
    if len(z) <= most:
        return x, z
    length = -(-len(z) // (most // 2))
    padded = np.pad(z, (0, -len(z) % length), constant_values=np.nan).reshape(-1, length)
    known = np.isfinite(padded)
    picked = np.sort(
        [np.where(known, padded, np.inf).argmin(axis=1), np.where(known, padded, -np.inf).argmax(axis=1)], 0
    )
    index = np.minimum(picked.T + length * np.arange(len(padded))[:, None], len(z) - 1).ravel()
    kept = np.where(np.repeat(known.any(axis=1), 2), z[index], np.nan)
    return x[index], kept


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


WIDTH, HEIGHT = 680, 210
_LEFT, _RIGHT, _TOP, _FOOT = 58, 16, 8, 36
_MOST_POINTS = 1200
_INK, _SOFT, _LINE = "#15202B", "#445463", "#DCE3EA"


def profile_svg(section: Section) -> str:
    """Return the plot of one profile, distance and height in um, scaled to the available width."""
    frame = frame_of([section])
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" width="100%" role="img" font-size="11" fill="{_SOFT}">'
        f"{_printed_grid(frame)}{_printed_curve(section, frame)}"
        f'<g fill="{_INK}" text-anchor="middle">'
        f'<text x="{_x(0.5):.1f}" y="{HEIGHT - 4}">Distance along the line, µm</text>'
        f'<text transform="translate(12 {_y(0.5):.1f}) rotate(-90)">z, µm</text></g></svg>'
    )


def _printed_grid(frame: ProfileFrame) -> str:
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


def _printed_curve(section: Section, frame: ProfileFrame) -> str:
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


_GROOVE_W, _GROOVE_H = 372, 118
_GROOVE_TOP, _GROOVE_FOOT, _GROOVE_SIDE = 16, 16, 2
_HEADROOM = 0.08
_GAP = 3.0
"""Point distance, in multiples of the median distance, above which the curve is interrupted."""


def groove_svg(finding: StepProfile) -> str:
    """Return the profile as SVG, distance to the right, height upwards, zones as pale bands; empty without a curve."""
    if len(finding.curve) < 2:
        return ""
    at_um, z_um = np.array(finding.curve, float).T
    length_um = max(float(at_um[-1]), max((end for _, _, end in finding.zones), default=0.0), 1e-9)
    x = _GROOVE_SIDE + (_GROOVE_W - 2 * _GROOVE_SIDE) * at_um / length_um
    low, span = float(z_um.min()), max(float(np.ptp(z_um)), 1e-9)
    y = (
        _GROOVE_H
        - _GROOVE_FOOT
        - (_GROOVE_H - _GROOVE_TOP - _GROOVE_FOOT) * (_HEADROOM + (1 - 2 * _HEADROOM) * (z_um - low) / span)
    )
    bands = "".join(_zone_band(name, start / length_um, end / length_um) for name, start, end in finding.zones)
    return (
        f'<svg viewBox="0 0 {_GROOVE_W} {_GROOVE_H}" width="100%" role="img" aria-label="Profile with its zones" '
        f'font-size="11" fill="currentColor">{bands}'
        f'<path d="{_path(x, y)}" fill="none" stroke="{PROFILE_COLOURS[0]}" stroke-width="1.6" '
        'stroke-linejoin="round" stroke-linecap="round"/>'
        f'<text x="{_GROOVE_SIDE}" y="{_GROOVE_H - 3}">0</text>'
        f'<text x="{_GROOVE_W - _GROOVE_SIDE}" y="{_GROOVE_H - 3}" text-anchor="end">{number(length_um, 1)} µm</text>'
        "</svg>"
    )


def _zone_band(name: str, start: float, end: float) -> str:
    left, right = (_GROOVE_SIDE + (_GROOVE_W - 2 * _GROOVE_SIDE) * share for share in (start, end))
    return (
        f'<rect x="{left:.1f}" y="{_GROOVE_TOP}" width="{right - left:.1f}" '
        f'height="{_GROOVE_H - _GROOVE_TOP - _GROOVE_FOOT}" opacity=".08"/>'
        f'<text x="{(left + right) / 2:.1f}" y="{_GROOVE_TOP - 4}" text-anchor="middle">{name}</text>'
    )


def _path(x: np.ndarray, y: np.ndarray) -> str:
    step = np.diff(x)
    apart = np.concatenate([[True], step > _GAP * float(np.median(step))])
    return "".join(
        f"{'M' if new else 'L'}{a:.1f} {b:.1f}" for new, a, b in zip(apart, x.tolist(), y.tolist(), strict=True)
    )
