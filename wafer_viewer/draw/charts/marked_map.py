"""Map for print: a picture of the surface with axes in um, scale bar, colour bar and numbered places, as SVG."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from wafer_viewer.draw.charts.axes import Axis, ChartAxes, Tick, round_ticks
from wafer_viewer.draw.charts.label_placement import LabelledPlace, place_labels
from wafer_viewer.draw.colormaps import PROFILE_COLOURS, table
from wafer_viewer.draw.number_format import length_text, number, round_length
from wafer_viewer.model.region import Region

INK, SECOND, EDGE, PAPER = "#15202B", "#445463", "#8895A3", "#FFFFFF"
HATCH = "#EEF1F4", "#A9B4C0"
"""Ground and lines of the hatch where nothing is measured."""
_LEFT_PX, _FOOT_PX, _TOP_PX, _KEY_PX = 48, 48, 24, 98
"""Margins: y labels, x labels with the scale bar, unit with the labels above, colour bar with its labels."""
_BESIDE_PX = 30
"""Space for labels between the picture and the colour bar."""
_MOST_HIGH_PX, _LEAST_WIDE_PX = 380.0, 450.0
_LEAST_KEY_PX = 84.0
"""Least height of the colour bar; a lower picture is drawn in the middle of it."""
_SCALE_PX, _UNIT_PX, _HATCH_PX = 110.0, 224.0, 310.0
"""Longest scale bar; left ends of the unit and of the legend beside it."""
_BADGE_PX = 8.5
_LETTER_PX, _TICK_GAP_PX = 5.8, 10.0
_STOPS = 24
"""Colours of the colour bar between which it is blended."""
_MM_FROM_UM = 10_000.0
"""Coordinate from which axes are labelled in mm."""
_MOST_LINKED = 4
"""Regions of a place up to which lines join them."""


@dataclass(frozen=True, slots=True)
class Mark:
    """A numbered place: its label and its regions, stage um."""

    label: str
    regions: Sequence[Region]


@dataclass(frozen=True, slots=True)
class MapKey:
    """Colour bar: its range in um and the name of its colours; unmeasured: text beside the hatch, none if empty."""

    low_um: float
    high_um: float
    colours: str
    unmeasured: str = ""


def marked_map_svg(
    picture_url: str,
    bounds_um: tuple[float, float, float, float],
    marks: Sequence[Mark],
    key: MapKey,
    width_px: float = 680.0,
) -> Markup:
    """Return the picture of a surface over its bounds (x low, y low, x high, y high) with everything round it.

    Axes are in um, or in mm from 10 mm on. Numbers neither cover each other nor leave the drawing; a number that is not
    beside its place has a leader line to it.
    """
    x0, y0, x1, y1 = bounds_um
    wide_um, high_um = max(x1 - x0, 1e-9), max(y1 - y0, 1e-9)
    per_um = min((width_px - _LEFT_PX - _KEY_PX) / wide_um, _MOST_HIGH_PX / high_um)
    top = _TOP_PX + max(0.0, (_LEAST_KEY_PX - per_um * high_um) / 2)
    right, foot = _LEFT_PX + per_um * wide_um, top + per_um * high_um
    per_unit, unit = (1000.0, "mm") if max(map(abs, bounds_um)) >= _MM_FROM_UM else (1.0, "µm")
    labelled = ChartAxes(
        _labelled_axis((x0 / per_unit, x1 / per_unit), (_LEFT_PX, right)),
        _labelled_axis((y0 / per_unit, y1 / per_unit), (foot, top)),
    )
    axes = ChartAxes(Axis((x0, x1), labelled.x.span), Axis((y0, y1), labelled.y.span))
    parts = [
        Markup(
            '<image href="{}" x="{:g}" y="{:.1f}" width="{:.1f}" height="{:.1f}" preserveAspectRatio="none"/>'
        ).format(picture_url, _LEFT_PX, top, right - _LEFT_PX, foot - top),
        Markup('<path d="{}" fill="none" stroke="{}"/>').format(axes.frame() + _tick_marks(labelled), EDGE),
        labelled.labels_svg(),
        Markup('<text x="{:.1f}" y="{:.1f}">x, y in {}</text>').format(_UNIT_PX, foot + 39.5, unit),
        *(_linked(axes, mark.regions) for mark in marks),
        *(_outlined(axes, mark.regions) for mark in marks),
        *_badges(axes, marks, (right + _BESIDE_PX, max(foot, _TOP_PX + _LEAST_KEY_PX))),
        _scale_bar(_LEFT_PX, foot + 36, per_um),
        _unmeasured(_HATCH_PX, foot + 36, key.unmeasured) if key.unmeasured else Markup(),
        _colour_bar(right + _BESIDE_PX, max(foot, _TOP_PX + _LEAST_KEY_PX), key),
    ]
    wide, high = max(right + _KEY_PX, _LEAST_WIDE_PX), max(foot + _FOOT_PX, _TOP_PX + _LEAST_KEY_PX + 8)
    return Markup(
        '<svg width="{0:.0f}" height="{1:.0f}" viewBox="0 0 {0:.0f} {1:.0f}" '
        'style="max-width:100%;height:auto" font-size="10" fill="{2}">{3}</svg>'
    ).format(wide, high, SECOND, Markup("").join(parts))


def _labelled_axis(ends: tuple[float, float], span: tuple[float, float]) -> Axis:
    """Return an axis with as many labels as have space beside each other, at least one."""
    axis, across = Axis(ends, span), span[1] > span[0]
    for most in range(6, 0, -1):
        found = _round_ticks(ends, most)
        taken = _LETTER_PX * max((len(text) for _, text in found), default=0) if across else _LETTER_PX
        places = [axis.at(value) for value, _ in found]
        if all(abs(b - a) >= taken + _TICK_GAP_PX for a, b in itertools.pairwise(places)):
            return Axis(ends, span, found)
    return Axis(ends, span, _round_ticks(ends, 1)[:1])


def _round_ticks(ends: tuple[float, float], most: int) -> tuple[Tick, ...]:
    """Return ticks; a single round one has no decimals."""
    found = round_ticks(ends, most)
    return tuple((value, number(value, 0)) for value, _ in found if value.is_integer()) if len(found) == 1 else found


def _tick_marks(axes: ChartAxes) -> str:
    (left, _), (foot, _) = axes.x.span, axes.y.span
    below = "".join(f"M{axes.x.at(x):.1f} {foot:.1f}v4" for x, _ in axes.x.ticks)
    return below + "".join(f"M{left:g} {axes.y.at(y):.1f}h-4" for y, _ in axes.y.ticks)


def _badges(axes: ChartAxes, marks: Sequence[Mark], high: tuple[float, float]) -> Iterator[Markup]:
    """Yield the leader lines, then the numbers of the places over them."""
    places = [LabelledPlace(_beside(axes, mark.regions), _along(axes, mark.regions)) for mark in marks]
    placed = place_labels(places, _BADGE_PX, (_LEFT_PX - 5.0, 0.0), high)
    for label in placed:
        if label.end is not None:
            yield _cased(f"M{label.x:.1f} {label.y:.1f}L{label.end[0]:.1f} {label.end[1]:.1f}", INK, PAPER, 1.1)
    for mark, label in zip(marks, placed, strict=True):
        yield Markup(
            '<circle cx="{0:.1f}" cy="{1:.1f}" r="{2}" fill="{3}" stroke="{4}" stroke-width="1.2"/>'
            '<text x="{0:.1f}" y="{5:.1f}" text-anchor="middle" font-size="{6}" font-weight="650" fill="{4}">{7}</text>'
        ).format(label.x, label.y, _BADGE_PX, INK, PAPER, label.y + 3.2, 9 if len(mark.label) < 3 else 7.5, mark.label)


def _beside(axes: ChartAxes, regions: Sequence[Region]) -> NDArray[np.float64]:
    """Return the preferred centres of the number of a place: on the corners of a large region, beside a small one."""
    found: list[tuple[float, float]] = []
    for region in regions:
        x0, y0, x1, y1 = region.bounds_um
        left, right, foot, top = axes.x.at(x0), axes.x.at(x1), axes.y.at(y0), axes.y.at(y1)
        x, y = (left + right) / 2, (foot + top) / 2
        corners = [(left, top), (right, top), (left, foot), (right, foot)]
        if region.is_path:
            corners = [(axes.x.at(p.x_um), axes.y.at(p.y_um)) for p in (region.points[0], region.points[-1])]
        elif region.kind == "circle":
            corners = [(x + (cx - x) * math.sqrt(0.5), y + (cy - y) * math.sqrt(0.5)) for cx, cy in corners]
        elif region.kind == "point":
            corners = [(x + dx, y + dy) for dy in (-_POINT_PX, _POINT_PX) for dx in (-_POINT_PX, _POINT_PX)]
        large = not region.is_path and region.kind != "point" and min(right - left, foot - top) >= 4 * _BADGE_PX
        found += corners if large else [_beyond(corner, (x, y)) for corner in corners]
    return np.array(found)


_POINT_PX = 4.0


def _beyond(corner: tuple[float, float], centre: tuple[float, float]) -> tuple[float, float]:
    """Return the centre of a label that touches a corner from outside."""
    dx, dy = corner[0] - centre[0], corner[1] - centre[1]
    share = (_BADGE_PX + 2) / max(math.hypot(dx, dy), 1e-9)
    return corner[0] + share * dx, corner[1] + share * dy


def _along(axes: ChartAxes, regions: Sequence[Region]) -> NDArray[np.float64]:
    """Return points along the outlines of a place, about a px apart."""
    found: list[NDArray[np.float64]] = []
    for region in regions:
        corners = np.array([(axes.x.at(p.x_um), axes.y.at(p.y_um)) for p in region.points])
        x0, y0, x1, y1 = region.bounds_um
        if region.kind == "circle":
            turn = np.linspace(0, 2 * np.pi, 64)
            radius = (axes.x.at(x1) - axes.x.at(x0)) / 2
            corners = corners[0] + radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        elif region.kind == "rectangle":
            corners = np.array([(axes.x.at(x), axes.y.at(y)) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))])
        if region.kind in ("rectangle", "polygon"):
            corners = np.concatenate([corners, corners[:1]])
        for a, b in itertools.pairwise(corners):
            found.append(a + np.linspace(0, 1, max(2, math.ceil(math.hypot(*(b - a)))))[:, None] * (b - a))
        if region.kind == "point":
            found.append(corners)
    return np.concatenate(found)


def _linked(axes: ChartAxes, regions: Sequence[Region]) -> Markup:
    """Return dashed lines between the regions of one place, from outline to outline."""
    if not 2 <= len(regions) <= _MOST_LINKED:
        return Markup()
    path = ""
    for one, other in itertools.pairwise(regions):
        (ax, ay), (bx, by) = map(_middle, (one, other))
        share = np.linspace(0, 1, 201)
        x_um, y_um = ax + share * (bx - ax), ay + share * (by - ay)
        free = np.flatnonzero(~(one.contains(x_um, y_um) | other.contains(x_um, y_um)))
        if len(free) > 1:
            ends = ((axes.x.at(float(x_um[k])), axes.y.at(float(y_um[k]))) for k in (free[0], free[-1]))
            path += "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in ends)
    return _cased(path, PAPER, INK, 1.2, Markup(' stroke-dasharray="4 3"')) if path else Markup()


def _middle(region: Region) -> tuple[float, float]:
    x0, y0, x1, y1 = region.bounds_um
    return (x0 + x1) / 2, (y0 + y1) / 2


def _cased(path: str, colour: str, rim: str, width: float, dashes: str = "") -> Markup:
    """Return a line with a rim, so that it stands out of any picture."""
    return Markup(
        '<path d="{0}" fill="none" stroke="{1}" stroke-width="{2:g}"/>'
        '<path d="{0}" fill="none" stroke="{3}" stroke-width="{4:g}"{5}/>'
    ).format(path, rim, width + 1.8, colour, width, dashes)


def _outlined(axes: ChartAxes, regions: Sequence[Region], colour: str = PAPER, rim: str = INK) -> Markup:
    """Return the outlines of a place, white with a dark rim so that they stand out of any picture."""
    regions = [*regions, *(hole for region in regions for hole in region.excluded)]
    outlines = " ".join(_outline(axes, region) for region in regions)
    return _cased(outlines, colour, rim, 1.6)


_PLACE_PX = 250.0


def place_svg(
    picture_url: str, bounds_um: tuple[float, float, float, float], regions: Sequence[Region], line: Region
) -> Markup:
    """Return the picture of a place over its bounds, with its regions, the line of its profile and a scale bar."""
    x0, y0, x1, y1 = bounds_um
    per_um = _PLACE_PX / max(x1 - x0, y1 - y0, 1e-9)
    wide, high = per_um * (x1 - x0), per_um * (y1 - y0)
    axes = ChartAxes(Axis((x0, x1), (0, wide)), Axis((y0, y1), (high, 0)))
    areas = [region for region in regions if region != line]
    parts = (
        Markup('<image href="{}" width="{:.1f}" height="{:.1f}" preserveAspectRatio="none"/>').format(
            picture_url, wide, high
        ),
        _outlined(axes, [line], PROFILE_COLOURS[0], PAPER),
        _outlined(axes, areas) if areas else Markup(),
        _scale_plate(high, per_um, x1 - x0),
    )
    return Markup('<svg viewBox="0 0 {:.0f} {:.0f}" width="100%" role="img" font-size="10">{}</svg>').format(
        wide, high, Markup("").join(parts)
    )


def _outline(axes: ChartAxes, region: Region) -> str:
    """Return the path of a region in the drawing."""
    if region.kind == "circle":
        (centre,) = region.points
        x, y = axes.x.at(centre.x_um), axes.y.at(centre.y_um)
        r = abs(axes.x.at(centre.x_um + region.radius_um) - x)
        return f"M{x - r:.1f} {y:.1f}a{r:.1f} {r:.1f} 0 1 0 {2 * r:.1f} 0a{r:.1f} {r:.1f} 0 1 0 {-2 * r:.1f} 0Z"
    if region.kind == "point":
        x, y = axes.x.at(region.points[0].x_um), axes.y.at(region.points[0].y_um)
        return f"M{x - 5:.1f} {y:.1f}h10M{x:.1f} {y - 5:.1f}v10"
    corners = [(p.x_um, p.y_um) for p in region.points]
    if region.kind == "rectangle":
        x0, y0, x1, y1 = region.bounds_um
        corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    path = "L".join(f"{axes.x.at(x):.1f} {axes.y.at(y):.1f}" for x, y in corners)
    return f"M{path}" + ("" if region.is_path else "Z")


def _scale_plate(foot: float, per_um: float, wide_um: float) -> Markup:
    """Return a scale bar on a plate in the lower left corner of a picture."""
    length_um = round_length(_SCALE_SHARE * wide_um)
    long_px, x, y = per_um * length_um, 12.0, foot - 12
    return Markup(
        '<rect x="{0:.1f}" y="{1:.1f}" width="{2:.1f}" height="24" rx="3" fill="{3}" fill-opacity=".9"/>'
        '<path d="M{4:.1f} {5:.1f}v4h{6:.1f}v-4" fill="none" stroke="{7}" stroke-width="1.6"/>'
        '<text x="{8:.1f}" y="{9:.1f}" text-anchor="middle" font-weight="650" fill="{7}">{10}</text>'
    ).format(x - 5, y - 17, long_px + 10, PAPER, x, y - 2, long_px, INK, x + long_px / 2, y - 6, length_text(length_um))


_SCALE_SHARE = 0.22


def _scale_bar(x: float, y: float, per_um: float) -> Markup:
    """Return a scale bar below the map, with its length at its right."""
    length_um = round_length(_SCALE_PX / per_um)
    long_px = per_um * length_um
    return Markup(
        '<path d="M{0:.1f} {1:.1f}v6m0 -3h{2:.1f}m0 -3v6" fill="none" stroke="{3}" stroke-width="1.6"/>'
        '<text x="{4:.1f}" y="{5:.1f}" font-weight="650" fill="{3}">{6}</text>'
    ).format(x, y - 3, long_px, INK, x + long_px + 6, y + 3.5, length_text(length_um))


def _unmeasured(x: float, y: float, text: str) -> Markup:
    """Return the legend of what is not measured."""
    ground, line = HATCH
    return Markup(
        '<defs><pattern id="marked-map-hatch" width="5" height="5" patternUnits="userSpaceOnUse" '
        'patternTransform="rotate(45)"><path d="M0 0v5" stroke="{0}" stroke-width="2.4"/></pattern></defs>'
        '<rect x="{1:.1f}" y="{2:.1f}" width="18" height="11" fill="{3}"/>'
        '<rect x="{1:.1f}" y="{2:.1f}" width="18" height="11" fill="url(#marked-map-hatch)" stroke="{4}"/>'
        '<text x="{5:.1f}" y="{6:.1f}">{7}</text>'
    ).format(line, x, y - 5.5, ground, EDGE, x + 24, y + 3.5, text)


def _colour_bar(x: float, foot: float, key: MapKey) -> Markup:
    top, name = float(_TOP_PX), "marked-map-colours"
    colours = table(key.colours)[np.linspace(0, 255, _STOPS).round().astype(int)].tolist()
    stops = Markup("").join(
        Markup('<stop offset="{:.4f}" stop-color="rgb({},{},{})"/>').format(k / (_STOPS - 1), *colour)
        for k, colour in enumerate(colours)
    )
    axis = Axis((key.low_um, key.high_um), (foot, top))
    labels = Markup("").join(
        Markup('<path d="M{0:.1f} {1:.1f}h4" stroke="{2}"/><text x="{3:.1f}" y="{4:.1f}">{5}</text>').format(
            x + 14, axis.at(value), EDGE, x + 21, axis.at(value) + 3.5, text
        )
        for value, text in round_ticks(axis.ends, 7 if foot - top > 2 * _LEAST_KEY_PX else 3, signed=True)
    )
    return Markup(
        '<defs><linearGradient id="{0}" x1="0" y1="1" x2="0" y2="0">{1}</linearGradient></defs>'
        '<text x="{2:.1f}" y="{3:.1f}" font-weight="650" fill="{4}">Height, µm</text>'
        '<rect x="{2:.1f}" y="{5:.1f}" width="14" height="{6:.1f}" fill="url(#{0})" stroke="{7}"/>{8}'
    ).format(name, stops, x, _TOP_PX - 8, INK, top, foot - top, EDGE, labels)
