"""Diameter, position and roundness of a circular edge in the image."""

from __future__ import annotations

from typing import Literal

from wafer_viewer.measure.base.height_samples import Layer
from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.edges.circular_edges import CIRCLE_SEARCH, find_circle
from wafer_viewer.measure.edges.edge_search import Sign, between_edges, notes, read_strip
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import CircleSize
from wafer_viewer.model.measurement.tool_options import CircleOptions
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.surface.height_map import Mosaic

Inside = Literal["either", "bright", "dark"]
SIGNS: dict[Inside, tuple[Sign, ...]] = {"either": (1, -1), "bright": (-1,), "dark": (1,)}
"""Signs of the brightness change from inside to outside."""
ROOM = 1.2
"""Ratio of the image area read to the drawn circle; an edge near the circle needs both its sides."""
ROUNDNESS = f"Roundness is that of medians of {CIRCLE_SEARCH.neighbours} neighbouring rays; noise makes it larger."


def circle_size(
    surface: Mosaic,
    circle: Region,
    *,
    inside: Inside = "either",
    calibration_valid: bool = True,
    layer: Layer | None = None,
    name: str = "",
) -> CircleSize:
    """Measure diameter, radius and roundness of a circular edge.

    The edge is detected in the all-in-focus image, within the drawn circle.

    Parameters
    ----------
    surface : Mosaic
        Height map or mosaic to measure; regions are in its stage coordinates, um.
    circle : Region
        Circle drawn around the edge, in stage um.
    inside : {'either', 'bright', 'dark'}, optional
        Brightness of the inside relative to the outside. Default 'either'.
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
    CircleSize
        Diameter and radius of the least-squares circle in um, with expanded uncertainties (k = 2), its centre, and the
        roundness in um, whose uncertainty is not evaluated.

    Raises
    ------
    MeasureError
        If the region is no circle, lies outside the surface or is too small, or less than half of the area searched
        lies on the image.
    MeasureError
        If no circular edge stands out, more than one does, or it is not detected all round.

    Notes
    -----
    Roundness is RONt of ISO 12181 [1]_ about the least-squares circle, of medians of five neighbouring rays. Noise
    makes it larger.

    References
    ----------
    .. [1] ISO 12181-1, Roundness - Part 1: Vocabulary and parameters of roundness.
    """
    if circle.kind != "circle":
        raise MeasureError(f"A diameter is measured in a circle, this region is a {circle.kind}: draw a circle.")
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    drawn = circle.points[0]
    room = Region.circle(drawn.x_um, drawn.y_um, ROOM * circle.radius_um + CIRCLE_SEARCH.room_px * surface.pixel_um)
    strip, level = read_strip(surface, room, "a diameter")
    edge = find_circle(strip, drawn.x_um, drawn.y_um, circle.radius_um, SIGNS[inside])
    u_um = edge.u_radius_um
    x_um, y_um, radius_um = (round(v, 4) for v in (edge.x_um, edge.y_um, edge.radius_um))
    return CircleSize(
        **reading.result_fields(name, level, *notes(reading, ROUNDNESS)),
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
