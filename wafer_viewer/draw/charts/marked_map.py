"""Map for print: a picture of the surface with axes in um, scale bar, colour bar and numbered places, as SVG."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from wafer_viewer.draw.charts.axes import Axis, ChartAxes, round_ticks
from wafer_viewer.draw.colormaps import PROFILE_COLOURS, table
from wafer_viewer.draw.number_format import length_text, round_length
from wafer_viewer.model.region import Region

INK, SECOND, EDGE, PAPER = "#15202B", "#445463", "#8895A3", "#FFFFFF"
_LEFT_PX, _FOOT_PX, _TOP_PX, _KEY_PX = 48, 34, 14, 92
_MOST_HIGH = 0.8
"""Greatest height of the picture over its width."""
_SCALE_SHARE = 0.22
_BADGE_PX = 8.5
_STOPS = 24
"""Colours of the colour bar between which it is blended."""


@dataclass(frozen=True, slots=True)
class Mark:
    """A numbered place: its label and its regions, stage um."""

    label: str
    regions: Sequence[Region]


@dataclass(frozen=True, slots=True)
class MapKey:
    """Colour bar: its range in um and the name of its colours."""

    low_um: float
    high_um: float
    colours: str


def marked_map_svg(
    picture_url: str,
    bounds_um: tuple[float, float, float, float],
    marks: Sequence[Mark],
    key: MapKey,
    width_px: float = 700.0,
) -> Markup:
    """Return the picture of a surface over its bounds (x low, y low, x high, y high) with everything round it."""
    x0, y0, x1, y1 = bounds_um
    wide_um, high_um = max(x1 - x0, 1e-9), max(y1 - y0, 1e-9)
    per_um = min(1.0, _MOST_HIGH * wide_um / high_um) * (width_px - _LEFT_PX - _KEY_PX) / wide_um
    right, foot = _LEFT_PX + per_um * wide_um, _TOP_PX + per_um * high_um
    x_ticks, y_ticks = round_ticks((x0, x1), 6), round_ticks((y0, y1), 5)
    axes = ChartAxes(Axis((x0, x1), (_LEFT_PX, right), x_ticks), Axis((y0, y1), (foot, _TOP_PX), y_ticks))
    parts = [
        Markup('<image href="{}" x="{:g}" y="{:g}" width="{:.1f}" height="{:.1f}" preserveAspectRatio="none"/>').format(
            picture_url, _LEFT_PX, _TOP_PX, right - _LEFT_PX, foot - _TOP_PX
        ),
        Markup('<path d="{}" fill="none" stroke="{}"/>').format(axes.frame(), EDGE),
        axes.labels_svg(),
        Markup('<text x="{:.1f}" y="{:.1f}" text-anchor="end">x, y in µm</text>').format(right, foot + 29),
        *(_outlined(axes, mark.regions) for mark in marks),
        *_badges(axes, marks, right),
        _scale_bar(foot, per_um, wide_um),
        _colour_bar(right + 22, foot, key),
    ]
    return Markup(
        '<svg width="{0:.0f}" height="{1:.0f}" viewBox="0 0 {0:.0f} {1:.0f}" '
        'style="max-width:100%;height:auto" font-size="10" fill="{2}">{3}</svg>'
    ).format(right + _KEY_PX, foot + _FOOT_PX, SECOND, Markup("").join(parts))


def _badges(axes: ChartAxes, marks: Sequence[Mark], right: float) -> Iterator[Markup]:
    """Yield the numbers of the places, each at its upper left corner, or beside numbers that stand there already."""
    taken: list[tuple[float, float]] = []
    for mark in marks:
        boxes = [region.bounds_um for region in mark.regions]
        x, y = (axes.x.at(min(box[0] for box in boxes)), axes.y.at(max(box[3] for box in boxes)))
        if all(region.kind == "point" for region in mark.regions):
            x, y = x - _BADGE_PX, y - 1.2 * _BADGE_PX  # beside the cross
        x, y = _free_place(x, y, taken, right)
        taken.append((x, y))
        yield Markup(
            '<circle cx="{0:.1f}" cy="{1:.1f}" r="{2}" fill="{3}" stroke="{4}" stroke-width="1.2"/>'
            '<text x="{0:.1f}" y="{5:.1f}" text-anchor="middle" font-size="9" font-weight="650" fill="{4}">{6}</text>'
        ).format(x, y, _BADGE_PX, INK, PAPER, y + 3.2, mark.label)


def _free_place(x: float, y: float, taken: Sequence[tuple[float, float]], right: float) -> tuple[float, float]:
    """Return the first place from (x, y) to the right, then row by row above, that no badge covers."""
    step, first = 2 * _BADGE_PX + 1.5, x
    while any(math.hypot(x - other_x, y - other_y) < step - 0.1 for other_x, other_y in taken):
        x += step
        if x > right:
            x, y = first, y - step
    return x, y


def _outlined(axes: ChartAxes, regions: Sequence[Region], colour: str = PAPER, rim: str = INK) -> Markup:
    """Return the outlines of a place, white with a dark rim so that they stand out of any picture."""
    regions = [*regions, *(hole for region in regions for hole in region.excluded)]
    outlines = " ".join(_outline(axes, region) for region in regions)
    return Markup(
        '<path d="{0}" fill="none" stroke="{1}" stroke-width="3.4"/>'
        '<path d="{0}" fill="none" stroke="{2}" stroke-width="1.6"/>'
    ).format(outlines, rim, colour)


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
        _scale_bar(high, per_um, x1 - x0, left=0.0),
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
    return f"M{path}" + ("" if region.kind == "line" else "Z")


def _scale_bar(foot: float, per_um: float, wide_um: float, left: float = _LEFT_PX) -> Markup:
    length_um = round_length(_SCALE_SHARE * wide_um)
    long_px, x, y = per_um * length_um, left + 12, foot - 12
    return Markup(
        '<rect x="{0:.1f}" y="{1:.1f}" width="{2:.1f}" height="24" rx="3" fill="{3}" fill-opacity=".9"/>'
        '<path d="M{4:.1f} {5:.1f}v4h{6:.1f}v-4" fill="none" stroke="{7}" stroke-width="1.6"/>'
        '<text x="{8:.1f}" y="{9:.1f}" text-anchor="middle" font-weight="650" fill="{7}">{10}</text>'
    ).format(x - 5, y - 17, long_px + 10, PAPER, x, y - 2, long_px, INK, x + long_px / 2, y - 6, length_text(length_um))


def _colour_bar(x: float, foot: float, key: MapKey) -> Markup:
    top, name = _TOP_PX + 18, "marked-map-colours"
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
        for value, text in round_ticks(axis.ends, 7, signed=True)
    )
    return Markup(
        '<defs><linearGradient id="{0}" x1="0" y1="1" x2="0" y2="0">{1}</linearGradient></defs>'
        '<text x="{2:.1f}" y="{3:.1f}" font-weight="650" fill="{4}">Height, µm</text>'
        '<rect x="{2:.1f}" y="{5:.1f}" width="14" height="{6:.1f}" fill="url(#{0})" stroke="{7}"/>{8}'
    ).format(name, stops, x, _TOP_PX + 6, INK, top, foot - top, EDGE, labels)
