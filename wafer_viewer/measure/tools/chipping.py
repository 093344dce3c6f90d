"""Chipping of a die edge in the image: depth, length and area relative to the straight edge line."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from wafer_viewer.measure.base.correlated_errors import Scatter
from wafer_viewer.measure.base.height_samples import Floats, Layer, points_in
from wafer_viewer.measure.base.measurement_context import PIXEL_SCALE, Lines, MeasurementContext
from wafer_viewer.measure.base.robust_fit import EdgeLine
from wafer_viewer.measure.edges.edge_search import (
    EdgePoints,
    SearchStrip,
    between_edges,
    edges_near,
    notes,
    read_strip,
    require_rectangle,
    responses,
)
from wafer_viewer.measure.edges.straight_edges import (
    REACH_PX,
    Found,
    expected_on,
    find_edge_in_any_direction,
    require_found,
)
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import Chip, Chipping, Side
from wafer_viewer.model.measurement.tool_options import ChippingOptions
from wafer_viewer.model.quantity import Quantity
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import require_choice
from wafer_viewer.model.surface.height_map import Mosaic
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA

NEIGHBOURS = 3
"""Number of neighbouring search lines of the median filter for depths."""
U_OF_MEDIAN = 0.67
"""Ratio of the standard deviation of the median of three to that of one."""
BEYOND = 4.0
"""Default depth limit of a chip, in robust deviations of the edge."""
LEAST_PX = 2.0
"""Smallest default depth limit of a chip, px."""
FOOT = 0.25
"""Depth that bounds the length of a chip, relative to the limit."""
LEAST_POINTS = 50
"""Smallest number of measured heights on each side, to locate the die."""
AS_HIGH_UM = 1.0
"""Smallest height difference of the sides, to locate the die, um."""
DieOn = Literal["auto", "bright", "dark"]


@dataclass(frozen=True, slots=True, eq=False)
class Depths:
    """Depth of the edge behind its line on each search line, [n], with positions in stage um."""

    along_um: Floats
    depth_um: Floats
    x_um: Floats
    y_um: Floats
    spacing_um: float

    @property
    def noise_um(self) -> float:
        """Standard deviation of the depth on one search line, from differences between neighbours."""
        steps = np.diff(self.depth_um)
        return MAD_TO_SIGMA * float(np.median(np.abs(steps - np.median(steps)))) / math.sqrt(2)

    @property
    def spread_um(self) -> float:
        """Robust standard deviation of the edge about its line, chips included."""
        return MAD_TO_SIGMA * float(np.median(np.abs(self.depth_um)))

    def chips(self, limit_um: float) -> tuple[Chip, ...]:
        """Return the chips deeper than a limit, the deepest first."""
        smooth = np.asarray(median_filter(self.depth_um, NEIGHBOURS, mode="nearest"))
        found = [self._chip(run, smooth) for run in _runs(smooth > FOOT * limit_um) if smooth[run].max() > limit_um]
        return tuple(sorted(found, key=lambda chip: -chip.depth_um))

    @property
    def deepest_um(self) -> float:
        """Largest depth; 0 where the edge is nowhere behind its line."""
        return max(0.0, float(median_filter(self.depth_um, NEIGHBOURS, mode="nearest").max()))

    def _chip(self, run: slice, smooth: Floats) -> Chip:
        deepest = run.start + int(np.argmax(smooth[run]))
        return Chip(
            place=Point(x_um=round(float(self.x_um[deepest]), 3), y_um=round(float(self.y_um[deepest]), 3)),
            depth_um=float(smooth[deepest]),
            length_um=float(np.ptp(self.along_um[run])) + self.spacing_um,
            area_um2=max(0.0, float(np.trapezoid(self.depth_um[run], self.along_um[run]))),
        )


def chipping(
    surface: Mosaic,
    region: Region,
    *,
    limit_um: float | None = None,
    die: DieOn = "auto",
    calibration_valid: bool = True,
    layer: Layer | None = None,
    name: str = "",
) -> Chipping:
    """Measure depth, length and area of the chips along a die edge.

    The edge is detected in the all-in-focus image. Depths count from the straight line through it.

    Parameters
    ----------
    surface : Mosaic
        Height map or mosaic to measure; regions are in its stage coordinates, um.
    region : Region
        Rectangle over one straight edge of a die, in stage um.
    limit_um : float, optional
        Depth in um above which a deviation of the edge is a chip. Default None: four robust standard deviations of the
        edge, at least two pixels.
    die : {'auto', 'bright', 'dark'}, optional
        Side of the edge on which the die lies: the higher, the brighter or the darker one. Default 'auto', the higher
        side.
    calibration_valid : bool, optional
        Whether the calibration of the surface is valid. Default True. Where it is False, or the surface has no
        calibration, results have status 'uncalibrated' and no uncertainty.
    layer : {'unsmoothed', 'smoothed', 'filled'}, optional
        Height layer that locates the die where `die` is 'auto'. Default None: the layer on which the recipe of the
        surface measures.
    name : str, optional
        Name of the result. Default ''.

    Returns
    -------
    Chipping
        Largest depth and longest chip in um, area of the chips in um2, and the chips, the deepest first. The depth and
        the area have an expanded uncertainty (k = 2); the uncertainty of the length is not evaluated.

    Raises
    ------
    MeasureError
        If the region is no rectangle, lies outside the surface, is smaller than 16 pixels either way, or has less than
        half of its area on the image.
    MeasureError
        If no edge stands out, more than one does, or fewer than half of the search lines detect it.
    MeasureError
        If `die` is 'auto' and the heights do not decide it: fewer than 50 measured heights on one side of the edge, or
        a height difference of less than 1 um.
    MeasureError
        If `limit_um` is not positive.

    Notes
    -----
    Depths are medians of three neighbouring search lines. The largest depth counts whether or not it belongs to a chip.
    The length of a chip is that over which it is deeper than a quarter of the limit.
    """
    require_choice("die", die, DieOn, MeasureError)
    require_rectangle(region, "Chipping")
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    strip, level = read_strip(surface, region, "chipping")
    strip, edge = find_edge_in_any_direction(strip)
    if die == "auto":
        inwards = _higher_behind(reading, region, level, strip, edge)
    else:
        inwards = (die == "bright") == (edge.sign > 0)
    depths = edge_depths(strip, edge, inwards)
    limit = limit_um or max(BEYOND * depths.spread_um, LEAST_PX * strip.pixel_um)
    chips = depths.chips(limit)
    u_um, noise_um = edge.line.u_um(), depths.noise_um
    u_deep = None if u_um is None else Scatter.joined(u_um, U_OF_MEDIAN * noise_um)
    length_um = float(np.ptp(edge.line.along_um))
    return Chipping(
        **reading.result_fields(name, level, *notes(reading)),
        region=region,
        options=ChippingOptions(limit_um=limit_um, die=die),
        deepest=between_edges(reading, depths.deepest_um, strip.pixel_um, u_deep),
        longest=between_edges(reading, max((chip.length_um for chip in chips), default=0.0), strip.pixel_um, None),
        area=_area(reading, chips, u_um, noise_um, strip.pixel_um),
        n_chips=len(chips),
        chips=chips,
        limit_um=limit,
        edge_length_um=length_um,
        chipped_fraction=min(1.0, sum(chip.length_um for chip in chips) / length_um),
        edge=edge.line.region,
        die=_side(strip, inwards),
        points=len(edge.points),
    )


def edge_depths(strip: SearchStrip, edge: Found, inwards: bool) -> Depths:
    """Return the deviation of a die edge from its line, from end to end.

    inwards: True if the die is in the direction of the search lines. On each line the nearest sufficiently steep edge
    point counts, however far inside it lies. Raises MeasureError when too few lines detect one.
    """
    rising = edge.sign * responses(strip.grey, strip.covered)
    far, near = float(strip.grey.shape[1]), REACH_PX
    found = edges_near(rising, expected_on(strip, edge.line), (near, far) if inwards else (far, near), "nearest")
    require_found(found, len(rising))
    return _depths(strip, found, edge.line, inwards)


def _depths(strip: SearchStrip, found: EdgePoints, line: EdgeLine, inwards: bool) -> Depths:
    x_um, y_um = strip.at(found.line, found.place)
    off, along = np.asarray(line.off(x_um, y_um)), np.asarray(line.along(x_um, y_um))
    return Depths(along, _behind(strip, line, inwards) * off, x_um, y_um, strip.pixel_um)


def _behind(strip: SearchStrip, line: EdgeLine, inwards: bool) -> float:
    """Return 1 if the die is to the left of the line, else -1."""
    sign = 1 if inwards else -1
    off = float(line.off(line.x_um + sign * strip.place_um[0], line.y_um + sign * strip.place_um[1]))
    return math.copysign(1.0, off)


def _higher_behind(reading: MeasurementContext, region: Region, level: int, strip: SearchStrip, edge: Found) -> bool:
    """Return whether the surface is higher in the direction of the search lines.

    Raises
    ------
    MeasureError
        If the heights do not decide it.
    """
    points = points_in(reading.surface, region, reading.layer, level)
    off = _behind(strip, edge.line, True) * np.asarray(edge.line.off(points.x_um, points.y_um))
    sides = [points.z_um[side] for side in (off > 0, off < 0)]
    if min(len(side) for side in sides) < LEAST_POINTS:
        raise MeasureError(
            f"One side of the edge has fewer than {LEAST_POINTS} measured heights, which do not tell where the die is: "
            "say whether it is on the bright or the dark side."
        )
    behind, before = (float(np.median(side)) for side in sides)
    if abs(behind - before) < AS_HIGH_UM:
        raise MeasureError(
            f"Both sides of the edge are as high within {AS_HIGH_UM:g} um, so heights do not tell where the die is: "
            "say whether it is on the bright or the dark side."
        )
    return behind > before


def _side(strip: SearchStrip, inwards: bool) -> Side:
    x, y = (sign if inwards else -sign for sign in strip.place_um)
    if abs(x) > abs(y):
        return "right" if x > 0 else "left"
    return "upper" if y > 0 else "lower"


def _area(
    reading: MeasurementContext, chips: tuple[Chip, ...], u_um: Scatter | None, noise_um: float, pixel_um: float
) -> Quantity:
    area_um2, length_um = sum(chip.area_um2 for chip in chips), sum(chip.length_um for chip in chips)
    if u_um is None:
        return reading.quantity(area_um2, "um2", None)
    lines: Lines = {
        PIXEL_SCALE: 2 * reading.u_pixel_scale * area_um2,
        "scatter of the edge points": Scatter.joined(u_um.times(length_um), noise_um * math.sqrt(length_um * pixel_um)),
    }
    return reading.quantity(area_um2, "um2", lines)


def _runs(mask: NDArray[np.bool_]) -> list[slice]:
    """Return the runs of a mask in order."""
    steps = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [slice(int(a), int(b)) for a, b in zip(steps[::2], steps[1::2], strict=True)]
