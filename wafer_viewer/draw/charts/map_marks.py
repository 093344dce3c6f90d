"""Overlay of the sample map with frequently changing marks: camera view, results and areas."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass

from wafer_viewer.draw.charts.symbols import symbol
from wafer_viewer.draw.charts.wafer_map import MapViewport, Outline

_LEAST_SEEN_PX = 5.0
"""Size of a view in px below which it is drawn as a cross."""

_LEAST_AREA_PX = 3.0


@dataclass(frozen=True, slots=True)
class MapMark:
    """Mark on the map, stage um, with the colour and shape of its symbol and its name.

    `attributes` are HTML attributes that make it clickable.
    """

    x_um: float
    y_um: float
    colour: str
    name: str
    chosen: bool = False
    attributes: str = ""
    shape: str = "disc"


@dataclass(frozen=True, slots=True)
class MarkedArea:
    """Rectangle on the map, x low, y low, x high, y high in stage um, with a colour; if dashed, it is not filled."""

    box_um: tuple[float, float, float, float]
    colour: str
    name: str
    dashed: bool = False


def map_marks_svg(
    frame: MapViewport, seen_um: Outline, marks: Sequence[MapMark], areas: Sequence[MarkedArea] = ()
) -> str:
    """Return the overlay in the size of the map; `seen_um`: corners of the area in the camera view."""
    shapes = [*(_area(frame, area) for area in areas), *_seen(frame, seen_um)]
    shapes += [*(_mark(frame, mark) for mark in sorted(marks, key=lambda mark: mark.chosen))]
    w, h = f"{frame.width_px:.0f}", f"{frame.height_px:.0f}"
    size = f'width="{w}" height="{h}" viewBox="0 0 {w} {h}"'
    return f'<svg {size} class="wv-map-marks" style="display:block">{"".join(shapes)}</svg>' if shapes else ""


def _area(frame: MapViewport, area: MarkedArea) -> str:
    x0, y0, x1, y1 = area.box_um
    left, top = frame.x(x0), frame.y(y1)
    width, height = (max(_LEAST_AREA_PX, v) for v in (frame.x(x1) - left, frame.y(y0) - top))
    look = f'fill="none" stroke="{area.colour}" stroke-width="1.8" stroke-dasharray="5 3"'
    look = look if area.dashed else f'fill="{area.colour}" fill-opacity=".75"'
    place = f'x="{left:.1f}" y="{top:.1f}" width="{width:.1f}" height="{height:.1f}"'
    return f"<rect {place} {look}><title>{html.escape(area.name, quote=True)}</title></rect>"


def _seen(frame: MapViewport, corners_um: Outline) -> list[str]:
    if len(corners_um) < 3:
        return []
    points = [(frame.x(x), frame.y(y)) for x, y in corners_um]
    xs, ys = [x for x, _ in points], [y for _, y in points]
    style = 'fill="none" stroke="var(--attention)" stroke-width="1.6" stroke-linejoin="round"'
    if max(max(xs) - min(xs), max(ys) - min(ys)) < _LEAST_SEEN_PX:
        x, y = sum(xs) / len(xs), sum(ys) / len(ys)
        return [f'<path d="M{x - 7:.1f} {y:.1f}h14M{x:.1f} {y - 7:.1f}v14" {style}/>']
    return [f'<polygon points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in points)}" {style}/>']


def _mark(frame: MapViewport, mark: MapMark) -> str:
    x, y = frame.x(mark.x_um), frame.y(mark.y_um)
    ring = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="7" fill="none" stroke="var(--ink)" stroke-width="1.6"/>'
    name = html.escape(mark.name, quote=True)
    return (
        f'<g {mark.attributes} aria-label="{name}"><title>{name}</title>{ring if mark.chosen else ""}'
        f'<g stroke="#fff" stroke-width="1.2" paint-order="stroke">{symbol(mark.shape, mark.colour, x, y, 3.6)}</g></g>'
    )
