"""Flatness of a face by ISO 12781: deviations from the least-squares plane, and minimum zone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from wafer_viewer.measure.base.correlated_errors import Scatter
from wafer_viewer.measure.base.height_samples import Floats, HeightSamples, Layer
from wafer_viewer.measure.base.measurement_context import FLATNESS, Z_SCALE, Lines, MeasurementContext
from wafer_viewer.measure.base.pixel_noise import NOISE, noise_lines, scatter_covariance, thinned
from wafer_viewer.measure.base.plane_faces import Area, area_of, lattice_of, least_squares_plane
from wafer_viewer.model.measurement.measurements import Flatness
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Mosaic

BAND = (0.135, 99.865)
"""Percentiles that enclose 99.73 % of the heights, as +-3 deviations of normal noise do."""
ROUNDING = 1e-9
"""Residuals below this fraction of the extent of a face are rounding."""
EXTREMES = (
    "FLTt is between the two most extreme points: noise and single false heights make it larger. Values are not "
    "corrected for noise; U covers what the scatter about a smooth form, as noise, adds to them."
)


def flatness(
    surface: Mosaic, region: Region, *, calibration_valid: bool = True, layer: Layer | None = None, name: str = ""
) -> Flatness:
    """Measure the flatness of a face by ISO 12781.

    FLTt (peak to valley) and FLTq (root mean square) are about the least-squares plane. FLTt of the minimum zone is the
    smallest distance, along z, of two parallel planes that enclose every point.

    Parameters
    ----------
    surface : Mosaic
        Height map or mosaic to measure; regions are in its stage coordinates, um.
    region : Region
        Rectangle, circle or polygon on the face, in stage um.
    calibration_valid : bool, optional
        Whether the calibration of the surface is valid. Default True. Where it is False, or the surface has no
        calibration, results have status 'uncalibrated' and no uncertainty.
    layer : {'unsmoothed', 'smoothed', 'filled'}, optional
        Height layer. Default None: the layer on which the recipe of the surface measures.
    name : str, optional
        Name of the result. Default ''.

    Returns
    -------
    Flatness
        FLTt, FLTq and FLTt of the minimum zone in um with expanded uncertainties (k = 2), and the band that encloses
        99.73 % of the heights, in um and without uncertainty.

    Raises
    ------
    MeasureError
        If the region is a line or a point, or lies outside the surface.
    MeasureError
        If the region has fewer than 200 measured points or less than half of its area measured.
    MeasureError
        If its points do not determine a plane.

    Notes
    -----
    Every measured point counts; no outliers are rejected. FLTt is between the two most extreme points, so that noise
    and single false heights make it larger. Parameters are those of ISO 12781-1 [1]_.

    Values are not corrected for noise. Their uncertainty covers its bias: the scatter of the heights about a polynomial
    of second order is taken as noise, an upper bound, and realisations of it are added to the surface and evaluated.

    References
    ----------
    .. [1] ISO 12781-1, Flatness - Part 1: Vocabulary and parameters of flatness.
    """
    reading = MeasurementContext.of(surface, layer, calibration_valid)
    area = area_of(reading, region, "face", "flatness")
    _, left = least_squares_plane(area.points)
    low, high = np.percentile(left, BAND)
    zone_um, total_um, rms_um = minimum_zone(area.points, left), float(np.ptp(left)), float(np.sqrt(np.mean(left**2)))
    noise = noise_of_form(area, minimum_zone) if reading.calibrated else {}
    return Flatness(
        **reading.result_fields(name, area.level, EXTREMES, *reading.not_in_budget()),
        region=region,
        reference="least_squares",
        flt_t=reading.length(total_um, form_lines(reading, total_um, noise.get("t"))),
        flt_t_minimum_zone=reading.length(zone_um, form_lines(reading, zone_um, noise.get("zone"))),
        flt_q=reading.length(rms_um, form_lines(reading, rms_um, noise.get("q"))),
        band_9973_um=float(high - low),
        points=len(area.points),
        measured_fraction=area.measured_fraction,
    )


def minimum_zone(points: HeightSamples, left_um: Floats) -> float:
    """Return the height in um, along z, of the minimum zone: two parallel planes that enclose all points.

    left_um: residuals from any plane near to it. Only vertices of the convex hull can touch the planes; a linear
    programme over these finds the zone.
    """
    places = np.stack([points.x_um - points.x_um.mean(), points.y_um - points.y_um.mean()], axis=1)
    span_um, height_um = float(np.abs(places).max()), float(np.ptp(left_um))
    if height_um <= ROUNDING * span_um:
        return height_um
    cloud = np.column_stack([places / span_um, left_um / height_um])
    corners = cloud[ConvexHull(cloud).vertices]
    ones, zeros = np.ones(len(corners)), np.zeros(len(corners))
    # Unknown: two slopes, the layer's top and its foot over the middle. No corner lies over the one or under the other.
    under_top = np.column_stack([-corners[:, :2], -ones, zeros])
    over_foot = np.column_stack([corners[:, :2], zeros, ones])
    limits = np.concatenate([-corners[:, 2], corners[:, 2]])
    found = linprog([0, 0, 1, -1], A_ub=np.vstack([under_top, over_foot]), b_ub=limits, bounds=(None, None))
    return float(found.fun) * height_um


def noise_of_form(area: Area, zone: Callable[[HeightSamples, Floats], float] | None = None) -> dict[str, Scatter]:
    """Return the standard uncertainties of FLTt, of the minimum zone and of FLTq due to noise; empty if unknown.

    zone: function of points and residuals for the minimum zone; None leaves it out.
    """
    z_um, step = thinned(lattice_of(area))
    covariance = scatter_covariance(z_um)
    rows, cols = np.indices(z_um.shape) * step * area.pixel_um
    known = np.isfinite(z_um)

    def evaluate(noisy_um: Floats) -> dict[str, float]:
        points = HeightSamples(*(each[known].astype(np.float64) for each in (cols, rows, noisy_um)))
        _, left = least_squares_plane(points)
        total, rms = float(np.ptp(left)), float(np.sqrt(np.mean(left**2)))
        return {"t": total, "q": rms} | ({} if zone is None else {"zone": zone(points, left)})

    return {} if covariance is None else noise_lines(evaluate, z_um, covariance, ("t", "zone"))


def form_lines(reading: MeasurementContext, value_um: float, noise_um: Scatter | None) -> Lines | None:
    """Return the budget lines of a deviation of form; None where the noise is not known."""
    if noise_um is None:
        return None
    calibration = reading.surface.provenance.calibration
    deviation_um = None if calibration is None else calibration.u_flatness_um
    return {
        Z_SCALE: reading.u_z_scale * value_um,
        NOISE: noise_um,
        **({} if deviation_um is None else {FLATNESS: deviation_um}),
        **reading.frame_lines(),
    }
