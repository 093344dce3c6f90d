"""Coplanarity of the bump tops of a die (JESD22-B108), and the detection of the bumps."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, binary_fill_holes, find_objects, label
from scipy.optimize import linprog

from wafer_viewer.measure.base.correlated_errors import Scatter
from wafer_viewer.measure.base.error_covariance import UNRESOLVED_NOTE, ErrorCovariance, WeightedHeights
from wafer_viewer.measure.base.height_samples import (
    Floats,
    HeightSamples,
    Layer,
    height_window,
    level_for,
    require_area,
)
from wafer_viewer.measure.base.measurement_context import WINDOW, Lines, MeasurementContext
from wafer_viewer.measure.base.robust_fit import LevelPlane, fit_cap, fit_plane, plane_design, robust_fit
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import Bump, Coplanarity
from wafer_viewer.model.measurement.tool_options import CoplanarityOptions
from wafer_viewer.model.quantity import Length
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import require_choice
from wafer_viewer.model.surface.height_map import Heights, Mosaic


@dataclass(frozen=True, slots=True)
class BumpSearchParameters:
    """Limits of the search for bumps and of their tops.

    Parameters
    ----------
    stands_out : float
        Smallest prominence of a bump over the ground, in deviations of the ground.
    half_level : float
        Fraction of a bump's height for its width.
    cap_from : float
        Fraction of a bump's height above which its top is fitted.
    alike : float
        Largest ratio of a bump's area to the typical area, either way.
    least_px : int, px
        Smallest number of pixels of a bump above half of its height.
    least_measured : float
        Smallest measured fraction of a bump's outline for a top height.
    ring : tuple[float, float]
        Smallest inner and outer radius of the surroundings, in radii of the bump.
    foot : float
        Largest radius of a bump's foot, in radii of the bump: a paraboloid's foot is 1.41 times as wide.
    ring_width : float
        Smallest width of the surroundings, in radii of the bump.
    least_round : int
        Smallest number of measured points of the surroundings, and of the ground.
    least_top_points : int
        Smallest number of measured points of a top.
    most_rounds : int
        Largest number of rounds of rejection of prominent points from the ground.
    ground_sigmas : float
        Height over the ground, in deviations of the lower points, beyond which a point is rejected.
    ground_points : int
        Approximate number of points to which the ground is fitted.
    highest : float
        Quantile of a bump's heights that is taken as its height.
    ring_below : float
        Largest height of the surroundings over the ground, relative to the highest point in them.
    foot_px : int, px
        Margin of bumps within which the ground does not tell its errors.

    Notes
    -----
    `tests/bench/bench_shape.py` measures the errors of bumps, and the coverage of their uncertainties, with these
    values.
    """

    stands_out: float = 6.0
    half_level: float = 0.5
    cap_from: float = 0.7
    alike: float = 4.0
    least_px: int = 12
    least_measured: float = 0.5
    ring: tuple[float, float] = (1.3, 2.2)
    foot: float = 1.6
    ring_width: float = 0.6
    least_round: int = 20
    least_top_points: int = 12
    most_rounds: int = 12
    ground_sigmas: float = 2
    ground_points: int = 200_000
    highest: float = 0.98
    ring_below: float = 0.25
    foot_px: int = 3


BUMP_SEARCH = BumpSearchParameters()
Mask = NDArray[np.bool_]
Box = tuple[slice, slice]


@dataclass(frozen=True, slots=True, eq=False)
class Top:
    """One bump: position and height of its top, height over its surroundings, and diameter at half of that.

    top, ground: the top and the height of the surroundings under it as weighted sums of heights; errors: covariance of
    the errors of the heights on the top and around.
    """

    x_um: float
    y_um: float
    z_um: float
    height_um: float
    diameter_um: float
    curvature: float
    top: WeightedHeights
    ground: WeightedHeights
    errors: ErrorCovariance

    @property
    def over_ground(self) -> WeightedHeights:
        """Height over the surroundings as a weighted sum of heights."""
        return WeightedHeights.joined((self.top, self.ground.times(-1.0)))


@dataclass(frozen=True, slots=True, eq=False)
class Bumps:
    """The bumps of a part of a surface, and the number omitted: cut by the border, or with an unmeasured top."""

    tops: tuple[Top, ...]
    left_out: int


def find_bumps(part: Heights, within: Mask, window_reach_px: int = 0) -> Bumps:
    """Find the bumps within a part of a surface, from top to bottom.

    Bumps are assumed alike: objects of less than half or more than twice the typical width are not bumps. within: mask
    bool [row, col] of the searched pixels; window_reach_px: how far beyond the foot of a bump the focus window still
    sees it, px. Raises MeasureError when nothing stands out of the ground.
    """
    z_um = np.where(within, part.z_um, np.nan).astype(np.float64)
    over, noise_um = _over_ground(part, z_um)
    errors = _ground_errors(part, over)
    numbers, boxes = _outlines(over, noise_um)
    outlines = [numbers[box] == number for number, box in enumerate(boxes, 1)]
    usual_px = _usual([(float(outline.sum()), int(outline.sum())) for outline in outlines])
    found, left_out = list[Top](), 0
    for box, outline in zip(boxes, outlines, strict=True):
        if max(usual_px / BUMP_SEARCH.alike, BUMP_SEARCH.least_px) <= outline.sum() <= BUMP_SEARCH.alike * usual_px:
            complete = _complete_bumps(outline, box, within, z_um)
            top = _top(part, z_um, over, box, outline, errors, window_reach_px) if complete else None
            found, left_out = (found, left_out + 1) if top is None else ([*found, top], left_out)
    return Bumps(tuple(found), left_out)


def _over_ground(part: Heights, z_um: Floats) -> tuple[Floats, float]:
    """Return the heights over the ground plane, and the scatter of the ground about it.

    Prominent points are rejected iteratively, so that the plane converges to the lowest level.

    Raises
    ------
    MeasureError
        If too few points are measured.
    """
    rows, cols = np.nonzero(np.isfinite(z_um))
    points = HeightSamples(part.x_um[cols], part.y_um[rows], z_um[rows, cols])
    if len(points) < BUMP_SEARCH.least_round:
        raise MeasureError("Nothing is measured in the region: move it to where the surface has heights.")
    every = max(1, len(points) // BUMP_SEARCH.ground_points)
    some = points.select(np.arange(len(points)) % every == 0)
    plane, noise_um = _ground(some)
    return z_um - np.asarray(plane.at(part.x_um[None, :], part.y_um[:, None])), noise_um


def _ground(points: HeightSamples) -> tuple[LevelPlane, float]:
    center = float(points.x_um.mean()), float(points.y_um.mean())
    design = plane_design(points, center)
    inliers, below = np.ones(len(points), bool), 0.0
    slope_x = slope_y = z_um = 0.0
    for _ in range(BUMP_SEARCH.most_rounds):
        slope_x, slope_y, z_um = robust_fit(design[inliers], points.z_um[inliers]).coefficients.tolist()
        left = points.z_um - design @ np.array([slope_x, slope_y, z_um])
        below = float(np.sqrt(np.mean(left[left < 0] ** 2))) if (left < 0).any() else 0.0
        lower = left <= BUMP_SEARCH.ground_sigmas * max(below, 1e-9)
        if np.array_equal(lower, inliers) or np.count_nonzero(lower) < BUMP_SEARCH.least_round:
            break
        inliers = lower
    return LevelPlane(*center, z_um, slope_x, slope_y), below


def _ground_errors(part: Heights, over: Floats) -> ErrorCovariance:
    """Return the covariance of the errors of the ground between the bumps; over: heights over its plane."""
    highest_um = float(np.nanquantile(over, BUMP_SEARCH.highest))
    low = np.isfinite(over) & (over < BUMP_SEARCH.ring_below * highest_um)
    raised: Mask = np.asarray(binary_dilation(np.isfinite(over) & ~low, iterations=BUMP_SEARCH.foot_px), np.bool_)
    bare = low & ~raised
    rows, cols = np.nonzero(bare if np.count_nonzero(bare) >= BUMP_SEARCH.least_round else low)
    points = HeightSamples(part.x_um[cols], part.y_um[rows], over[rows, cols])
    plane, fit = fit_plane(points)
    used = points.select(fit.inliers)
    return ErrorCovariance.of(used, used.z_um - np.asarray(plane.at(used.x_um, used.y_um)), part.pixel_um, 3)


def _outlines(over: Floats, noise_um: float) -> tuple[NDArray[np.int32], list[Box]]:
    """Return labels [row, col] of objects above half of the typical height, and their bounding boxes."""
    numbers, boxes = _labelled(over > BUMP_SEARCH.stands_out * max(noise_um, 1e-6))
    inside = [over[box][numbers[box] == k] for k, box in enumerate(boxes, 1)]
    tops = [(float(np.nanmax(heights)), len(heights)) for heights in inside if len(heights) >= BUMP_SEARCH.least_px]
    if not tops:
        raise MeasureError(
            f"No bump stands out of the ground by {BUMP_SEARCH.stands_out:g} of its deviations "
            f"({BUMP_SEARCH.stands_out * noise_um:.2f} um): draw the region over bumps that are measured."
        )
    return _labelled(over > max(BUMP_SEARCH.half_level * _usual(tops), BUMP_SEARCH.stands_out * noise_um))


def _usual(values: list[tuple[float, int]]) -> float:
    """Return the median of values weighted by their number of pixels, so that specks do not count."""
    ordered = sorted(values)
    weights = np.cumsum([weight for _, weight in ordered])
    return ordered[int(np.searchsorted(weights, weights[-1] / 2))][0]


def _labelled(mask: Mask) -> tuple[NDArray[np.int32], list[Box]]:
    numbers = np.zeros(mask.shape, np.int32)
    label(binary_fill_holes(mask), output=numbers)
    return numbers, find_objects(numbers)


def _complete_bumps(outline: Mask, box: Box, within: Mask, z_um: Floats) -> bool:
    """Return whether a bump lies completely within the searched area, and enough of it is measured."""
    rows, cols = (slice(max(0, side.start - 1), side.stop + 1) for side in box)
    touches_border = (
        box[0].start == 0 or box[1].start == 0 or box[0].stop == len(within) or box[1].stop == within.shape[1]
    )
    measured = np.isfinite(z_um[box])[outline].mean()
    return not touches_border and bool(within[rows, cols].all()) and measured >= BUMP_SEARCH.least_measured


def _top(
    part: Heights,
    z_um: Floats,
    over: Floats,
    box: Box,
    outline: Mask,
    errors: ErrorCovariance,
    window_reach_px: int,
) -> Top | None:
    """Return the top from a sphere fit; None where none fits."""
    highest = float(np.nanquantile(over[box][outline], BUMP_SEARCH.highest))
    points = _points(part, z_um, box, outline & (over[box] >= BUMP_SEARCH.cap_from * highest))
    if len(points) < BUMP_SEARCH.least_top_points:
        return None
    try:
        cap, inliers = fit_cap(points)
    except MeasureError:
        return None
    radius_um = math.sqrt(np.count_nonzero(outline) / math.pi) * part.pixel_um
    if math.hypot(cap.x_um - points.x_um.mean(), cap.y_um - points.y_um.mean()) > radius_um:
        return None
    foot_um = _foot_um(cap.curvature, highest, radius_um) + window_reach_px * part.pixel_um
    ground = _round(part, z_um, over, (cap.x_um, cap.y_um), _ring_um(radius_um, foot_um))
    if ground is None:
        return None
    slopes, left_um = cap.slopes(inliers), inliers.z_um - cap.at(inliers)
    top = WeightedHeights.of_fit(inliers, slopes, np.array([0.0, 0.0, 1.0, 0.0]))
    own = errors.covering(inliers, slopes, left_um)
    return Top(cap.x_um, cap.y_um, cap.z_um, cap.z_um - ground[0], 2 * radius_um, cap.curvature, top, ground[1], own)


def _foot_um(curvature: float, height_um: float, radius_um: float) -> float:
    """Return the radius at which a cap of a height meets the ground; radius_um: of the bump at half of its height."""
    if curvature * height_um >= 1:
        return 1 / curvature
    widest_um = BUMP_SEARCH.foot * radius_um
    return widest_um if curvature <= 0 else min(widest_um, math.sqrt((2 / curvature - height_um) * height_um))


def _ring_um(radius_um: float, foot_um: float) -> tuple[float, float]:
    """Return the inner and outer radius of the surroundings of a bump, beyond what its foot reaches."""
    inner, outer = (radius_um * part for part in BUMP_SEARCH.ring)
    inner = max(inner, foot_um)
    return inner, max(outer, inner + BUMP_SEARCH.ring_width * radius_um)


def _round(
    part: Heights, z_um: Floats, over: Floats, centre: tuple[float, float], ring_um: tuple[float, float]
) -> tuple[float, WeightedHeights] | None:
    """Return the height of the surroundings under a bump's top, also as a weighted sum; None if unmeasured."""
    col, row = (centre[0] - part.x0_um) / part.pixel_um, (part.y0_um - centre[1]) / part.pixel_um
    px = ring_um[1] / part.pixel_um
    box = slice(max(0, round(row - px)), round(row + px) + 1), slice(max(0, round(col - px)), round(col + px) + 1)
    ring = _points(part, z_um, box, over[box] < BUMP_SEARCH.ring_below * np.nanmax(over[box]))
    away_um = np.hypot(ring.x_um - centre[0], ring.y_um - centre[1])
    ring = ring.select((away_um >= ring_um[0]) & (away_um <= ring_um[1]))
    if len(ring) < BUMP_SEARCH.least_round:
        return None
    design = plane_design(ring, centre)
    fit = robust_fit(design, ring.z_um)
    under = WeightedHeights.of_fit(ring.select(fit.inliers), design[fit.inliers], np.array([0.0, 0.0, 1.0]))
    return float(fit.coefficients[2]), under


def _points(part: Heights, z_um: Floats, box: Box, mask: Mask) -> HeightSamples:
    """Return the measured points of a box within a mask."""
    rows, cols = np.nonzero(mask & np.isfinite(z_um[box]))
    return HeightSamples(part.x_um[box[1]][cols], part.y_um[box[0]][rows], z_um[box][rows, cols])


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
SELECTION = "selection of the extremes"
REPEATS = 1000
"""Number of repeats by which the selection of the extremes is estimated."""
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
        Coplanarity, mean and range of the bump heights in um with expanded uncertainties (k = 2), tilt of the reference
        plane in mrad, and every bump, the largest deviation first.

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

    Bump heights count from the surroundings of each bump, beyond what the focus window sees of its foot. Bumps cut by
    the region, or with unmeasured tops, are only counted. Noise draws the extremes apart, so that the true coplanarity
    is rather smaller.

    References
    ----------
    .. [1] JEDEC JESD22-B108, Coplanarity Test for Surface-Mount Semiconductor Devices.
    """
    require_choice("reference", reference, Reference, MeasureError)
    require_area(region, "measured")
    reading, level = MeasurementContext.of(surface, layer, calibration_valid), level_for(surface, region)
    part = height_window(surface, reading.layer, region, level)
    bumps = find_bumps(part, region.contains(part.x_um[None, :], part.y_um[:, None]), reading.window_reach_px)
    _require_enough(bumps)
    fitted = PLANES[reference](bumps.tops)
    listed = tuple(_bump(reading, top, off) for top, off in zip(bumps.tops, fitted.deviation_um.tolist(), strict=True))
    resolved = () if bumps.tops[0].errors.resolved else (UNRESOLVED_NOTE,)
    return Coplanarity(
        **reading.result_fields(name, level, DEFINITIONS[reference], EXTREMES, *resolved, *reading.not_in_budget()),
        region=region,
        options=CoplanarityOptions(reference=reference),
        coplanarity=_coplanarity(reading, bumps.tops, fitted),
        mean_height=_mean_height(reading, bumps.tops),
        height_range=_height_range(reading, bumps.tops),
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
    u_um = np.array([top.errors.scatter(top.top).u for top in tops])
    selection = {SELECTION: selection_um(fitted.deviation_um, u_um)}
    return _length(reading, fitted.range_um, _scatter_between(low, high, low.top, high.top), **selection)


def _height_range(reading: MeasurementContext, tops: tuple[Top, ...]) -> Length:
    """Return the difference of the highest and the lowest bump over their surroundings."""
    heights_um = np.array([top.height_um for top in tops])
    low, high = tops[int(np.argmin(heights_um))], tops[int(np.argmax(heights_um))]
    u_um = np.array([top.errors.scatter(top.over_ground).u for top in tops])
    return _length(
        reading,
        float(np.ptp(heights_um)),
        _scatter_between(low, high, low.over_ground, high.over_ground),
        **{
            SELECTION: selection_um(heights_um, u_um),
            WINDOW: abs(reading.sag_um(high.curvature) - reading.sag_um(low.curvature)),
        },
    )


def _scatter_between(low: Top, high: Top, of_low: WeightedHeights, of_high: WeightedHeights) -> Scatter:
    apart = WeightedHeights.joined((of_high, of_low.times(-1.0)))
    return Scatter.largest(top.errors.scatter(apart) for top in (low, high))


def selection_um(deviation_um: Floats, u_um: Floats) -> float:
    """Return by how much the range of deviations [n] grows by errors with standard uncertainties [n], on average.

    The extremes of many values with errors are extremes of the errors too. The mean is over repeats of a fixed seed of
    the deviations as they were found, with such errors once more.
    """
    errors = np.random.default_rng(0).standard_normal((REPEATS, len(u_um))) * u_um
    return max(0.0, float(np.mean(np.ptp(deviation_um + errors, axis=1))) - float(np.ptp(deviation_um)))


def _mean_height(reading: MeasurementContext, tops: tuple[Top, ...]) -> Length:
    """Return the mean bump height: one weighted sum of the heights of all bumps and of what lies round them."""
    mean_um = float(np.mean([top.height_um for top in tops]))
    whole = WeightedHeights.joined(top.over_ground.times(1 / len(tops)) for top in tops)
    noisiest = max(tops, key=lambda top: top.errors.variance_um2)
    sag_um = float(np.mean([reading.sag_um(top.curvature) for top in tops]))
    return _length(reading, mean_um, noisiest.errors.scatter(whole), **{WINDOW: sag_um})


def _bump(reading: MeasurementContext, top: Top, deviation_um: float) -> Bump:
    return Bump(
        place=Point(x_um=round(top.x_um, 2), y_um=round(top.y_um, 2)),
        height=_length(
            reading,
            top.height_um,
            top.errors.scatter(top.over_ground),
            **{WINDOW: reading.sag_um(top.curvature)},
        ),
        diameter_um=top.diameter_um,
        deviation=_length(reading, deviation_um, top.errors.scatter(top.top)),
    )


def _length(reading: MeasurementContext, value_um: float, noise_um: Scatter, **more: float) -> Length:
    lines: Lines = {
        "z scale": reading.u_z_scale * abs(value_um),
        "noise and form of the tops": noise_um,
        **more,
        **reading.frame_lines(),
    }
    return reading.length(value_um, lines)
