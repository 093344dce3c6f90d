"""Plots of curves: live profiles, those of a report, the zones of a groove or step, and the focus curve of a pixel.

On the page lines are in a stretched SVG and labels are placed over it in percent, so the plot fills its container.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from wafer_viewer.draw.charts.axes import Axis, ChartAxes, Ends, Floats, PlotLook, line_svg, plot_html, round_ticks
from wafer_viewer.draw.colormaps import BRUSH, PROFILE_COLOURS
from wafer_viewer.draw.number_format import number, round_step, share, with_unit
from wafer_viewer.model.file_contents import FrameFact
from wafer_viewer.model.measurement.measurements import StepProfile
from wafer_viewer.model.measurement.sections import Section, SlabPoints
from wafer_viewer.model.surface.focus_curve import FocusCurve, Rival

Heights = NDArray[np.float32]

# ----------------------------------------------------------------------------------------------------- focus curve plot


_FOCUS_HEADROOM = 1.17
"""Height of the plot relative to the peak, with space for the label."""
_Y_TICKS = ((0.0, "0"), (0.5, "50"), (1.0, "100"))
_LEAST_NAMED, _APART_PERCENT = 0.05, 16
"""Least height of a labelled rival relative to the peak, and least label distance in percent of the width."""


def focus_plot_html(curve: FocusCurve, height_px: int, over: str = "") -> Markup:
    """Return the plot at `height_px`; `over` is HTML that covers the curve area."""
    ends_um = curve.z_um[0], curve.z_um[-1]
    axes = ChartAxes.stretched(ends_um, (0.0, _FOCUS_HEADROOM), round_ticks(ends_um, 7), _Y_TICKS)
    look = PlotLook("Focus curve", "Focus, % of the peak", "z, µm", top_px=6, style=f"height:{height_px}px")
    drawn = Markup("").join(
        (_peak_line(axes, curve), _line(axes, curve), *(_ring(axes, rival) for rival in curve.rivals))
    )
    words = Markup("").join((_peak_label(axes, curve), *(_rival_label(axes, rival) for rival in _named(axes, curve))))
    return plot_html(axes, look, drawn, words + over)


PLACE_COLOURS = (*PROFILE_COLOURS, "var(--ink3)")
"""Colours of the places of a frame."""
_Z_MARGIN = 0.02


def sharpness_plot_html(frames: Sequence[FrameFact], height_px: int) -> Markup:
    """Return the plot of sharpness over z at the places of the frames; gaps between frames are marked.

    Frames of unknown z are drawn over their number.
    """
    known = all(frame.z_um is not None for frame in frames)
    z_um = [frame.z_um if known and frame.z_um is not None else float(n) for n, frame in enumerate(frames)]
    margin = _Z_MARGIN * (max(z_um) - min(z_um))
    ends = min(z_um) - margin, max(z_um) + margin
    axes = ChartAxes.stretched(ends, (0.0, 1.06), round_ticks(ends, 8), _SHARPNESS_TICKS)
    x_title = "z, µm" if known else "frame"
    look = PlotLook("Sharpness", "sharpness", x_title, top_px=4, style=f"height:{height_px}px")
    n_places = max((len(frame.sharpness) for frame in frames), default=0)
    gaps = [_gap(axes, z_um, n) for n, frame in enumerate(frames) if not frame.name]
    curves = [_place_curve(axes, z_um, frames, place) for place in range(n_places)]
    return plot_html(axes, look, Markup("").join([*gaps, *curves]))


_SHARPNESS_TICKS = ((0.0, "0"), (0.5, "0.5"), (1.0, "1"))


def _gap(axes: ChartAxes, z_um: Sequence[float], n: int) -> Markup:
    """Return the band from the frame before a missing one to the frame after it, half-way."""
    low, high = ((z_um[n] + z_um[min(max(m, 0), len(z_um) - 1)]) / 2 for m in (n - 1, n + 1))
    left, right = sorted((axes.x.at(low), axes.x.at(high)))
    foot, top = axes.y.span
    return Markup(
        '<rect x="{:.1f}" y="{:g}" width="{:.1f}" height="{:g}" fill="var(--attention)" fill-opacity=".2">'
        "<title>no frame</title></rect>"
    ).format(left, top, right - left, foot - top)


def _place_curve(axes: ChartAxes, z_um: Sequence[float], frames: Sequence[FrameFact], place: int) -> Markup:
    """Return the curve of one place, which breaks where a frame is missing."""
    points = [
        f"{axes.x.at(z):.1f} {axes.y.at(frame.sharpness[place]):.1f}" if len(frame.sharpness) > place else ""
        for z, frame in zip(z_um, frames, strict=True)
    ]
    line = "".join(f"{'L' if n and points[n - 1] else 'M'}{point}" for n, point in enumerate(points) if point)
    dots = "".join(f"M{point}h.01" for point in points if point)
    colour = PLACE_COLOURS[place % len(PLACE_COLOURS)]
    return Markup(
        '<g style="stroke:{}"><path d="{}" stroke-width="1.5" stroke-opacity=".75"/>'
        '<path d="{}" stroke-width="5" stroke-linecap="round"/></g>'
    ).format(colour, line, dots)


def _point(axes: ChartAxes, z_um: float, focus: float) -> str:
    return f"{axes.x.at(axes.x.within(z_um)):.1f} {axes.y.at(focus):.1f}"


def _line(axes: ChartAxes, curve: FocusCurve) -> Markup:
    points = [_point(axes, z, focus) for z, focus in zip(curve.z_um, curve.focus, strict=True)]
    return line_svg(f"M{'L'.join(points)}", "accent", 1.8) + _focus_dots(points, "accent", 4.6)


def _focus_dots(points: list[str], colour: str, width_px: float) -> Markup:
    """Return round points as zero-length strokes with round caps, which do not distort when stretched."""
    return line_svg(Markup("").join(f"M{p}h.01" for p in points), colour, width_px, Markup('stroke-linecap="round"'))


def _peak_line(axes: ChartAxes, curve: FocusCurve) -> Markup:
    dashes = Markup() if curve.height_um is not None else Markup('stroke-dasharray="5 4"')
    return line_svg(axes.upright(axes.x.within(curve.peak_z_um)), _peak_colour(curve), 1.6, dashes)


def _peak_colour(curve: FocusCurve) -> str:
    return "good" if curve.height_um is not None else "attention"


def _ring(axes: ChartAxes, rival: Rival) -> Markup:
    points = [_point(axes, rival.z_um, rival.share)]
    return _focus_dots(points, "attention", 10) + _focus_dots(points, "panel", 6)


def _peak_label(axes: ChartAxes, curve: FocusCurve) -> Markup:
    believed = "" if curve.height_um is not None else ", not believed"
    text = f"peak {with_unit(curve.peak_z_um, 2, signed=True)}{believed}"
    return _plot_label(_percent(axes, curve.peak_z_um), "top:-1px", _peak_colour(curve), text)


def _named(axes: ChartAxes, curve: FocusCurve) -> list[Rival]:
    """Return the rivals that have space for a label, the highest first."""
    named: list[Rival] = []
    for rival in curve.rivals:
        taken = [curve.peak_z_um] if rival.share > 1 - _APART_PERCENT / 100 else []
        others = [_percent(axes, z) for z in (*taken, *(r.z_um for r in named))]
        across = _percent(axes, rival.z_um)
        if rival.share >= _LEAST_NAMED and all(abs(across - x) >= _APART_PERCENT for x in others):
            named.append(rival)
    return named


def _rival_label(axes: ChartAxes, rival: Rival) -> Markup:
    where = f"top:calc({axes.y.percent(rival.share):.2f}% - 20px)"
    return _plot_label(_percent(axes, rival.z_um), where, "attention", f"rival {share(rival.share, 0)}")


def _percent(axes: ChartAxes, z_um: float) -> float:
    return axes.x.percent(axes.x.within(z_um))


def _plot_label(across: float, where: str, colour: str, text: str) -> Markup:
    """Return a label right of a position in percent, or left of it in the right half of the plot."""
    side = f"left:calc({across:.2f}% + 7px)" if across < 50 else f"right:calc({100 - across:.2f}% + 7px)"
    return Markup('<b style="{side};{where};color:var(--{colour})">{text}</b>').format(
        side=side, where=where, colour=colour, text=text
    )


# --------------------------------------------------------------------------------------------------------- profile plot


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

    def holding(self, z_um: Ends) -> ProfileFrame:
        """Return the frame with other height limits."""
        return replace(self, z_um=z_um)


def frame_of(sections: Sequence[Section], span_um: Ends | None = None) -> ProfileFrame:
    """Return the frame of all curves, or of a distance range, with height limits from `round_ends`."""
    longest = max((float(s.curve.distance_um[-1]) for s in sections), default=1.0)
    low, high = (max(0.0, span_um[0]), min(longest, span_um[1])) if span_um is not None else (0.0, longest)
    if not high - low > _LEAST_SPAN_UM:
        low, high = 0.0, longest
    heights = [s.curve.z_um[(s.curve.distance_um >= low) & (s.curve.distance_um <= high)] for s in sections]
    heights += [_nearly_all(s.points, (low, high)) for s in sections if s.points is not None]
    return ProfileFrame((low, high), round_ends(np.concatenate([*heights, np.empty(0)])))


def dots(points: SlabPoints, frame: ProfileFrame, most: int = MOST_DOTS) -> tuple[Floats, Floats]:
    """Return distance and height, um, of the points of a slab within a frame.

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
    return points.distance_um[inside].astype(float), points.z_um[inside].astype(float)


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


def shown_curve(section: Section, frame: ProfileFrame, most: int = MOST_POINTS) -> tuple[Floats, Floats]:
    """Return distance and height, um, of a curve within a frame and one point beyond; NaN where unmeasured.

    A curve with more than `most` points retains every peak, valley and gap that the frame can resolve.
    """
    curve = section.curve
    first, last = np.searchsorted(curve.distance_um, frame.x_um)
    part = slice(max(0, int(first) - 1), int(last) + 1)
    return thinned(curve.distance_um[part], curve.z_um[part], most)


def runs(section: Section, frame: ProfileFrame, most: int = MOST_POINTS) -> list[tuple[Floats, Floats]]:
    """Return the measured segments of `shown_curve`."""
    x, z = shown_curve(section, frame, most)
    good = np.flatnonzero(np.isfinite(z))
    pieces = np.split(good, np.flatnonzero(np.diff(good) > 1) + 1) if good.size else []
    return [(x[piece], z[piece]) for piece in pieces]


def thinned(x: Floats, z: Floats, most: int) -> tuple[Floats, Floats]:
    """Decimate a curve to at most `most` points, with all peaks, valleys, and gaps as wide as an interval.

    Each interval is represented by its lowest and highest point; one without a measured point is a gap (NaN).
    """
    if len(z) <= most:
        return x, z
    length = -(-len(z) // (most // 2))
    padded = np.pad(z, (0, -len(z) % length), constant_values=np.nan).reshape(-1, length)
    measured = np.isfinite(padded)
    picked = np.sort(
        [np.where(measured, padded, np.inf).argmin(axis=1), np.where(measured, padded, -np.inf).argmax(axis=1)], 0
    )
    index = np.minimum(picked.T + length * np.arange(len(padded))[:, None], len(z) - 1).ravel()
    envelope = np.where(np.repeat(measured.any(axis=1), 2), z[index], np.nan)
    return x[index], envelope


_SIDE = 8000
"""Side of the drawing in its own units: tenths of a pixel on a wide screen."""
_DOT_PX = 2.2
_DASHES = Markup('stroke-dasharray="5 3"')


def profile_plot_html(
    sections: Sequence[Section],
    frame: ProfileFrame,
    cursors_um: Sequence[float],
    brush_um: tuple[float, float] | None = None,
) -> Markup:
    """Return the plot, which fills its container. brush_um: a height range highlighted on the curves."""
    axes = ChartAxes.stretched(frame.x_um, frame.z_um, round_ticks(frame.x_um, 11), round_ticks(frame.z_um, 5), _SIDE)
    points = Markup("").join(_dots(section.points, frame, axes) for section in sections if section.points is not None)
    ordered = sorted(sections, key=lambda section: section.asked.is_second)
    curves = points + Markup("").join(_curve(section, frame, axes) for section in ordered)
    if brush_um is not None:
        brushed = Markup("").join(_brushed(section, frame, axes, brush_um) for section in sections)
        curves = _band(axes, brush_um) + curves + brushed
    cursors = Markup("").join(
        _cursor(axes, cursor_um) for cursor_um in cursors_um if frame.x_um[0] <= cursor_um <= frame.x_um[1]
    )
    x_title = f"Distance along the {'slab' if points else 'profile'}, µm"
    look = PlotLook("Profiles", "z, µm", x_title, left_px=58, classes="wv-profiles")
    return plot_html(axes, look, Markup("<g>{}</g>{}").format(curves, cursors))


def _dots(points: SlabPoints, frame: ProfileFrame, axes: ChartAxes) -> Markup:
    """Return the points of a slab as dots; the running median is drawn over them."""
    x_um, z_um = dots(points, frame)
    pixels = np.rint(np.column_stack([axes.x.at(x_um), axes.y.at(z_um)])).astype(int).tolist()
    d = "".join(f"M{x} {y}h1" for x, y in pixels)
    look = Markup('stroke="var(--ink3)" stroke-opacity=".5" stroke-width="{}" stroke-linecap="round"').format(_DOT_PX)
    return Markup('<path class="wv-slab-points" data-points="{}" d="{}" {}/>').format(len(points), d, look)


def _curve(section: Section, frame: ProfileFrame, axes: ChartAxes) -> Markup:
    second = section.asked.is_second
    d = _path_of_runs(section, frame, axes)
    colour = PROFILE_COLOURS[section.asked.place]
    # In its line's colour drawn towards that of text: it is seen over a noisy curve, on light and on dark.
    colour = f"color-mix(in srgb, {colour} 45%, var(--ink))" if second else colour
    more = _DASHES if second else ""
    return Markup(
        '<path class="wv-curve" data-curve="{letter}{data_curve}" d="{d}" '
        'stroke="{colour}" stroke-width="{stroke_width}" stroke-linecap="round" {more}/>'
    ).format(
        letter=section.asked.letter,
        data_curve="+" if second else "",
        d=d,
        colour=colour,
        stroke_width=1.4 if second else 1.8,
        more=more,
    )


def _band(axes: ChartAxes, brush_um: tuple[float, float]) -> Markup:
    """Return the brushed range as a band behind the curves."""
    foot, top = (axes.y.at(axes.y.within(z)) for z in brush_um)
    return Markup(
        '<path d="M0 {top:.0f}H{side}V{foot:.0f}H0Z" fill="{brush}" fill-opacity=".09" stroke="none"/>'
    ).format(top=top, side=_SIDE, foot=foot, brush=BRUSH)


def _brushed(section: Section, frame: ProfileFrame, axes: ChartAxes, brush_um: tuple[float, float]) -> Markup:
    """Return the parts of a curve within the brushed range."""
    z = section.curve.z_um
    curve = replace(section.curve, z_um=np.where((z >= brush_um[0]) & (z <= brush_um[1]), z, np.nan))
    d = _path_of_runs(replace(section, curve=curve), frame, axes)
    look = Markup('stroke="{}" stroke-width="2.6" stroke-linecap="round"').format(BRUSH)
    return Markup('<path class="wv-brushed" d="{}" {}/>').format(d, look) if d else Markup()


def _path_of_runs(section: Section, frame: ProfileFrame, axes: ChartAxes) -> str:
    """Return the measured segments in drawing units; a single point is drawn as a dot."""
    d = ""
    for x_um, z_um in runs(section, frame):
        pairs = np.rint(np.column_stack([axes.x.at(x_um), axes.y.at(z_um)]))
        text = " ".join(map(str, np.clip(pairs, -_SIDE, 2 * _SIDE).astype(int).ravel().tolist()))
        d += f"M{text}" if len(pairs) > 1 else f"M{text}h1"
    return d


def _cursor(axes: ChartAxes, at_um: float) -> Markup:
    return Markup('<path class="wv-cursor" d="{}" stroke="var(--ink)" stroke-width="1.2"/>').format(axes.upright(at_um))


SIZE_PX = 680, 210
_LEFT, _RIGHT, _TOP, _FOOT = 58, 16, 8, 36
_MOST_POINTS = 1200
_INK, _SOFT, _LINE, _BAND = "#15202B", "#445463", "#DCE3EA", "#EEF1F4"


def profile_svg(section: Section, size_px: tuple[int, int] = SIZE_PX, bands: Sequence[Ends] = ()) -> Markup:
    """Return the plot of one profile, distance and height in um, scaled to the available width; bands are shaded."""
    frame = frame_of([section])
    axes = _printed_axes(frame, size_px)
    shaded = Markup("").join(_shaded(axes, *band) for band in bands)
    return _printed_plot(axes, size_px, shaded, _printed_curve(section, frame, axes))


def curves_svg(curves: Mapping[str, tuple[Heights, Heights]], z_um: Ends) -> Markup:
    """Return the plot of named curves, stage x and height in um, with their legend, scaled to the available width.

    Heights beyond the limits `z_um` are drawn at them.
    """
    x_um = np.concatenate([x for x, _ in curves.values()])
    axes = _printed_axes(ProfileFrame((float(x_um.min()), float(x_um.max())), z_um), SIZE_PX)
    colours = (*PROFILE_COLOURS[: len(curves) - 1], _INK)
    drawn = (
        _named_curve(axes, x, np.clip(z, *z_um), name, n, colour)
        for n, (colour, (name, (x, z))) in enumerate(zip(colours, curves.items(), strict=True))
    )
    return _printed_plot(axes, SIZE_PX, Markup(), Markup("").join(drawn), "x of the stage, µm")


def _named_curve(axes: ChartAxes, x_um: Heights, z_um: Heights, name: str, n: int, colour: str) -> Markup:
    """Return a curve, and the n-th name of the legend."""
    return Markup(
        '<path d="{}" fill="none" stroke-width=".9" stroke="{}"/>'
        '<text x="{}" y="{}" fill="{}" font-weight="650" stroke="#fff" stroke-width="3" paint-order="stroke">{}</text>'
    ).format(_with_gaps(axes, x_um, z_um), colour, _LEFT + 8 + 90 * n, _TOP + 14, colour, name)


def _with_gaps(axes: ChartAxes, x_um: Heights, z_um: Heights) -> str:
    """Return the path of a curve that breaks where it has no height."""
    known = np.isfinite(z_um)
    starts = known & ~np.append(False, known[:-1])
    x_px, y_px = axes.x.at(x_um[known].astype(float)), axes.y.at(z_um[known].astype(float))
    points = zip(x_px.tolist(), y_px.tolist(), starts[known].tolist(), strict=True)
    return "".join(f"{'M' if start else 'L'}{x:.1f} {y:.1f}" for x, y, start in points)


def _printed_axes(frame: ProfileFrame, size_px: tuple[int, int]) -> ChartAxes:
    width, height = size_px
    return ChartAxes(
        Axis(frame.x_um, (_LEFT, width - _RIGHT), round_ticks(frame.x_um, width // 70)),
        Axis(frame.z_um, (height - _FOOT, _TOP), round_ticks(frame.z_um, 6)),
    )


def _printed_plot(
    axes: ChartAxes,
    size_px: tuple[int, int],
    shaded: Markup,
    drawn: Markup,
    x_title: str = "Distance along the line, µm",
) -> Markup:
    """Return curves over shaded bands, with axes, grid and titles round them."""
    width, height = size_px
    middle_x, middle_y = sum(axes.x.span) / 2, sum(axes.y.span) / 2
    return Markup(
        '<svg viewBox="0 0 {width} {height}" width="100%" role="img" font-size="11" fill="{soft}">{shaded}'
        '<path d="{grid}" fill="none" stroke="{line}"/>{labels_svg}'
        '<path d="{frame}" fill="none" stroke="{soft}" stroke-width=".8"/>'
        "{drawn}"
        '<g fill="{ink}" text-anchor="middle">'
        '<text x="{middle_x:.1f}" y="{y}">{x_title}</text>'
        '<text transform="translate(12 {middle_y:.1f}) rotate(-90)">z, µm</text></g></svg>'
    ).format(
        width=width,
        height=height,
        soft=_SOFT,
        shaded=shaded,
        x_title=x_title,
        grid=axes.grid(),
        line=_LINE,
        labels_svg=axes.labels_svg(),
        frame=axes.frame(),
        drawn=drawn,
        ink=_INK,
        middle_x=middle_x,
        y=height - 4,
        middle_y=middle_y,
    )


def _shaded(axes: ChartAxes, start_um: float, stop_um: float) -> Markup:
    left, right = (axes.x.at(axes.x.within(end)) for end in (start_um, stop_um))
    foot, top = axes.y.span
    return Markup('<rect x="{:.1f}" y="{:g}" width="{:.1f}" height="{:g}" fill="{}"/>').format(
        left, top, right - left, foot - top, _BAND
    )


def _printed_curve(section: Section, frame: ProfileFrame, axes: ChartAxes) -> Markup:
    """Return each measured segment as a separate path; a single point is a dot."""
    pieces: list[str] = []
    for x_um, z_um in runs(section, frame, _MOST_POINTS):
        positions = zip(axes.x.at(x_um).tolist(), axes.y.at(z_um).tolist(), strict=True)
        points = [f"{x:.1f} {y:.1f}" for x, y in positions]
        pieces.append(f"M{points[0]}" + (f"L{' '.join(points[1:])}" if len(points) > 1 else "h.1"))
    look = Markup('fill="none" stroke-width="1.4" stroke-linejoin="round" stroke-linecap="round"')
    return Markup('<path d="{}" {} stroke="{}"/>').format(
        Markup("").join(pieces), look, PROFILE_COLOURS[section.asked.place]
    )


_GROOVE_W, _GROOVE_H = 372, 118
_GROOVE_TOP, _GROOVE_FOOT, _GROOVE_SIDE = 16, 16, 2
_HEADROOM = 0.08
_GAP = 3.0
"""Point distance, in multiples of the median distance, above which the curve is interrupted."""


def groove_svg(finding: StepProfile) -> Markup:
    """Return the profile as SVG, distance to the right, height upwards, zones as pale bands; empty without a curve."""
    if len(finding.curve) < 2:
        return Markup()
    at_um, z_um = np.array(finding.curve, float).T
    length_um = max(float(at_um[-1]), max((end for _, _, end in finding.zones), default=0.0), 1e-9)
    low_um, high_um = float(z_um.min()), float(z_um.max())
    room_um = _HEADROOM * max(high_um - low_um, 1e-9) / (1 - 2 * _HEADROOM)
    x = Axis((0.0, length_um), (_GROOVE_SIDE, _GROOVE_W - _GROOVE_SIDE))
    y = Axis((low_um - room_um, high_um + room_um), (_GROOVE_H - _GROOVE_FOOT, _GROOVE_TOP))
    bands = Markup("").join(_zone_band(name, x.at(start), x.at(end)) for name, start, end in finding.zones)
    return Markup(
        '<svg viewBox="0 0 {groove_w} {groove_h}" width="100%" role="img" aria-label="Profile with its zones" '
        'font-size="11" fill="currentColor">{bands}'
        '<path d="{path}" fill="none" stroke="{stroke}" stroke-width="1.6" '
        'stroke-linejoin="round" stroke-linecap="round"/>'
        '<text x="{groove_side}" y="{y}">0</text>'
        '<text x="{x}" y="{y}" text-anchor="end">{number} µm</text>'
        "</svg>"
    ).format(
        groove_w=_GROOVE_W,
        groove_h=_GROOVE_H,
        bands=bands,
        path=_path(x.at(at_um), y.at(z_um)),
        stroke=PROFILE_COLOURS[0],
        groove_side=_GROOVE_SIDE,
        y=_GROOVE_H - 3,
        x=_GROOVE_W - _GROOVE_SIDE,
        number=number(length_um, 1),
    )


def _zone_band(name: str, left: float, right: float) -> Markup:
    return Markup(
        '<rect x="{left:.1f}" y="{groove_top}" width="{width:.1f}" '
        'height="{height}" opacity=".08"/>'
        '<text x="{x:.1f}" y="{y}" text-anchor="middle">{name}</text>'
    ).format(
        left=left,
        groove_top=_GROOVE_TOP,
        width=right - left,
        height=_GROOVE_H - _GROOVE_TOP - _GROOVE_FOOT,
        x=(left + right) / 2,
        y=_GROOVE_TOP - 4,
        name=name,
    )


def _path(x: Floats, y: Floats) -> str:
    step = np.diff(x)
    apart = np.concatenate([[True], step > _GAP * float(np.median(step))])
    return "".join(
        f"{'M' if new else 'L'}{a:.1f} {b:.1f}" for new, a, b in zip(apart, x.tolist(), y.tolist(), strict=True)
    )
