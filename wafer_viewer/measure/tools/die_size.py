"""Die size between its edges in the image, with position, rotation and squareness."""

from __future__ import annotations

from typing import Literal

from wafer_viewer.measure.base.height_samples import Layer
from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.edges.edge_search import Sign, angle, between_edges, notes, read_strip, require_rectangle
from wafer_viewer.measure.edges.straight_edges import OPPOSITE, die_edges
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import DieSize
from wafer_viewer.model.measurement.tool_options import DieOptions
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import require_choice
from wafer_viewer.model.surface.height_map import Mosaic

Die = Literal["either", "bright", "dark"]
SIGNS: dict[Die, tuple[Sign, ...]] = {"either": (1, -1), "bright": (1,), "dark": (-1,)}
"""Signs of the brightness change from outside to inside."""
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
    """Measure width, height and orientation of the die in a region.

    The four edges are detected in the all-in-focus image.

    Parameters
    ----------
    surface : Mosaic
        Height map or mosaic to measure; regions are in its stage coordinates, um.
    region : Region
        Rectangle around one die, in stage um.
    die : {'either', 'bright', 'dark'}, optional
        Brightness of the rim of the die relative to the surroundings. Default 'either'.
    calibration_valid : bool, optional
        Whether the calibration of the surface is valid. Default True. Where it is False, or the surface has no
        calibration, results have status 'uncalibrated' and no uncertainty.
    layer : {'unsmoothed', 'smoothed', 'filled'}, optional
        Height layer that the result names; edges are detected in the image. Default None: the layer on which
        the recipe of the surface measures.
    name : str, optional
        Name of the result. Default ''.

    Returns
    -------
    DieSize
        Width and height through the centre in um, and rotation and squareness in degrees, with expanded uncertainties
        (k = 2); also the centre and the outline in stage um.

    Raises
    ------
    MeasureError
        If the region is no rectangle, lies outside the surface, is smaller than 16 pixels either way, or has less than
        half of its area on the image.
    MeasureError
        If on one of its sides no edge stands out, more than one does, or fewer than half of the search lines detect it.

    Notes
    -----
    Rotation counts from the axes of the image, counter-clockwise. Squareness is the deviation from 90 degrees of the
    angle between the edges.
    """
    require_choice("die", die, Die, MeasureError)
    require_rectangle(region, "A die size")
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    strip, level = read_strip(surface, region, "a die size")
    edges = die_edges(strip, SIGNS[die])
    width, height = (
        between_edges(reading, edges.size_um(*pair), strip.pixel_um, edges.u_size_um(*pair)) for pair in OPPOSITE
    )
    u_turn, (x_um, y_um) = edges.u_angle_deg, edges.center
    return DieSize(
        **reading.result_fields(name, level, *notes(reading, TURN)),
        region=region,
        options=DieOptions(die=die),
        width=width,
        height=height,
        rotation=angle(reading, edges.rotation_deg, None if u_turn is None else u_turn.times(1 / 2)),
        squareness=angle(reading, edges.squareness_deg, u_turn),
        center=Point(x_um=x_um, y_um=y_um),
        outline=Region.polygon(*((round(x, 3), round(y, 3)) for x, y in edges.corners)),
        die="bright" if edges.left.sign > 0 else "dark",
        points=sum(len(edge.points) for edge in (edges.left, edges.right, edges.lower, edges.upper)),
    )
