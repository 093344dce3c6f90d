"""The diameter of something round on the picture, its place and its roundness."""

from __future__ import annotations

from typing import Literal

from wafer_viewer.measure.base.height_samples import Layer
from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.edges.circular_edges import NEIGHBOURS, ROOM_PX, find_circle
from wafer_viewer.measure.edges.edge_search import Sign
from wafer_viewer.measure.edges.lateral_uncertainty import between_edges, notes
from wafer_viewer.measure.edges.search_strip import read_strip
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.edge_and_bump_shapes import CircleSize
from wafer_viewer.model.measurement.tool_options import CircleOptions
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.surface.height_map import Mosaic

Inside = Literal["either", "bright", "dark"]
SIGNS: dict[Inside, tuple[Sign, ...]] = {"either": (1, -1), "bright": (-1,), "dark": (1,)}
"""Which way brightness goes from inside to outside."""
ROOM = 1.2
"""The picture is read so much further than the circle drawn, for an edge near to it is found by both its sides."""
ROUNDNESS = f"Roundness is that of medians of {NEIGHBOURS} neighbouring rays; noise makes it larger."


def circle_size(
    surface: Mosaic,
    circle: Region,
    *,
    inside: Inside = "either",
    calibration_valid: bool = True,
    layer: Layer | None = None,
    name: str = "",
) -> CircleSize:
    """Diameter and radius of the round edge in a circle drawn round it, with expanded uncertainties (k = 2).

    Roundness is RONt of ISO 12181 about the circle of least squares, its uncertainty not evaluated. inside: whether it
    is brighter or darker there. Raises MeasureError when the region is no circle, lies outside or is too small, or when
    no round edge, or more than one, stands out.
    """
    if circle.kind != "circle":
        raise MeasureError(f"A diameter is measured in a circle, this region is a {circle.kind}: draw a circle.")
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    drawn = circle.points[0]
    room = Region.circle(drawn.x_um, drawn.y_um, ROOM * circle.radius_um + ROOM_PX * surface.pixel_um)
    strip, level = read_strip(surface, room, "a diameter")
    edge = find_circle(strip, drawn.x_um, drawn.y_um, circle.radius_um, SIGNS[inside])
    u_um = edge.u_radius_um
    x_um, y_um, radius_um = (round(v, 4) for v in (edge.x_um, edge.y_um, edge.radius_um))
    return CircleSize(
        **reading.told(name, level, *notes(reading, ROUNDNESS)),
        circle=circle,
        options=CircleOptions(inside=inside),
        diameter=between_edges(reading, 2 * edge.radius_um, strip.pixel_um, None if u_um is None else 2 * u_um),
        radius=between_edges(reading, edge.radius_um, strip.pixel_um, u_um, 1),
        roundness=reading.length(edge.roundness_um, None),
        center=Point(x_um=x_um, y_um=y_um),
        found=Region.circle(x_um, y_um, radius_um),
        inside="bright" if edge.sign < 0 else "dark",
        points=len(edge.angle),
    )
