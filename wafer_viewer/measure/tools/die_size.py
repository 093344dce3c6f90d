"""The size of a die between its edges on the picture, its place, how it is turned and how square it is."""

from __future__ import annotations

from typing import Literal

from wafer_viewer.measure.base.height_samples import Layer
from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.edges.edge_search import Sign
from wafer_viewer.measure.edges.lateral_uncertainty import angle, between_edges, notes
from wafer_viewer.measure.edges.rectangle_edges import OPPOSITE, die_edges
from wafer_viewer.measure.edges.search_strip import read_strip, require_rectangle
from wafer_viewer.model.measurement.edge_and_bump_shapes import DieSize
from wafer_viewer.model.measurement.tool_options import DieOptions
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.surface.height_map import Mosaic

Die = Literal["either", "bright", "dark"]
SIGNS: dict[Die, tuple[Sign, ...]] = {"either": (1, -1), "bright": (1,), "dark": (-1,)}
"""Which way brightness goes from outside to inside."""
TURN = "Rotation counts from the axes of the picture."


def die_size(
    surface: Mosaic,
    region: Region,
    *,
    die: Die = "either",
    calibration_valid: bool = True,
    layer: Layer | None = None,
    name: str = "",
) -> DieSize:
    """Width and height of the die that a region lies round, with expanded uncertainties (k = 2), and how it lies.

    die: whether its rim is brighter or darker than what is round it. Raises MeasureError when the region is no
    rectangle, lies outside or is too small, or when on one of its sides no edge, or more than one, stands out.
    """
    require_rectangle(region, "A die size")
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    strip, level = read_strip(surface, region, "a die size")
    edges = die_edges(strip, SIGNS[die])
    width, height = (
        between_edges(reading, edges.size_um(*pair), strip.pixel_um, edges.u_size_um(*pair)) for pair in OPPOSITE
    )
    u_turn, (x_um, y_um) = edges.u_angle_deg, edges.center
    return DieSize(
        **reading.told(name, level, *notes(reading, TURN)),
        region=region,
        options=DieOptions(die=die),
        width=width,
        height=height,
        rotation=angle(reading, edges.rotation_deg, None if u_turn is None else u_turn / 2),
        squareness=angle(reading, edges.squareness_deg, u_turn),
        center=Point(x_um=x_um, y_um=y_um),
        outline=Region.polygon(*((round(x, 3), round(y, 3)) for x, y in edges.corners)),
        die="bright" if edges.left.sign > 0 else "dark",
        points=sum(len(edge.points) for edge in (edges.left, edges.right, edges.lower, edges.upper)),
    )
