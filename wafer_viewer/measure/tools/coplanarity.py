"""Coplanarity of the bump tops of a die (JESD22-B108), and bump heights."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import linprog

from wafer_viewer.measure.base.height_samples import Floats, Layer, height_window, level_for, require_area
from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.edges.lateral_uncertainty import root_sum_of_squares
from wafer_viewer.measure.tools.bumps import Bumps, Top, find_bumps
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.edge_and_bump_shapes import Bump, Coplanarity
from wafer_viewer.model.measurement.tool_options import CoplanarityOptions
from wafer_viewer.model.quantity import Length
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.surface.height_map import Mosaic

LEAST_BUMPS = 4
"""Smallest number of bumps; three tops always lie in one plane."""
Reference = Literal["least_squares", "seating"]
DEFINITIONS: dict[Reference, str] = {
    "least_squares": "Coplanarity: from the lowest to the highest top over the least-squares plane of all tops.",
    "seating": (
        "Coplanarity: the largest distance of a top from the plane through the three on which the part would stand, "
        "its centre of gravity taken in the middle of the bumps."
    ),
}
EXTREMES = "Noise draws the extremes apart: the true value is rather smaller."


@dataclass(frozen=True, slots=True, eq=False)
class FittedBump:
    """Reference plane of the tops: slopes along x and y, and normal deviation of each top."""

    slope_x: float
    slope_y: float
    deviation_um: Floats

    @property
    def tilt_mrad(self) -> float:
        """Tilt of the plane."""
        return 1e3 * math.hypot(self.slope_x, self.slope_y)

    @property
    def extremes(self) -> tuple[int, int]:
        """Indices of the lowest and the highest top."""
        return int(np.argmin(self.deviation_um)), int(np.argmax(self.deviation_um))

    @property
    def range_um(self) -> float:
        """Range from the lowest to the highest top; the highest ones lie on the seating plane."""
        return float(np.ptp(self.deviation_um))


def coplanarity(
    surface: Mosaic,
    region: Region,
    *,
    reference: Reference = "least_squares",
    calibration_valid: bool = True,
    layer: Layer | None = None,
    name: str = "",
) -> Coplanarity:
    """Measure the coplanarity of the bump tops in a region.

    Parameters
    ----------
    surface : Mosaic
        Height map or mosaic to measure; regions are in its stage coordinates, um.
    region : Region
        Rectangle, circle or polygon over the bumps, in stage um.
    reference : {'least_squares', 'seating'}, optional
        Reference plane: the least-squares plane through all tops, or the seating plane. Default 'least_squares'.
    calibration_valid : bool, optional
        Whether the calibration of the surface is valid. Default True. Where it is False, or the surface has no
        calibration, results have status 'uncalibrated' and no uncertainty.
    layer : {'unsmoothed', 'smoothed', 'filled'}, optional
        Height layer. Default None: the layer on which the recipe of the surface measures.
    name : str, optional
        Name of the result. Default ''.

    Returns
    -------
    Coplanarity
        Coplanarity and mean bump height in um with expanded uncertainties (k = 2), range of the bump heights in um
        without uncertainty, tilt of the reference plane in mrad, and every bump, the largest deviation first.

    Raises
    ------
    MeasureError
        If the region is a line or a point, or lies outside the surface.
    MeasureError
        If nothing is measured in the region, or no bump stands out of the ground.
    MeasureError
        If fewer than four bumps are complete and measured; three tops always lie in one plane.

    Notes
    -----
    With 'least_squares', coplanarity is the distance from the lowest to the highest top, normal to the plane. With
    'seating', it is the largest distance of a top from the plane through the three tops on which the part would stand;
    its centre of gravity is taken in the middle of the bumps. The definitions follow JESD22-B108 [1]_.

    Bump heights count from the surroundings of each bump. Bumps cut by the region, or with unmeasured tops, are only
    counted. Noise draws the extremes apart, so that the true coplanarity is rather smaller.

    References
    ----------
    .. [1] JEDEC JESD22-B108, Coplanarity Test for Surface-Mount Semiconductor Devices.
    """
    require_area(region, "measured")
    reading, level = MeasurementContext.of(surface, layer, calibration_valid), level_for(surface, region)
    part = height_window(surface, reading.layer, region, level)
    bumps = find_bumps(part, region.contains(part.x_um[None, :], part.y_um[:, None]))
    _require_enough(bumps)
    fitted = PLANES[reference](bumps.tops)
    listed = tuple(_bump(reading, top, off) for top, off in zip(bumps.tops, fitted.deviation_um.tolist(), strict=True))
    heights = sorted((bump.height for bump in listed), key=lambda height: height.value_um)
    return Coplanarity(
        **reading.told(name, level, DEFINITIONS[reference], EXTREMES, *reading.not_in_budget()),
        region=region,
        options=CoplanarityOptions(reference=reference),
        coplanarity=_coplanarity(reading, bumps.tops, fitted),
        mean_height=_mean_height(reading, bumps.tops),
        height_range=reading.length(heights[-1].value_um - heights[0].value_um, None),
        n_bumps=len(listed),
        left_out=bumps.left_out,
        tilt_mrad=fitted.tilt_mrad,
        bumps=tuple(sorted(listed, key=lambda bump: -abs(bump.deviation.value_um))),
    )


def _require_enough(bumps: Bumps) -> None:
    if len(bumps.tops) < LEAST_BUMPS:
        more = f", {bumps.left_out} more are cut or not measured" if bumps.left_out else ""
        raise MeasureError(
            f"Coplanarity needs {LEAST_BUMPS} whole, measured bumps and the region has {len(bumps.tops)}{more}: "
            "draw it larger."
        )


def least_squares(tops: tuple[Top, ...]) -> FittedBump:
    """Return the deviations from the least-squares plane through all tops."""
    places, z_um = _places(tops)
    design = np.column_stack([places, np.ones(len(tops))])
    slope_x, slope_y, zero = np.linalg.lstsq(design, z_um, rcond=None)[0].tolist()
    return _over(places, z_um, slope_x, slope_y, zero)


def seating(tops: tuple[Top, ...]) -> FittedBump:
    """Return the deviations from the plane above all tops that is lowest at the centre of the bumps.

    The optimum of the linear programme touches three tops around the centre.
    """
    places, z_um = _places(tops)
    scale = float(np.abs(places).max()) or 1.0
    design = np.column_stack([places / scale, np.ones(len(tops))])
    found = linprog([0.0, 0.0, 1.0], A_ub=-design, b_ub=-(z_um - z_um.mean()), bounds=(None, None))
    slope_x, slope_y, zero = (found.x / [scale, scale, 1.0]).tolist()
    return _over(places, z_um, slope_x, slope_y, zero + float(z_um.mean()))


PLANES: dict[Reference, Callable[[tuple[Top, ...]], FittedBump]] = {"least_squares": least_squares, "seating": seating}


def _places(tops: tuple[Top, ...]) -> tuple[Floats, Floats]:
    """Return the positions relative to their mean, [n, 2], and the heights."""
    places = np.array([(top.x_um, top.y_um) for top in tops])
    return places - places.mean(axis=0), np.array([top.z_um for top in tops])


def _over(places: Floats, z_um: Floats, slope_x: float, slope_y: float, zero: float) -> FittedBump:
    left = z_um - places @ np.array([slope_x, slope_y]) - zero
    return FittedBump(slope_x, slope_y, left / math.sqrt(1 + slope_x**2 + slope_y**2))


def _coplanarity(reading: MeasurementContext, tops: tuple[Top, ...], fitted: FittedBump) -> Length:
    low, high = (tops[k] for k in fitted.extremes)
    return _length(reading, fitted.range_um, root_sum_of_squares(low.u_um, high.u_um))


def _mean_height(reading: MeasurementContext, tops: tuple[Top, ...]) -> Length:
    """Return the mean bump height; errors of bumps are independent, so its uncertainty falls with their number."""
    whole = root_sum_of_squares(*(root_sum_of_squares(top.u_um, top.u_round_um) for top in tops))
    mean_um = float(np.mean([top.height_um for top in tops]))
    return _length(reading, mean_um, None if whole is None else whole / len(tops))


def _bump(reading: MeasurementContext, top: Top, deviation_um: float) -> Bump:
    return Bump(
        place=Point(x_um=round(top.x_um, 2), y_um=round(top.y_um, 2)),
        height=_length(reading, top.height_um, root_sum_of_squares(top.u_um, top.u_round_um)),
        diameter_um=top.diameter_um,
        deviation=_length(reading, deviation_um, top.u_um),
    )


def _length(reading: MeasurementContext, value_um: float, noise_um: float | None) -> Length:
    if noise_um is None:
        return reading.length(value_um, None)
    lines = {
        "z scale": reading.u_z_scale * abs(value_um),
        "noise and form of the tops": noise_um,
        "interpolation between frames": reading.u_interpolation_um,
    }
    return reading.length(value_um, lines)
